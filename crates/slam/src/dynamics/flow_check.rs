//! The flow check (paper sec. III-B, eq. 9 and 10): suspects that flow as the static scene does become static
//! again.

use garad_core::Label;
use garad_features::flow::{FlowPoint, verify_flow};
use garad_features::{LkConfig, LkPyramid, lk};
use nalgebra::Vector2;

use super::samples::FrameView;
use crate::context::Context;
use crate::frame::{Frame, FrameLabels};
use crate::images::lk_point;
use crate::trace::Recorder;

/// Static points the model is fitted to at most.
const MAX_SUPPORT: usize = 200;

/// The frame just before, as it was tracked, and its image.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PreviousFrame<'a> {
    pub(crate) frame: &'a Frame,
    pub(crate) pyramid: &'a LkPyramid,
}

/// Suspects of the frame whose flow from the previous frame is that of the static scene become
/// static again and may be matched. Their landmarks get their labels at the next keyframe.
///
/// In residual form the predicted flow is that of a static point at the depth now measured under
/// the camera's motion.
pub(crate) fn restore_static(
    context: &Context,
    view: FrameView<'_>,
    previous: PreviousFrame<'_>,
    mut labels: FrameLabels,
    recorder: &mut Recorder,
) -> FrameLabels {
    let (camera, config) = (&context.camera, &context.config.flow);
    let (frame, last) = (view.frame, previous.frame);
    let Some(pyramid) = view.pyramid else {
        return labels;
    };
    if !config.enabled || last.id.0 + 1 != frame.id.0 {
        return labels;
    }
    let suspects: Vec<usize> = (0..frame.len())
        .filter(|&i| labels.label[i] == Label::Dynamic)
        .collect();
    let all_static: Vec<usize> = (0..frame.len())
        .filter(|&i| labels.in_use[i] && frame.uv_px[i].x.is_finite())
        .collect();
    if suspects.is_empty() || all_static.is_empty() {
        return labels;
    }
    let every = all_static.len().div_ceil(MAX_SUPPORT);
    let support: Vec<usize> = all_static.into_iter().step_by(every).collect();
    let tracked: Vec<usize> = support.iter().chain(&suspects).copied().collect();

    // Backwards in time, so that the points are this frame's keypoints.
    let points: Vec<[f32; 2]> = tracked.iter().map(|&i| lk_point(&frame.px[i])).collect();
    let predicted: Vec<Option<Vector2<f64>>> = tracked
        .iter()
        .map(|&i| {
            let p_world = frame.world_point(i, camera)?;
            let uv = camera.project(&(last.camera_from_world * p_world))?;
            Some(camera.distort_pixel(&uv))
        })
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
    let images = [pyramid, previous.pyramid];
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
        if verdict.is_some_and(|v| v.inside) {
            labels.label[i] = Label::Static;
            labels.in_use[i] = true;
        }
    }
    labels
}

#[cfg(test)]
mod tests {
    use garad_core::{FrameId, GrayImage, MaskImage};

    use super::*;
    use crate::config::Config;
    use crate::testing::{World, is_in, places, texture, wall, wall_behind};

    /// A frame with suspects, the frame just before, and their images.
    struct Scene {
        context: Context,
        last: Frame,
        now: Frame,
        images: [LkPyramid; 2],
        labels: FrameLabels,
    }

    impl Scene {
        fn new(world: World, last: Frame, now: Frame, images: [LkPyramid; 2]) -> Self {
            let labels = FrameLabels {
                label: vec![Label::Static; now.len()],
                in_use: vec![true; now.len()],
                suspect: vec![false; now.len()],
                cells: MaskImage::new(40, 30, 0),
            };
            Self {
                context: world.context,
                last,
                now,
                images,
                labels,
            }
        }

        /// The labels after the flow check.
        fn checked(&self) -> FrameLabels {
            let [before, now] = &self.images;
            let view = FrameView {
                frame: &self.now,
                depth: &wall(),
                pyramid: Some(now),
            };
            let previous = PreviousFrame {
                frame: &self.last,
                pyramid: before,
            };
            let (labels, recorder) = (self.labels.clone(), &mut Recorder::default());
            restore_static(&self.context, view, previous, labels, recorder)
        }

        fn restored(&self) -> usize {
            let after = self.checked();
            let changed = after.label.iter().zip(&self.labels.label);
            changed.filter(|(now, before)| now != before).count()
        }
    }

    /// What moves between the two images, and how far, px.
    const PATCH_PX: [[usize; 2]; 2] = [[48, 112], [32, 96]];
    const SHIFT_PX: usize = 3;

    /// A camera at rest: the second image is the first, but for a patch that moves to the left.
    /// Suspects are the inner part of the patch and a column of keypoints far from it.
    fn scene() -> (Scene, [Vec<usize>; 2]) {
        let world = World::new(Config::default());
        let first = texture();
        let second = GrayImage::from_fn(160, 120, |x, y| match is_in(PATCH_PX, x, y) {
            true => first[(x + SHIFT_PX, y)],
            false => first[(x, y)],
        });
        let pyramid = |image| LkPyramid::new(image, 1).expect("an image");
        let (last, now) = (world.frame(20, &wall()), world.frame(21, &wall()));
        let mut scene = Scene::new(world, last, now, [pyramid(&first), pyramid(&second)]);
        let places = places();
        let within = |area: [[usize; 2]; 2]| {
            let all = 0..places.len();
            all.filter(|&i| is_in(area, places[i][0], places[i][1]))
                .collect()
        };
        let moving: Vec<usize> = within([[60, 98], [44, 84]]);
        let still: Vec<usize> = within([[10, 26], [20, 100]]);
        let patch: Vec<usize> = within(PATCH_PX);
        let labels = &mut scene.labels;
        for &i in moving.iter().chain(&still) {
            labels.label[i] = Label::Dynamic;
        }
        for &i in moving.iter().chain(&still).chain(&patch) {
            labels.in_use[i] = false;
        }
        (scene, [moving, still])
    }

    #[test]
    fn suspects_that_flow_with_the_scene_are_static_again() {
        let (scene, [moving, still]) = scene();
        assert!(moving.len() >= 20 && still.len() == 20, "suspects");
        let now = scene.checked();
        assert_eq!(scene.restored(), still.len(), "some");
        for (what, suspects, label) in [
            ("still", still, Label::Static),
            ("moving", moving, Label::Dynamic),
        ] {
            for i in suspects {
                let is = (now.label[i], now.in_use[i]);
                assert_eq!(
                    is,
                    (label, label == Label::Static),
                    "{what}: {:?}",
                    scene.now.px[i]
                );
            }
        }
    }

    /// The camera has gone 10 cm to the right past a box at 1.5 m, in front of a wall at 3 m: with fx = 120 px the
    /// wall has gone 4 px to the left, and something at rest on the box 8 px. The suspects are on the box, which
    /// has gone `box_px`.
    fn past_a_box(box_px: usize) -> (Scene, Vec<usize>) {
        let world = World::new(Config::default());
        let first = texture();
        let at = |x: usize, y| first[(x.min(159), y)];
        let second = GrayImage::from_fn(160, 120, |x, y| match is_in(PATCH_PX, x, y) {
            true => at(x + box_px, y),
            false => at(x + 4, y),
        });
        let pyramid = |image| LkPyramid::new(image, 1).expect("an image");
        let last = world.frame(20, &wall());
        let mut now = world.frame(21, &wall_behind(PATCH_PX));
        now.camera_from_world.translation.x = -0.1;
        let mut scene = Scene::new(world, last, now, [pyramid(&first), pyramid(&second)]);
        let FrameLabels { label, in_use, .. } = &mut scene.labels;
        let mut suspects = Vec::new();
        for (i, [x, y]) in places().into_iter().enumerate() {
            in_use[i] = !is_in([[36, 124], [20, 108]], x, y);
            if is_in([[64, 98], [48, 84]], x, y) {
                label[i] = Label::Dynamic;
                suspects.push(i);
            }
        }
        (scene, suspects)
    }

    /// Near points flow further, as predicted: a suspect that flowed twice as far as the wall is static, and
    /// one that flowed as far as the wall has moved.
    #[test]
    fn predicted_flow_goes_the_way_of_the_flow() {
        for (box_px, label) in [(8, Label::Static), (4, Label::Dynamic)] {
            let (scene, suspects) = past_a_box(box_px);
            assert!(suspects.len() >= 16, "suspects");
            let now = scene.checked();
            let at_rest = suspects.iter().filter(|_| label == Label::Static).count();
            assert_eq!(scene.restored(), at_rest, "{box_px} px");
            assert!(
                suspects.iter().all(|i| now.label[*i] == label),
                "{box_px} px"
            );
        }
    }

    #[test]
    fn without_an_image_of_the_frame_just_before_suspects_stay() {
        let (mut scene, _) = scene();
        assert_eq!(scene.restored(), 20, "as it should be");
        scene.context.config.flow.enabled = false;
        assert_eq!(scene.restored(), 0, "switched off");
        scene.context.config.flow.enabled = true;
        scene.context.config.flow.min_support = 1000;
        assert_eq!(scene.restored(), 0, "too few to fit a model to");
        scene.context.config.flow.min_support = 10;
        scene.last.id = FrameId(19);
        assert_eq!(scene.restored(), 0, "a frame is missing in between");
    }
}
