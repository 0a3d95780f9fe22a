//! Displacement: what has gone sideways since an older picture (decision 012).
//!
//! A witness ([`super::witness`]) sees who has come nearer or has left their outline. Who sways on
//! the spot does neither: the shirt is still where a shirt was, only another part of it. The
//! picture knows. A sample's patch is looked for in pictures ten to thirty frames old, from the place
//! it had there if it has been at rest since:
//!
//! eᵢ = ‖foundᵢ - predictedᵢ‖ / √(1 + (sᵢ / σ)²),   sᵢ = f b σ_z(zᵢ) / zᵢ²
//!
//! with the baseline b between the two cameras: sᵢ is what the error of the sample's own depth does
//! to the prediction. In units of max(σ, spread), the spread read off the nearer two fifths of those
//! who pass for static, eᵢ is a residual like that of a witness. One picture may err, so the second
//! largest of three counts.
//!
//! This is the paper's flow check (sec. III-B) the other way round and over a longer time. That check
//! acquits suspects from one frame to the next, where somebody who sways goes less than a pixel.

use garad_core::{DepthImage, FrameId, KeyframeId, Real, Se3};
use garad_features::{LkConfig, LkPyramid, LkTrack, lk};

use super::frame::Sample;
use super::witness::Verdict;
use crate::frame::Frame;
use crate::refine::to_f32;
use crate::system::Slam;

/// Levels of the pictures: who has gone 30 px in a second must be found.
const LEVELS: usize = 3;
/// Half the side of a Lucas-Kanade window, px.
const HALF_WINDOW_PX: f64 = 10.0;
/// Share of those who pass for static that sets the spread.
const SPREAD_SHARE: f64 = 0.4;
/// Fewer than so many make no spread.
const LEAST_SPREAD: usize = 20;
/// A witness's residual up to which a sample passes for static, standard deviations.
const PASSES_SIGMAS: f64 = 2.0;
/// Frames to a picture that is foreseen, at least.
const LEAST_FORESIGHT: u32 = 3;

/// Steps per level, and the length in pixels below which they end: a fifth of a pixel is near enough.
const ITERATIONS: usize = 8;
const EPSILON_PX: f64 = 0.05;

/// Sample, its place in the frame and in the exhibit if it has been at rest, px.
type Task = (usize, [f32; 2], [f32; 2]);

/// A picture to look in, and where it was taken.
#[derive(Debug, Clone, Copy)]
struct Exhibit<'a> {
    picture: &'a LkPyramid,
    camera_from_world: Se3,
}

impl Slam {
    /// Levels above the full picture that pictures for Lucas-Kanade are made with.
    pub(crate) fn picture_levels(&self) -> usize {
        match self.config.labels.displacement.enabled {
            true => LEVELS,
            false => 1,
        }
    }

    /// The oldest frame whose picture is still looked into.
    pub(crate) fn oldest_picture(&self, now: FrameId) -> FrameId {
        let config = &self.config.labels.displacement;
        let reach = match config.enabled {
            true => config.ages_frames.into_iter().max().unwrap_or(0) + config.slack_frames(),
            false => 0,
        };
        FrameId(now.0.saturating_sub(reach))
    }

    /// Raises the verdicts on those samples that have gone sideways.
    pub(crate) fn hear_displacements(
        &self,
        frame: &Frame,
        depth: &DepthImage,
        picture: &LkPyramid,
        samples: &[Sample],
        verdicts: &mut [Verdict],
    ) {
        if !self.config.labels.displacement.enabled {
            return;
        }
        let passes: Vec<bool> = verdicts
            .iter()
            .map(|v| v.residual.is_some_and(|r| r < PASSES_SIGMAS))
            .collect();
        let whole: Vec<bool> = samples.iter().map(|s| self.is_whole(s, depth)).collect();
        let mut heard = vec![Vec::new(); samples.len()];
        for exhibit in self.exhibits(frame.id) {
            let asked = (0..samples.len()).filter(|i| whole[*i]);
            let found = self.displacements(frame, picture, exhibit, samples, asked);
            let of_static = found.iter().filter(|(i, _)| passes[*i]).map(|(_, e)| *e);
            let Some(spread) = spread(of_static.collect()) else {
                continue;
            };
            let unit = spread.max(self.config.labels.displacement.sigma_px);
            for (i, e) in found {
                heard[i].push(e / unit);
            }
        }
        for (verdict, mut residuals) in verdicts.iter_mut().zip(heard) {
            residuals.sort_by(|a, b| b.total_cmp(a));
            if let Some(second) = residuals.get(1).or(residuals.first()) {
                verdict.residual = Some(verdict.residual.unwrap_or(0.0).max(*second));
            }
        }
    }

    /// The kept pictures whose ages are nearest to those wanted, and those foreseen.
    fn exhibits(&self, now: FrameId) -> Vec<Exhibit<'_>> {
        let config = &self.config.labels.displacement;
        // A frame seen again has keyframes that are younger.
        let age = |k: KeyframeId| now.0.checked_sub(self.map.keyframe(k).id.0);
        let kept = self.pyramids.keys();
        let aged: Vec<(KeyframeId, u32)> = kept.filter_map(|k| Some((*k, age(*k)?))).collect();
        let mut chosen: Vec<KeyframeId> = config
            .ages_frames
            .iter()
            .filter_map(|wanted| {
                let off = |(_, age): &&(KeyframeId, u32)| age.abs_diff(*wanted);
                let nearest = aged.iter().min_by_key(off);
                nearest.filter(|k| off(k) <= config.slack_frames())
            })
            .map(|(k, _)| *k)
            .collect();
        chosen.sort_unstable();
        chosen.dedup();
        let kept = chosen.iter().map(|k| Exhibit {
            picture: &self.pyramids[k],
            camera_from_world: self.map.keyframe(*k).camera_from_world,
        });
        let foreseen = self.foresight.iter().filter_map(|foresight| {
            let far = now.0.abs_diff(foresight.frame.0) >= LEAST_FORESIGHT;
            Some(Exhibit {
                picture: foresight.picture.as_ref().filter(|_| far)?,
                camera_from_world: foresight.camera_from_world,
            })
        });
        kept.chain(foreseen).collect()
    }

    /// Whether nothing much nearer reaches into the sample's window: it would be followed instead.
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "negative places are left out before the cast; `get` refuses what lies outside"
    )]
    fn is_whole(&self, sample: &Sample, depth: &DepthImage) -> bool {
        let edge_m = self.config.labels.displacement.edge_m;
        let steps = [-1.0, -0.5, 0.0, 0.5, 1.0].map(|s| s * HALF_WINDOW_PX);
        let places = steps.iter().flat_map(|dy| steps.map(|dx| (dx, *dy)));
        let nearer = |(dx, dy): (f64, f64)| {
            let (x, y) = (sample.px.x + dx, sample.px.y + dy);
            let z =
                (x >= 0.0 && y >= 0.0).then(|| depth.get((x + 0.5) as usize, (y + 0.5) as usize));
            z.flatten()
                .is_some_and(|z| *z > 0.0 && f64::from(*z) < sample.depth_m - edge_m)
        };
        !places.into_iter().any(nearer)
    }

    /// eᵢ of those among `asked` of which the exhibit says something, px: 0 of those that are where they
    /// would be at rest.
    ///
    /// A place that explains the patch no better than rest does is no displacement: on plain
    /// cloth and along an edge the search ends anywhere. So those that differ at rest hardly
    /// more than the best do are not looked for at all.
    fn displacements(
        &self,
        frame: &Frame,
        picture: &LkPyramid,
        exhibit: Exhibit<'_>,
        samples: &[Sample],
        asked: impl Iterator<Item = usize>,
    ) -> Vec<(usize, f64)> {
        let config = &self.config.labels.displacement;
        let mut tasks: Vec<Task> = asked
            .filter_map(|i| {
                let p_cam = exhibit.camera_from_world * samples[i].p_world;
                let uv = self.camera.project(&p_cam)?;
                let inside = self.camera.contains(&uv);
                let at_rest = inside.then(|| self.camera.distort_pixel(&uv))?;
                Some((i, to_f32(&samples[i].px), to_f32(&at_rest)))
            })
            .collect();
        let search = LkConfig {
            iterations: ITERATIONS,
            epsilon_px: EPSILON_PX,
            min_eigenvalue: config.min_eigenvalue,
            max_residual: Some(config.max_residual),
        };
        let stay = LkConfig {
            iterations: 0,
            max_residual: None,
            ..search
        };
        // Pictures of one camera have one size: the answer is never an error.
        let track = |tasks: &[Task], config| {
            let points: Vec<_> = tasks.iter().map(|t| t.1).collect();
            let starts: Vec<_> = tasks.iter().map(|t| t.2).collect();
            let to = exhibit.picture;
            lk::track(picture, to, &points, Some(&starts), config, self.par).unwrap_or_default()
        };
        let stayed = track(&tasks, &stay);
        let mut differences: Vec<f64> = stayed
            .iter()
            .filter(|stayed| stayed.is_tracked())
            .map(|stayed| f64::from(stayed.residual))
            .collect();
        differences.sort_by(f64::total_cmp);
        let Some(least) = differences.get(differences.len() / 10) else {
            return Vec::new();
        };
        let explains_less =
            |stayed: f64, found: f64| stayed >= config.better_ratio * found + config.better_by;
        let mut told = Vec::new();
        let mut at_rest = Vec::new();
        let mut stayed = stayed.into_iter();
        tasks.retain(|(i, _, _)| {
            let Some(stayed) = stayed.next().filter(LkTrack::is_tracked) else {
                return false;
            };
            let doubtful = explains_less(f64::from(stayed.residual), *least);
            match doubtful {
                true => at_rest.push(stayed),
                false => told.push((*i, 0.0)),
            }
            doubtful
        });
        let then = exhibit.camera_from_world.inverse().translation;
        let baseline_m = (then - frame.center()).norm();
        let noise = &self.config.labels.noise;
        for (((i, _, start), found), stayed) in
            tasks.iter().zip(track(&tasks, &search)).zip(at_rest)
        {
            if !found.is_tracked() {
                continue;
            }
            let [dx, dy] = [0, 1].map(|k| f64::from(found.xy[k] - start[k]));
            let z = samples[*i].depth_m;
            let by_depth_px = self.camera.fx * baseline_m * noise.sigma_m(z) / (z * z);
            let share = by_depth_px / config.sigma_px;
            let off_px = ((dx * dx + dy * dy) / (1.0 + share * share)).sqrt();
            let better = explains_less(f64::from(stayed.residual), f64::from(found.residual));
            told.push((*i, if better { off_px } else { 0.0 }));
        }
        told
    }
}

/// σ of displacements of which a part is not at rest: of two normal coordinates, the share
/// 1 - exp(-q² / (2 σ²)) has a length up to q. `None` of too few.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a share of a length"
)]
fn spread(mut lengths: Vec<f64>) -> Option<f64> {
    if lengths.len() < LEAST_SPREAD {
        return None;
    }
    lengths.sort_by(f64::total_cmp);
    let quantile = lengths[(SPREAD_SHARE * lengths.len() as f64) as usize];
    Some(quantile / (-2.0 * Real::ln(1.0 - SPREAD_SHARE)).sqrt())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use garad_core::GrayImage;
    use nalgebra::{Vector2, Vector3};

    use super::*;
    use crate::config::Config;
    use crate::labels::frame::tests::{frame, is_in, keep, slam, texture, wall, wall_behind};
    use crate::labels::witness::Witness;
    use crate::opening::Foresight;

    /// What has gone sideways, and how far in ten frames, px.
    const SHIRT_PX: [[usize; 2]; 2] = [[48, 112], [32, 96]];
    const SWAY_PX: usize = 3;
    /// Samples whose windows lie within the shirt, before and after.
    const WITHIN_PX: [[usize; 2]; 2] = [[70, 98], [46, 82]];

    fn config() -> Config {
        let mut config = Config::default();
        config.labels.displacement.enabled = true;
        config
    }

    /// The texture with the shirt gone to the left by so much.
    fn swayed(by_px: usize) -> LkPyramid {
        let texture = texture();
        let picture = GrayImage::from_fn(160, 120, |x, y| match is_in(SHIRT_PX, x, y) {
            true => texture[(x + by_px, y)],
            false => texture[(x, y)],
        });
        LkPyramid::new(&picture, LEVELS).expect("a picture")
    }

    /// A camera at rest before a wall, whose depth says nothing of what is painted on it: pictures of
    /// these frames, with the shirt so far to the left.
    fn slam_that_saw(pictures: &[(u32, usize)], config: Config) -> Slam {
        let mut slam = slam(config);
        for (id, by_px) in pictures {
            let seen = frame(&slam, *id, &wall());
            let keyframe = keep(&mut slam, seen, &wall());
            slam.pyramids.insert(keyframe, Arc::new(swayed(*by_px)));
        }
        slam
    }

    /// Residuals of every fourth pixel of frame 40, in units of σ, after a witness that agrees
    /// everywhere: those of the shirt, and those whose windows do not touch it.
    fn residuals(slam: &Slam, depth: &DepthImage, picture: &LkPyramid) -> [Vec<f64>; 2] {
        let now = frame(slam, 40, depth);
        let columns = (4..156usize).step_by(4);
        let places = columns.flat_map(|x| (4..116usize).step_by(4).map(move |y| (x, y)));
        let places: Vec<(usize, usize)> = places.collect();
        let samples: Vec<Sample> = places
            .iter()
            .map(|&(x, y)| {
                let px = Vector2::new(x as f64, y as f64);
                let depth_m = f64::from(depth[(x, y)]);
                let p_world: Vector3<f64> = slam.camera.unproject(&px, depth_m);
                Sample {
                    px,
                    depth_m,
                    p_world,
                }
            })
            .collect();
        let agreed = Verdict {
            residual: Some(0.0),
            agreed_for: 40,
        };
        let mut verdicts = vec![agreed; samples.len()];
        slam.hear_displacements(&now, depth, picture, &samples, &mut verdicts);
        let of = |is: &dyn Fn(usize, usize) -> bool| {
            let both = places.iter().zip(&verdicts);
            both.filter(|((x, y), _)| is(*x, *y))
                .filter_map(|(_, v)| v.residual)
                .collect::<Vec<_>>()
        };
        let near = [[34, 126], [18, 110]];
        [
            of(&|x, y| is_in(WITHIN_PX, x, y)),
            of(&|x, y| !is_in(near, x, y)),
        ]
    }

    fn largest(residuals: &[f64]) -> f64 {
        residuals.iter().copied().fold(0.0, f64::max)
    }

    #[test]
    fn a_shirt_that_sways_is_seen_though_depth_agrees() {
        let slam = slam_that_saw(&[(10, 0), (20, 0), (30, 0)], config());
        let [shirt, wall_around] = residuals(&slam, &wall(), &swayed(SWAY_PX));
        assert!(shirt.len() >= 49 && wall_around.len() > 300, "samples");
        // 3 px are 6 units of 0.5 px.
        for residual in shirt {
            assert!((residual - 6.0).abs() < 0.3, "{residual}");
        }
        assert!(largest(&wall_around) <= 0.0, "the wall is at rest");
    }

    #[test]
    fn one_picture_alone_is_not_believed_against_two() {
        let shirt_of = |pictures: [(u32, usize); 3]| {
            let slam = slam_that_saw(&pictures, config());
            let [shirt, _] = residuals(&slam, &wall(), &swayed(SWAY_PX));
            largest(&shirt)
        };
        assert!(shirt_of([(10, 0), (20, 3), (30, 3)]) <= 0.0, "one of three");
        assert!(shirt_of([(10, 0), (20, 0), (30, 3)]) > 5.0, "two of three");
    }

    #[test]
    fn pictures_too_young_or_too_old_are_not_asked() {
        let slam = slam_that_saw(&[(4, 0), (36, 0)], config());
        let [shirt, _] = residuals(&slam, &wall(), &swayed(SWAY_PX));
        assert!(largest(&shirt) <= 0.0, "36 and 4 frames old");
        let slam = slam_that_saw(&[(5, 0)], config());
        let [shirt, _] = residuals(&slam, &wall(), &swayed(SWAY_PX));
        assert!(largest(&shirt) > 5.0, "35 frames: within half a step of 30");
    }

    /// A picture yet to come is one more that is asked.
    #[test]
    fn what_is_foreseen_is_asked() {
        let mut slam = slam_that_saw(&[], config());
        slam.foresight.push(Foresight {
            frame: FrameId(49),
            witness: Witness::new(&wall(), 8.0),
            picture: Some(swayed(0)),
            camera_from_world: Se3::identity(),
        });
        let [shirt, _] = residuals(&slam, &wall(), &swayed(SWAY_PX));
        assert!(largest(&shirt) > 5.0, "9 frames ahead");
        slam.foresight[0].frame = FrameId(42);
        let [shirt, _] = residuals(&slam, &wall(), &swayed(SWAY_PX));
        assert!(largest(&shirt) <= 0.0, "2 frames ahead is too near");
    }

    /// The camera has gone 5 cm to the right: with fx = 120 px, a wall at 3 m has gone 2 px to the left.
    #[test]
    fn what_the_camera_does_is_no_displacement() {
        let mut slam = slam_that_saw(&[(10, 0), (20, 0), (30, 0)], config());
        let now_from_then = Se3::exp(&[-0.05, 0.0, 0.0, 0.0, 0.0, 0.0].into());
        for k in slam.pyramids.keys().copied().collect::<Vec<_>>() {
            slam.map.keyframe_mut(k).camera_from_world = now_from_then.inverse();
        }
        let all = residuals(&slam, &wall(), &passed(2)).concat();
        assert!(largest(&all) <= 0.0, "as predicted");
        let [shirt, around] = residuals(&slam, &wall(), &passed(0));
        let least = shirt.into_iter().fold(f64::INFINITY, f64::min);
        assert!(least > 3.5, "who has kept up with the camera: {least}");
        assert!(largest(&around) <= 0.0, "the wall has not");
    }

    /// The texture gone to the left by 2 px, the shirt by so much.
    fn passed(shirt_px: usize) -> LkPyramid {
        let texture = texture();
        let picture = GrayImage::from_fn(160, 120, |x, y| match is_in(SHIRT_PX, x, y) {
            true => texture[(x + shirt_px, y)],
            false => texture[((x + 2).min(159), y)],
        });
        LkPyramid::new(&picture, LEVELS).expect("a picture")
    }

    #[test]
    fn nothing_is_said_of_plain_cloth_beside_edges_or_if_switched_off() {
        let pictures = [(10, 0), (20, 0), (30, 0)];
        let slam = slam_that_saw(&pictures, config());
        let plain = LkPyramid::new(&GrayImage::new(160, 120, 90), LEVELS).expect("a picture");
        let [shirt, _] = residuals(&slam, &wall(), &plain);
        assert!(largest(&shirt) <= 0.0, "plain");
        // Something half as far in the middle of the shirt reaches into all its windows.
        let before = wall_behind([[80, 88], [60, 68]]);
        let [beside, _] = residuals(&slam, &before, &swayed(SWAY_PX));
        let said = beside.iter().filter(|r| **r > 0.0).count();
        let [all, _] = residuals(&slam, &wall(), &swayed(SWAY_PX));
        assert!(
            2 * said < all.len(),
            "{said} of {} beside an edge",
            all.len()
        );
        let off = slam_that_saw(&pictures, Config::default());
        let [shirt, _] = residuals(&off, &wall(), &swayed(SWAY_PX));
        assert!(largest(&shirt) <= 0.0, "off");
    }
}
