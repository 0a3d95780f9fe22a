//! One frame: samples, their depth cue, the field, keypoint labels and the mask.

use garad_core::{Camera, DepthImage, FrameId, Image, Label, MaskImage, Real};
use garad_crf::{Cues, Node, unary};
use garad_features::LkPyramid;
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::witness::{CELL_PX, Court, Statement, Verdict};
use crate::frame::Frame;
use crate::mask::{self, MOVING};
use crate::system::Slam;

/// What was found out about a frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FrameLabels {
    /// The frame.
    pub frame: FrameId,
    /// Place of every keypoint in the recorded picture, px, and its label.
    pub keypoints: Vec<([f64; 2], Label)>,
    /// 255 where something moves, one value per 4 x 4 pixels.
    pub cells: MaskImage,
}

impl FrameLabels {
    /// The mask of a whole picture of this size.
    #[must_use]
    pub fn mask(&self, (width, height): (usize, usize)) -> MaskImage {
        full_size(&self.cells, (width, height))
    }
}

/// Cells as pixels.
pub(crate) fn full_size(cells: &MaskImage, (width, height): (usize, usize)) -> MaskImage {
    MaskImage::from_fn(width, height, |x, y| {
        cells
            .get(x / CELL_PX, y / CELL_PX)
            .copied()
            .unwrap_or_default()
    })
}

/// The lattice of samples: one pixel in the middle of every block, and the ray through it.
#[derive(Debug, Clone)]
pub(crate) struct Lattice {
    step_px: usize,
    columns: usize,
    rows: usize,
}

impl Lattice {
    pub(crate) fn new(camera: &Camera, step_px: usize) -> Self {
        Self {
            step_px,
            columns: camera.width.div_ceil(step_px),
            rows: camera.height.div_ceil(step_px),
        }
    }

    fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// Pixel and depth of every sample: the depth nearest to the middle of its block.
    fn samples(&self, depth: &DepthImage, max_depth_m: f64) -> Vec<Option<([usize; 2], f64)>> {
        let (width, height) = depth.size();
        let half = self.step_px / 2;
        (0..self.len())
            .map(|i| {
                let x = ((i % self.columns) * self.step_px + half).min(width - 1);
                let y = ((i / self.columns) * self.step_px + half).min(height - 1);
                // Outwards along a row, then along a column: a hole in the depth is often small.
                let reach = 0..half;
                let beside = reach.flat_map(|r| {
                    [
                        (x + r, y),
                        (x.saturating_sub(r), y),
                        (x, y + r),
                        (x, y.saturating_sub(r)),
                    ]
                });
                beside
                    .filter_map(|(x, y)| Some(([x, y], f64::from(*depth.get(x, y)?))))
                    .find(|(_, z)| *z > 0.0 && *z <= max_depth_m)
            })
            .collect()
    }
}

/// One sample in the field.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    pub(crate) px: Vector2<f64>,
    pub(crate) depth_m: f64,
    pub(crate) p_world: Vector3<f64>,
}

impl Slam {
    /// Labels the frame's keypoints from its first pose, unlinks those that move, and returns the
    /// mask in cells. `picture` is the frame's. `None` before the bootstrap is over or when the witnesses contradict nearly
    /// everything, which is a wrong pose rather than a crowd.
    pub(crate) fn label_frame(
        &self,
        frame: &mut Frame,
        depth: &DepthImage,
        picture: Option<&LkPyramid>,
    ) -> Option<MaskImage> {
        let config = &self.config.labels;
        let nobody_knows = self.witnesses.is_empty() && self.foresight.is_empty();
        if nobody_knows || !self.knows_what_moves(frame.id) {
            return None;
        }
        let keypoints = self.keypoint_samples(frame);
        let max_depth_m = self.config.features.max_depth_m;
        let lattice = self.lattice.samples(depth, max_depth_m);
        let world_from_camera = frame.camera_from_world.inverse();
        let lattice: Vec<Option<Sample>> = lattice
            .into_iter()
            .map(|found| {
                let ([x, y], depth_m) = found?;
                let px = Vector2::new(x as f64, y as f64);
                let uv_px = self.camera.undistort_pixel(&px)?;
                Some(Sample {
                    px,
                    depth_m,
                    p_world: world_from_camera * self.camera.unproject(&uv_px, depth_m),
                })
            })
            .collect();

        let samples: Vec<Sample> = keypoints
            .iter()
            .map(|(_, sample)| *sample)
            .chain(lattice.iter().flatten().copied())
            .collect();
        let mut verdicts = self.hear(&samples, frame.id);
        if let Some(picture) = picture {
            self.hear_displacements(frame, depth, picture, &samples, &mut verdicts);
        }
        let judged = verdicts.iter().filter_map(|v| v.residual);
        let suspects = judged.clone().filter(|r| *r > config.suspect_sigmas);
        let (judged, suspects) = (judged.count(), suspects.count());
        if suspects as f64 > config.max_moving * judged as f64 {
            return None;
        }
        let nodes: Vec<Node> = samples
            .iter()
            .map(|sample| Node {
                p_world: sample.p_world,
                uv_px: Some(sample.px),
                ..Node::default()
            })
            .collect();
        let log_odds: Vec<f64> = verdicts.iter().map(|v| self.log_odds(v)).collect();
        // Numbers come from depths and poses that are finite: the answer is never an error.
        let beliefs = self.crf.infer_from_log_odds(&nodes, &log_odds, self.par);
        let beliefs = beliefs.ok()?;
        self.tape.put("label", |page| {
            page.field(&nodes, &verdicts, &log_odds, &beliefs);
        });

        let (of_keypoints, of_lattice) = beliefs.dynamic.split_at(keypoints.len());
        let cells = self.cells(&lattice, of_lattice, depth);
        let mut label: Vec<Label> = frame.px.iter().map(|px| label_at(&cells, px)).collect();
        // Keypoints crowd where there is texture and back each other up there; the lattice is even.
        for ((i, _), belief) in keypoints.iter().zip(of_keypoints) {
            if *belief > self.config.crf.threshold {
                label[*i] = Label::Dynamic;
            }
        }
        let near = mask::dilated(&cells, config.reach_px.div_ceil(CELL_PX));
        let in_use = frame
            .px
            .iter()
            .zip(&label)
            .map(|(px, label)| *label == Label::Static && label_at(&near, px) == Label::Static);
        let in_use = in_use.collect();
        frame.set_labels(label, in_use, &self.camera);
        self.tape
            .put("masks", |page| page.labels(frame, Some(&cells)));
        Some(cells)
    }

    /// Whether it can be told what moves: not in the first frames, unless what comes is foreseen.
    pub(crate) fn knows_what_moves(&self, frame: FrameId) -> bool {
        frame.0 >= self.config.labels.bootstrap_frames || !self.foresight.is_empty()
    }

    /// What a verdict says for the moving of a sample. That it stands where something stood a moment
    /// ago says little: a person takes a second to leave their own outline. That it stood there a
    /// second ago says a lot.
    fn log_odds(&self, verdict: &Verdict) -> f64 {
        let config = &self.config.labels;
        let unary = &self.config.crf.unary;
        let trust = match verdict.residual {
            None => config.trust_unknown,
            Some(_) => {
                let settled = f64::from(verdict.agreed_for) / f64::from(config.settle_frames);
                let [young, old] = [config.trust_young, config.trust_old];
                young + (old - young) * settled.min(1.0)
            }
        };
        let cues = Cues {
            depth_residual: verdict.residual,
            ..Cues::default()
        };
        let likelihood = match verdict.residual {
            None => 1.0,
            Some(_) => unary::p_static(&cues, unary),
        };
        let p = (likelihood * trust).max(unary.clamp);
        Real::ln((1.0 - p) / p)
    }

    /// Keypoints with depth, by index.
    fn keypoint_samples(&self, frame: &Frame) -> Vec<(usize, Sample)> {
        (0..frame.len())
            .filter_map(|i| {
                let sample = Sample {
                    px: frame.px[i],
                    depth_m: frame.depth_m[i]?,
                    p_world: frame.world_point(i, &self.camera)?,
                };
                sample
                    .p_world
                    .iter()
                    .all(|v| v.is_finite())
                    .then_some((i, sample))
            })
            .collect()
    }

    /// What the keyframes of the last seconds say about the samples.
    fn hear(&self, samples: &[Sample], now: FrameId) -> Vec<Verdict> {
        let court = self.court(now);
        self.par
            .map_chunks(samples.len(), 128, |range| {
                let heard = range.map(|i| court.hear(&samples[i].p_world));
                heard.collect::<Vec<_>>()
            })
            .concat()
    }

    /// The witnesses of the last `memory_frames` frames and those foreseen, and where they stood.
    pub(crate) fn court(&self, now: FrameId) -> Court<'_> {
        let oldest = now.0.saturating_sub(self.config.labels.memory_frames);
        let recent = self.witnesses.iter().filter_map(|(k, witness)| {
            let keyframe = self.map.keyframe(*k);
            (keyframe.id.0 >= oldest).then_some(Statement {
                witness,
                camera_from_world: keyframe.camera_from_world,
                age: now.0 - keyframe.id.0,
            })
        });
        let foreseen = self.foresight.iter().map(|foresight| Statement {
            witness: &foresight.witness,
            camera_from_world: foresight.camera_from_world,
            age: now.0.abs_diff(foresight.frame.0),
        });
        Court {
            camera: &self.camera,
            noise: &self.config.labels.noise,
            statements: recent.chain(foreseen).collect(),
        }
    }

    /// The mask in cells: the mean belief of the samples around, weighted by how near they are in
    /// the picture (linear over one step) and in depth. Cells without depth go by the picture.
    fn cells(&self, lattice: &[Option<Sample>], beliefs: &[f64], depth: &DepthImage) -> MaskImage {
        let mut of_sample = vec![None; lattice.len()];
        let mut next = beliefs.iter();
        for (slot, sample) in of_sample.iter_mut().zip(lattice) {
            if let Some(sample) = sample {
                *slot = next.next().map(|belief| (*sample, *belief));
            }
        }
        let config = &self.config.labels;
        let (width, height) = depth.size();
        let (columns, rows) = (width.div_ceil(CELL_PX), height.div_ceil(CELL_PX));
        let step = self.lattice.step_px as f64;
        let half = CELL_PX as f64 / 2.0 - 0.5;
        Image::from_fn(columns, rows, |cx, cy| {
            let center = [cx, cy].map(|c| (c * CELL_PX) as f64 + half);
            let at = |c: usize, n: usize| (c * CELL_PX + CELL_PX / 2).min(n - 1);
            let z = f64::from(depth[(at(cx, width), at(cy, height))]);
            let block = [cx, cy].map(|c| c * CELL_PX / self.lattice.step_px);
            let (mut sum, mut weights) = (0.0, 0.0);
            for y in block[1].saturating_sub(1)..(block[1] + 2).min(self.lattice.rows) {
                for x in block[0].saturating_sub(1)..(block[0] + 2).min(self.lattice.columns) {
                    let Some((sample, belief)) = &of_sample[y * self.lattice.columns + x] else {
                        continue;
                    };
                    let dx = (sample.px.x - center[0]).abs() / (1.5 * step);
                    let dy = (sample.px.y - center[1]).abs() / (1.5 * step);
                    let mut weight = (1.0 - dx).max(0.0) * (1.0 - dy).max(0.0);
                    if z > 0.0 {
                        let d = (sample.depth_m - z) / (config.edge_ratio * z);
                        weight *= Real::exp(-0.5 * d * d) + 1e-6;
                    }
                    sum += weight * belief;
                    weights += weight;
                }
            }
            let moves = weights > 0.0 && sum > self.config.crf.threshold * weights;
            if moves { MOVING } else { 0 }
        })
    }
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to integer saturates; `get` refuses what lies outside"
)]
fn label_at(cells: &MaskImage, px: &Vector2<f64>) -> Label {
    let cell = |c: f64| (c + 0.5).max(0.0) as usize / CELL_PX;
    match cells.get(cell(px.x), cell(px.y)) {
        Some(&MOVING) => Label::Dynamic,
        _ => Label::Static,
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use garad_core::{GrayImage, KeyframeId, Par, Rng, Se3};
    use garad_features::{Descriptor, Keypoint};

    use super::*;
    use crate::config::Config;
    use crate::frame::Levels;
    use crate::labels::witness::Witness;

    /// Everything here stands in front of a wall so far away, metres, or is it.
    const WALL_M: f32 = 3.0;

    /// A camera of 160 x 120 pixels at the origin.
    pub(crate) fn slam(config: Config) -> Slam {
        let camera = Camera::pinhole((160, 120), [120.0, 120.0, 79.5, 59.5]).expect("valid");
        Slam::new(camera, config, 0, Par::Seq).expect("valid")
    }

    /// Blots of 3 x 3 pixels.
    pub(crate) fn texture() -> GrayImage {
        let mut rng = Rng::new(11);
        let blots = GrayImage::from_fn(60, 41, |_, _| {
            40 + u8::try_from(rng.below(170)).expect("u8")
        });
        GrayImage::from_fn(160, 120, |x, y| blots[(x / 3, y / 3)])
    }

    pub(crate) fn wall() -> DepthImage {
        DepthImage::new(160, 120, WALL_M)
    }

    /// A box half way to the wall that covers these columns and rows.
    pub(crate) fn wall_behind(box_px: [[usize; 2]; 2]) -> DepthImage {
        DepthImage::from_fn(160, 120, |x, y| match is_in(box_px, x, y) {
            true => 0.5 * WALL_M,
            false => WALL_M,
        })
    }

    pub(crate) fn is_in([[x0, x1], [y0, y1]]: [[usize; 2]; 2], x: usize, y: usize) -> bool {
        (x0..x1).contains(&x) && (y0..y1).contains(&y)
    }

    /// Every 8th pixel each way: 20 columns of 15 keypoints.
    pub(crate) fn places() -> Vec<[usize; 2]> {
        let columns = (4..160).step_by(8);
        columns
            .flat_map(|x| (4..120).step_by(8).map(move |y| [x, y]))
            .collect()
    }

    /// A picture with a keypoint at each of [`places`].
    pub(crate) fn frame(slam: &Slam, id: u32, depth: &DepthImage) -> Frame {
        let keypoints: Vec<Keypoint> = places()
            .into_iter()
            .map(|[x, y]| Keypoint {
                x: x as f32,
                y: y as f32,
                level: 0,
                angle_deg: 0.0,
                response: 1.0,
            })
            .collect();
        Frame::new(
            FrameId(id),
            f64::from(id) / 30.0,
            keypoints,
            vec![Descriptor::default(); places().len()],
            depth,
            None,
            &slam.camera,
            &Levels::new((160, 120), 1.2, 8, true),
            &slam.config,
        )
    }

    /// Makes the frame a keyframe and its depth a witness.
    pub(crate) fn keep(slam: &mut Slam, frame: Frame, depth: &DepthImage) -> KeyframeId {
        let id = slam.map.add_keyframe(frame);
        slam.witnesses.insert(id, Witness::new(depth, 8.0));
        id
    }

    /// Has kept frames 0, 20 and 40, all of this.
    fn slam_that_saw(depth: &DepthImage, config: Config) -> Slam {
        let mut slam = slam(config);
        for id in [0, 20, 40] {
            let seen = frame(&slam, id, depth);
            keep(&mut slam, seen, depth);
        }
        slam
    }

    fn moving_share(cells: &MaskImage) -> f64 {
        let moving = cells.data().iter().filter(|c| **c == MOVING).count();
        moving as f64 / cells.data().len() as f64
    }

    #[test]
    fn what_has_come_moves_to_the_cell() {
        let slam = slam_that_saw(&wall(), Config::default());
        let box_px = [[48, 112], [32, 96]];
        let depth = wall_behind(box_px);
        let mut now = frame(&slam, 60, &depth);
        let cells = slam.label_frame(&mut now, &depth, None).expect("labelled");
        let expected = MaskImage::from_fn(40, 30, |x, y| {
            if is_in(box_px, 4 * x, 4 * y) {
                MOVING
            } else {
                0
            }
        });
        assert_eq!(cells, expected, "the box and nothing else");
        let near = [[44, 116], [28, 100]];
        for (i, [x, y]) in places().into_iter().enumerate() {
            let label = match is_in(box_px, x, y) {
                true => Label::Dynamic,
                false => Label::Static,
            };
            assert_eq!(now.label[i], label, "({x}, {y})");
            let in_use = !is_in(near, x, y);
            assert_eq!(now.in_use[i], in_use, "({x}, {y}), 4 px around the box");
        }
        let full = full_size(&cells, (160, 120));
        let same = |x, y| (full[(x, y)] == MOVING) == is_in(box_px, x, y);
        assert!(places().iter().all(|&[x, y]| same(x, y)), "full size");
    }

    /// What a thing uncovers as it goes was hidden until now: nobody says anything against it.
    #[test]
    fn what_is_uncovered_does_not_move() {
        let slam = slam_that_saw(&wall_behind([[48, 112], [32, 96]]), Config::default());
        let mut now = frame(&slam, 60, &wall());
        let cells = slam.label_frame(&mut now, &wall(), None).expect("labelled");
        assert!(moving_share(&cells) <= 0.0, "an empty wall");
        assert!(now.in_use.iter().all(|u| *u), "all of it in use");
    }

    #[test]
    fn nothing_is_said_before_the_bootstrap_or_without_a_witness() {
        let mut slam = slam(Config::default());
        let mut early = frame(&slam, 9, &wall());
        assert!(
            slam.label_frame(&mut early, &wall(), None).is_none(),
            "frame 9"
        );
        let mut alone = frame(&slam, 10, &wall());
        assert!(
            slam.label_frame(&mut alone, &wall(), None).is_none(),
            "no witness"
        );
        keep(&mut slam, early.clone(), &wall());
        assert!(
            slam.label_frame(&mut early, &wall(), None).is_none(),
            "frame 9"
        );
        assert!(
            slam.label_frame(&mut alone, &wall(), None).is_some(),
            "frame 10"
        );
    }

    #[test]
    fn a_witness_is_asked_for_so_many_frames() {
        let slam = slam_that_saw(&wall(), Config::default());
        let depth = wall_behind([[48, 112], [32, 96]]);
        for (id, asked) in [(130, true), (131, false)] {
            let mut now = frame(&slam, id, &depth);
            let cells = slam.label_frame(&mut now, &depth, None).expect("labelled");
            assert_eq!(moving_share(&cells) > 0.0, asked, "frame {id}: 40 + 90");
        }
    }

    /// Of the ten columns of samples, nine may be suspects (`max_moving` = 0.9), not ten.
    #[test]
    fn nearly_everything_moving_is_a_wrong_pose() {
        let mut config = Config::default();
        let mut slam = slam_that_saw(&wall(), config.clone());
        let mut nine = wall_behind([[0, 144], [0, 120]]);
        let mut now = frame(&slam, 60, &nine);
        let labelled = slam.label_frame(&mut now, &nine, None);
        assert!(
            moving_share(&labelled.expect("nine of ten")) > 0.85,
            "nearly all"
        );

        nine = wall_behind([[0, 160], [0, 120]]);
        now = frame(&slam, 60, &nine);
        assert!(
            slam.label_frame(&mut now, &nine, None).is_none(),
            "ten of ten"
        );
        assert!(now.label.iter().all(|l| *l == Label::Static), "no label");
        assert!(now.in_use.iter().all(|u| *u), "none put aside");

        // The same wall, but the pose is a metre off: everything floats in front of it.
        let step = Se3::exp(&[0.0, 0.0, 1.0, 0.0, 0.0, 0.0].into());
        let mut lost = frame(&slam, 60, &wall());
        lost.camera_from_world = step;
        assert!(
            slam.label_frame(&mut lost, &wall(), None).is_none(),
            "a metre off"
        );
        lost.camera_from_world = Se3::identity();
        let right = slam
            .label_frame(&mut lost, &wall(), None)
            .expect("right pose");
        assert!(moving_share(&right) <= 0.0, "the wall");

        config.labels.max_moving = 1.0;
        slam = slam_that_saw(&wall(), config);
        lost.camera_from_world = step;
        let cells = slam
            .label_frame(&mut lost, &wall(), None)
            .expect("no guard");
        // What lies within the old picture: (2/3)² of it.
        assert!(moving_share(&cells) > 0.4, "{}", moving_share(&cells));
    }

    #[test]
    fn trust_grows_with_the_age_of_the_agreement() {
        let slam = slam(Config::default());
        let odds = |residual, agreed_for| {
            slam.log_odds(&Verdict {
                residual,
                agreed_for,
            })
        };
        let unknown = Real::ln(0.45f64 / 0.55);
        assert!((odds(None, 0) - unknown).abs() < 1e-12, "a coin, nearly");
        let ages = [0, 15, 30, 45].map(|age| odds(Some(0.0), age));
        assert!(ages.is_sorted_by(|a, b| a > b), "older, surer: {ages:?}");
        assert!((odds(Some(0.0), 90) - ages[3]).abs() < 1e-15, "settled");
        assert!(ages[3] < 0.0, "settled is static");
        // Up to 2 σ is as good as none; the likelihood falls with σ = 1.5 from there.
        let residuals = [2.0, 3.5, 5.0, 9.0].map(|r| odds(Some(r), 45));
        assert!((residuals[0] - ages[3]).abs() < 1e-15, "{residuals:?}");
        let p = 0.97 * Real::exp(-0.5f64);
        assert!(
            (residuals[1] - Real::ln((1.0 - p) / p)).abs() < 1e-12,
            "{residuals:?}"
        );
        assert!(residuals.is_sorted_by(|a, b| a < b), "{residuals:?}");
        assert!(residuals[1] < 0.0 && residuals[2] > 0.0, "{residuals:?}");
        assert!(odds(Some(1e9), 0).is_finite(), "clamped");
    }

    #[test]
    fn samples_look_beside_a_hole() {
        let slam = slam(Config::default());
        let mut depth = wall();
        for (x, y) in [(8, 8), (9, 8), (7, 8), (8, 9)] {
            depth[(x, y)] = 0.0;
        }
        for y in 0..16 {
            depth.row_mut(y)[16..48].fill(0.0);
        }
        depth[(40, 8)] = 8.5;
        let samples = slam.lattice.samples(&depth, 8.0);
        assert_eq!(samples.len(), 80, "10 x 8");
        assert_eq!(samples[0], Some(([8, 7], 3.0)), "above the hole");
        assert_eq!(samples[1], None, "nothing in reach");
        assert_eq!(samples[2], None, "too far");
        assert_eq!(samples[3], Some(([56, 8], 3.0)), "the middle of its block");
    }
}
