//! The first frames, seen twice (decision 011).
//!
//! Who moves is told from who was not there before, and in the first frames there is no before. If
//! people walk there, they pull the first poses along, the first keyframes put them into the map, and
//! all that follows is judged against it. So the first frames are kept, and when the last of
//! them has come they are asked again:
//!
//! 1. Where did later frames stand, seen from the first? By then people have gone a step while the
//!    room has not, so one motion fits room and depth, and any other fits less. It is searched for
//!    without regard to how the frames were tracked ([`Slam::place_after`]).
//! 2. From there, what does the later depth picture see through? That was somebody
//!    ([`crate::labels::witness`], asked in both directions of time).
//! 3. If anybody was there, the run begins again with the first frame, and this time it is known what
//!    moves from the start. If nobody was, nothing happens.

use garad_core::{DepthImage, FrameId, RgbImage, Rng, Se3};
use garad_features::matching::match_descriptors;
use garad_features::{LkPyramid, MatchConfig};
use garad_optim::PoseObservation;
use serde::{Deserialize, Serialize};

use crate::agreement::Agreement;
use crate::frame::Frame;
use crate::labels::frame::FrameLabels;
use crate::labels::witness::Witness;
use crate::mask::MOVING;
use crate::observer::Observer;
use crate::recover::rigid_from_pairs;
use crate::system::{FrameInput, FrameReport, Slam, SlamError};
use crate::tracker::TrackingState;

/// Draws of three pairs. If a quarter of the pairs is of the room, 400 draws miss all triples of the
/// room once in 500.
const DRAWS: usize = 400;
/// The best of them from which the minimum is searched.
const STARTS: usize = 12;

/// Share of the first frame's cells that must move for the run to begin again: below, it is the edges
/// of things.
const LEAST_MOVING: f64 = 0.02;

/// A frame as it came.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(crate) struct Seen {
    t_s: f64,
    rgb: RgbImage,
    depth: DepthImage,
    /// Its features, not linked to anything.
    frame: Frame,
}

/// The first frames of a run, until there are enough.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(crate) struct Opening {
    seen: Vec<Seen>,
}

impl Opening {
    pub(crate) fn take(&mut self, input: &FrameInput<'_>, frame: &Frame) {
        self.seen.push(Seen {
            t_s: input.t_s,
            rgb: input.rgb.clone(),
            depth: input.depth.clone(),
            frame: frame.clone(),
        });
    }
}

/// A depth picture from a frame that is yet to come, and where it was taken.
#[derive(Debug, Clone)]
pub(crate) struct Foresight {
    pub(crate) frame: FrameId,
    pub(crate) witness: Witness,
    /// For displacements ([`crate::labels::displacement`]), if they are asked.
    pub(crate) picture: Option<LkPyramid>,
    pub(crate) camera_from_world: Se3,
}

/// What became of a frame when it was seen for the second time.
#[derive(Debug, Clone)]
pub struct SecondSight {
    /// Its report.
    pub report: FrameReport,
    /// What moves there.
    pub labels: Option<FrameLabels>,
}

impl Slam {
    /// Whether the run may still begin again.
    #[must_use]
    pub fn may_begin_again(&self) -> bool {
        self.opening.is_some()
    }

    /// What became of the first frames when they were seen again; empty but for once, after the last
    /// of them. The frame just given is not among them: its report is the answer to it.
    pub fn take_second_sight(&mut self) -> Vec<SecondSight> {
        std::mem::take(&mut self.second_sight)
    }

    /// To be called after every frame, with its report: keeps the first ones, and begins again when
    /// there are enough of them and somebody moves there.
    pub(crate) fn see_again(
        &mut self,
        report: FrameReport,
        observer: &mut dyn Observer,
    ) -> Result<FrameReport, SlamError> {
        match (self.state, &mut self.opening) {
            (TrackingState::Tracking, _) | (_, None) => {}
            (TrackingState::NotInitialised, Some(opening)) => opening.seen.clear(),
            (TrackingState::Lost, lost) => *lost = None,
        }
        let enough = self.config.labels.bootstrap_frames as usize;
        let Some(opening) = self.opening.take_if(|o| o.seen.len() >= enough) else {
            return Ok(report);
        };
        self.foresight = self.foresee(&opening);
        if self.moving_at_first(&opening) < LEAST_MOVING {
            self.foresight.clear();
            return Ok(report);
        }
        tracing::info!(frame = report.id.0, "somebody moves: begins again");
        let last = self.replay(&opening, report, observer);
        self.foresight.clear();
        last
    }

    /// Begins again with these frames; the answer is the report of the last, whose first was `last`.
    fn replay(
        &mut self,
        opening: &Opening,
        mut last: FrameReport,
        observer: &mut dyn Observer,
    ) -> Result<FrameReport, SlamError> {
        self.begin_again()?;
        for seen in &opening.seen {
            self.next_frame = seen.frame.id; // frames that could not be read left gaps
            let input = FrameInput {
                t_s: seen.t_s,
                rgb: &seen.rgb,
                depth: &seen.depth,
                mask: None,
            };
            last = self.advance(&input, observer)?;
            self.second_sight.push(SecondSight {
                report: last,
                labels: self.frame_labels.clone(),
            });
        }
        self.second_sight.pop(); // the frame just given
        Ok(last)
    }

    /// The frame in the middle and the last one, as witnesses of the first.
    fn foresee(&self, opening: &Opening) -> Vec<Foresight> {
        let n = opening.seen.len();
        let Some(first) = opening.seen.first() else {
            return Vec::new();
        };
        let later = [n / 2, n - 1].into_iter().filter(|k| *k > 0);
        later
            .filter_map(|k| {
                let seen = &opening.seen[k];
                Some(Foresight {
                    frame: seen.frame.id,
                    witness: Witness::new(&seen.depth, self.config.features.max_depth_m),
                    picture: self.far_picture(&seen.rgb),
                    camera_from_world: self.place_after(&first.frame, &seen.frame)?,
                })
            })
            .collect()
    }

    /// Where `last` stood, seen from `first`: the minimum of F (decision 009) over keypoints matched by
    /// descriptor alone and both depth pictures, from the best of many motions that three of the
    /// matches, or none, would have. `None` without depth.
    fn place_after(&self, first: &Frame, last: &Frame) -> Option<Se3> {
        let at_rest = Se3::identity();
        let then = [(first.surface.as_ref()?, &at_rest)];
        let surface = last.surface.as_ref()?;
        let matches = match_descriptors(
            &first.descriptors,
            &last.descriptors,
            &MatchConfig::default(),
            self.par,
        );
        let points = matches.iter().filter_map(|m| {
            let before = first.depth_m[m.query]?;
            let now = last.depth_m[m.train]?;
            let p_first = self.camera.unproject(&first.uv_px[m.query], before);
            let p_last = self.camera.unproject(&last.uv_px[m.train], now);
            let observation = PoseObservation {
                depth: None,
                ..self.observation(last, m.train, p_first)
            };
            Some(((p_last, p_first), observation))
        });
        let (pairs, observations): (Vec<_>, Vec<_>) = points.unzip();
        if pairs.is_empty() {
            return None;
        }
        let judge = || Agreement::new(self, surface, &then, observations.clone());
        let fair = judge();
        let mut rng = Rng::keyed(self.seed, &[u64::from(first.id.0), u64::from(last.id.0)]);
        let drawn = (0..DRAWS).filter_map(|_| {
            let draw = [0; 3].map(|_| pairs[rng.below(pairs.len())]);
            rigid_from_pairs(&draw)
        });
        let mut found: Vec<(f64, Se3)> = drawn
            .chain([at_rest])
            .map(|pose| (fair.price(&pose), pose))
            .collect();
        found.sort_by(|a, b| a.0.total_cmp(&b.0)); // stable
        let minima = found.iter().take(STARTS).map(|(_, start)| {
            let (pose, _) = judge().minimise(*start);
            (fair.price(&pose), pose)
        });
        let best = minima.min_by(|a, b| a.0.total_cmp(&b.0))?;
        best.1.is_finite().then_some(best.1)
    }

    /// Share of the first frame's cells that move, by the foresight alone: the poses of the witnesses
    /// so far are what is in doubt.
    fn moving_at_first(&mut self, opening: &Opening) -> f64 {
        let Some(first) = opening.seen.first() else {
            return 0.0;
        };
        let witnesses = std::mem::take(&mut self.witnesses);
        let picture = self.far_picture(&first.rgb);
        let mut frame = first.frame.clone();
        let cells = self.label_frame(&mut frame, &first.depth, picture.as_ref());
        self.witnesses = witnesses;
        cells.map_or(0.0, |cells| {
            let moving = cells.data().iter().filter(|c| **c == MOVING).count();
            moving as f64 / cells.data().len() as f64
        })
    }

    /// The picture for displacements, if they are asked.
    fn far_picture(&self, rgb: &RgbImage) -> Option<LkPyramid> {
        let asked = self.config.labels.displacement.enabled;
        asked.then(|| self.picture(&rgb.to_gray()))?
    }

    /// As if no frame had been given. What is foreseen stays, and who listens.
    fn begin_again(&mut self) -> Result<(), SlamError> {
        self.finish()?;
        let fresh = Self::new(self.camera, self.config.clone(), self.seed, self.par)?;
        let before = std::mem::replace(self, fresh);
        self.opening = None;
        self.foresight = before.foresight;
        self.schedule.listen_as(before.schedule);
        if let Some(frames) = before.tape.frames() {
            if let Some(mapper) = self.schedule.mapper_mut() {
                mapper.watch(frames.clone());
            }
            self.tape.watch(frames);
        }
        Ok(())
    }
}
