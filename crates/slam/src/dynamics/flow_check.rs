//! The flow check (paper sec. III-B, eq. 9 and 10): suspects that flow as the static scene does are static
//! again.
//!
//! The paper takes the flow between keyframes; here it is that over about `labels.rest_frames`, the
//! distance of keyframes, which every frame has (decision 012). From one frame to the next somebody
//! who sways or stops for a step moves less than a pixel.

use garad_features::flow::{FlowPoint, verify_flow};
use garad_features::{LkConfig, LkPyramid, lk};
use nalgebra::Vector2;

use super::past::ReferenceImage;
use super::samples::Sample;
use crate::context::Context;
use crate::images::lk_point;
use crate::trace::Recorder;

/// Static points the model is fitted to at most.
const MAX_SUPPORT: usize = 200;

/// Which suspected samples have been at rest since the reference image was taken: their flow from it is that
/// of the static scene.
///
/// In residual form the predicted flow is that of a static point at the depth now measured under
/// the camera's motion.
pub(crate) fn at_rest(
    context: &Context,
    pyramid: &LkPyramid,
    reference: ReferenceImage<'_>,
    samples: &[Sample],
    suspected: &[bool],
    recorder: &mut Recorder,
) -> Vec<bool> {
    let of = |wanted: bool| (0..samples.len()).filter(move |i| suspected[*i] == wanted);
    let suspects: Vec<usize> = of(true).collect();
    let support: Vec<usize> = of(false).collect();
    let inside = inside(
        context,
        pyramid,
        reference,
        samples,
        [support, suspects],
        recorder,
    );
    inside
        .into_iter()
        .map(|inside| inside == Some(true))
        .collect()
}

/// Which samples do not flow as the others do: outside of the model of all of them (eq. 10).
pub(crate) fn outliers(
    context: &Context,
    pyramid: &LkPyramid,
    reference: ReferenceImage<'_>,
    samples: &[Sample],
    recorder: &mut Recorder,
) -> Vec<bool> {
    let all: Vec<usize> = (0..samples.len()).collect();
    let inside = inside(
        context,
        pyramid,
        reference,
        samples,
        [all.clone(), all],
        recorder,
    );
    inside
        .into_iter()
        .map(|inside| inside == Some(false))
        .collect()
}

/// Whether the flow of each suspect is within the model of the support's; `None` for other samples, those that
/// Lucas-Kanade lost, and without a model.
fn inside(
    context: &Context,
    pyramid: &LkPyramid,
    reference: ReferenceImage<'_>,
    samples: &[Sample],
    [support, suspects]: [Vec<usize>; 2],
    recorder: &mut Recorder,
) -> Vec<Option<bool>> {
    let mut inside = vec![None; samples.len()];
    let (camera, config) = (&context.camera, &context.config.flow);
    if !config.enabled || suspects.is_empty() || support.is_empty() {
        return inside;
    }
    let every = support.len().div_ceil(MAX_SUPPORT);
    let support: Vec<usize> = support.into_iter().step_by(every).collect();
    let tracked: Vec<usize> = support.iter().chain(&suspects).copied().collect();

    // Backwards in time, so that the points are this frame's samples.
    let points: Vec<[f32; 2]> = (tracked.iter().map(|&i| lk_point(&samples[i].px))).collect();
    let predicted: Vec<Option<Vector2<f64>>> = tracked
        .iter()
        .map(|&i| reference.predicted_pixel(camera, &samples[i].p_world))
        .collect();
    let starts: Vec<[f32; 2]> = predicted
        .iter()
        .zip(&points)
        .map(|(to, from)| to.as_ref().map_or(*from, lk_point))
        .collect();
    let lk_config = LkConfig {
        max_residual: Some(context.config.subpixel.max_residual),
        ..LkConfig::default()
    };
    let images = [pyramid, reference.pyramid];
    let tracks = lk::track(
        images[0],
        images[1],
        &points,
        Some(&starts),
        &lk_config,
        context.par,
    )
    .expect("images of one camera have one size, and there is a start per point");
    recorder.record("flow_lk", |record| {
        record.tracks(images, [&points, &starts], &tracks);
    });
    let flow = |k: usize| {
        let from = Vector2::from(points[k].map(f64::from));
        tracks[k].is_tracked().then(|| FlowPoint {
            flow: Vector2::from(tracks[k].xy.map(f64::from)) - from,
            predicted: predicted[k].map(|to| to - from),
        })
    };
    let model: Vec<FlowPoint> = (0..support.len()).filter_map(flow).collect();
    let (judged, flows): (Vec<usize>, Vec<FlowPoint>) = (support.len()..tracked.len())
        .filter_map(|k| Some((tracked[k], flow(k)?)))
        .unzip();
    let verification =
        verify_flow(&model, &flows, config).expect("flows are finite and the settings are valid");
    recorder.record("flow", |record| {
        record.flow(&model, &flows, &verification);
    });
    for (i, verdict) in judged.into_iter().zip(verification.verdicts) {
        inside[i] = verdict.map(|v| v.inside);
    }
    inside
}

#[cfg(test)]
mod tests {
    use garad_core::{DepthImage, GrayImage, Se3};

    use super::*;
    use crate::config::Config;
    use crate::dynamics::free_space::FreeSpace;
    use crate::dynamics::samples::keypoint_samples;
    use crate::testing::{World, is_in, places, texture, wall, wall_behind};

    /// Two images, the depth of the second, the motion between them, and what is suspected in the second.
    struct Scene {
        context: Context,
        images: [LkPyramid; 2],
        depth: DepthImage,
        now_from_then: Se3,
        suspected: Vec<bool>,
    }

    impl Scene {
        /// Which keypoints are at rest; the suspects are at these places.
        fn rests(&self) -> Vec<bool> {
            self.check(|context, now, reference, samples, recorder| {
                at_rest(context, now, reference, samples, &self.suspected, recorder)
            })
        }

        /// Which keypoints do not flow as the others do.
        fn moves(&self) -> Vec<bool> {
            self.check(outliers)
        }

        fn check(
            &self,
            of: impl Fn(&Context, &LkPyramid, ReferenceImage<'_>, &[Sample], &mut Recorder) -> Vec<bool>,
        ) -> Vec<bool> {
            let mut world = World::new(Config::default());
            world.context = self.context.clone();
            let mut now = world.frame(30, &self.depth);
            now.camera_from_world = self.now_from_then;
            let samples = keypoint_samples(&now, &self.context.camera);
            let samples: Vec<Sample> = samples.into_iter().map(|(_, sample)| sample).collect();
            let free_space = FreeSpace::new(&wall(), 8.0);
            let [then, now] = &self.images;
            let reference = ReferenceImage::new(then, &free_space, Se3::identity());
            let recorder = &mut Recorder::default();
            of(&self.context, now, reference, &samples, recorder)
        }

        fn restored(&self) -> usize {
            self.rests().into_iter().filter(|rests| *rests).count()
        }
    }

    /// What moves between the two images, and how far, px.
    const PATCH_PX: [[usize; 2]; 2] = [[48, 112], [32, 96]];
    const SHIFT_PX: usize = 3;
    /// Its inner part, and a column of keypoints far from it.
    const MOVING_PX: [[usize; 2]; 2] = [[60, 98], [44, 84]];
    const STILL_PX: [[usize; 2]; 2] = [[10, 26], [20, 100]];

    fn pyramids(images: [&GrayImage; 2]) -> [LkPyramid; 2] {
        images.map(|image| LkPyramid::new(image, 1).expect("an image"))
    }

    /// A camera at rest before a wall: the second image is the first, but for a patch that moves to the left.
    fn scene() -> Scene {
        let first = texture();
        let second = GrayImage::from_fn(160, 120, |x, y| match is_in(PATCH_PX, x, y) {
            true => first[(x + SHIFT_PX, y)],
            false => first[(x, y)],
        });
        let suspected = places().into_iter();
        let suspected = suspected.map(|[x, y]| is_in(MOVING_PX, x, y) || is_in(STILL_PX, x, y));
        Scene {
            context: World::new(Config::default()).context,
            images: pyramids([&first, &second]),
            depth: wall(),
            now_from_then: Se3::identity(),
            suspected: suspected.collect(),
        }
    }

    #[test]
    fn suspects_that_flow_with_the_scene_are_static_again() {
        for ([x, y], rests) in places().into_iter().zip(scene().rests()) {
            assert_eq!(rests, is_in(STILL_PX, x, y), "({x}, {y})");
        }
        assert_eq!(scene().restored(), 20, "two columns of ten");
    }

    /// The camera has gone 10 cm to the right past a box at 1.5 m, in front of a wall at 3 m: with fx = 120 px the
    /// wall has gone 4 px to the left, and something at rest on the box 8 px. The suspects are on the box, which
    /// has gone `box_px`: near points flow further, as predicted, and one that flowed as far as the wall has moved.
    #[test]
    fn predicted_flow_goes_the_way_of_the_flow() {
        let within = [[64, 98], [48, 84]];
        for (box_px, is_at_rest) in [(8, true), (4, false)] {
            let first = texture();
            let at = |x: usize, y| first[(x.min(159), y)];
            let second = GrayImage::from_fn(160, 120, |x, y| match is_in(PATCH_PX, x, y) {
                true => at(x + box_px, y),
                false => at(x + 4, y),
            });
            let depth = wall_behind(PATCH_PX);
            let suspected = places().into_iter().map(|[x, y]| is_in(within, x, y));
            let scene = Scene {
                context: World::new(Config::default()).context,
                images: pyramids([&first, &second]),
                depth,
                now_from_then: Se3::exp(&[-0.1, 0.0, 0.0, 0.0, 0.0, 0.0].into()),
                suspected: suspected.collect(),
            };
            let suspects = scene.suspected.iter().filter(|s| **s).count();
            assert!(suspects >= 16, "{suspects} suspects");
            let expected = if is_at_rest { suspects } else { 0 };
            assert_eq!(scene.restored(), expected, "{box_px} px");
        }
    }

    #[test]
    fn without_a_model_suspects_stay() {
        let mut scene = scene();
        scene.context.config.flow.enabled = false;
        assert_eq!(scene.restored(), 0, "switched off");
        scene.context.config.flow.enabled = true;
        scene.context.config.flow.min_support = 1000;
        assert_eq!(scene.restored(), 0, "too few to fit a model to");
    }

    /// 3 px at a variance of little more than the floor of 0.04 px² are a χ² of about 220.
    #[test]
    fn the_gate_is_the_one_that_is_set() {
        for (chi2, restored) in [(50.0, 20), (150.0, 20), (400.0, 20 + 25)] {
            let mut scene = scene();
            scene.context.config.flow.chi2 = chi2;
            assert_eq!(scene.restored(), restored, "up to {chi2}");
            let moving = scene.moves();
            let inner = places().into_iter().zip(moving);
            let inner = inner.filter(|([x, y], moves)| *moves && is_in(MOVING_PX, *x, *y));
            let outside = if restored > 20 { 0 } else { 25 };
            assert_eq!(inner.count(), outside, "outside of {chi2}");
        }
    }

    /// The first image is 6 grey levels brighter: a track's residual is about that.
    #[test]
    fn the_residual_of_a_track_may_be_that_of_subpixel() {
        for (max_residual, brighter, tracked) in [(4.0, 6, false), (9.0, 6, true), (9.0, 14, false)]
        {
            let mut scene = scene();
            scene.context.config.subpixel.max_residual = max_residual;
            let [then, now] = [0, 1].map(|k| {
                let by = if k == 0 { brighter } else { 0 };
                let image = scene.images[k].image();
                GrayImage::from_fn(160, 120, |x, y| image[(x, y)].saturating_add(by))
            });
            scene.images = pyramids([&then, &now]);
            let restored = places().into_iter().zip(scene.rests());
            let still = restored.filter(|([x, y], rests)| *rests && is_in(STILL_PX, *x, *y));
            let expected = if tracked { 20 } else { 0 };
            assert_eq!(
                still.count(),
                expected,
                "{brighter} brighter, up to {max_residual}"
            );
        }
    }

    #[test]
    fn outliers_are_what_moves_against_all_others() {
        let mut scene = scene();
        for ([x, y], moves) in places().into_iter().zip(scene.moves()) {
            if is_in(MOVING_PX, x, y) {
                assert!(moves, "({x}, {y})");
            }
            if !(36..=124).contains(&x) {
                assert!(!moves, "({x}, {y})");
            }
        }
        scene.context.config.flow.enabled = false;
        assert!(!scene.moves().contains(&true), "switched off");
    }

    /// Two thirds of the picture are suspects and move; the model is that of the others.
    #[test]
    fn the_model_is_that_of_what_is_not_suspected() {
        let first = texture();
        let moves = |x: usize| x < 110;
        let second = GrayImage::from_fn(160, 120, |x, y| {
            first[(if moves(x) { x + SHIFT_PX } else { x }, y)]
        });
        let is_suspect = |[x, _]: [usize; 2]| x < 90;
        let scene = Scene {
            context: World::new(Config::default()).context,
            images: pyramids([&first, &second]),
            depth: wall(),
            now_from_then: Se3::identity(),
            suspected: places()
                .into_iter()
                .map(|at| is_suspect(at) || at[0] > 148)
                .collect(),
        };
        for ([x, y], rests) in places().into_iter().zip(scene.rests()) {
            assert_eq!(rests, x > 148, "({x}, {y})");
        }
    }

    /// Where there is no texture nothing is tracked: it neither rests nor moves.
    #[test]
    fn what_is_not_tracked_has_no_answer() {
        let mut scene = scene();
        let textures = [0, SHIFT_PX].map(|by_px| {
            let texture = texture();
            GrayImage::from_fn(160, 120, |x, y| match (x, is_in(PATCH_PX, x, y)) {
                (0..45, _) => 90,
                (_, true) => texture[(x + by_px, y)],
                _ => texture[(x, y)],
            })
        });
        scene.images = pyramids([&textures[0], &textures[1]]);
        assert_eq!(scene.restored(), 0, "no suspect is tracked to its place");
        let moves = places().into_iter().zip(scene.moves());
        let plain = moves.filter(|([x, _], moves)| *x < 28 && *moves);
        assert_eq!(plain.count(), 0, "plain");
    }
}
