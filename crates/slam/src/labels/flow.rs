//! The flow check (paper sec. III-B): a suspect that flows as the static scene does is static.

use garad_core::Label;
use garad_features::flow::{FlowPoint, verify_flow};
use garad_features::{LkConfig, LkPyramid, lk};
use nalgebra::Vector2;

use crate::frame::Frame;
use crate::refine::to_f32;
use crate::system::Slam;

/// Static points the model is made of at most.
const SUPPORT: usize = 200;

impl Slam {
    /// Suspects of the frame whose flow from the last frame is that of the static scene become
    /// static again and may be matched. Their landmarks get their labels at the next keyframe. Returns
    /// how many.
    ///
    /// In residual form the predicted flow is what the camera's motion does to a point at the depth
    /// now measured.
    pub(crate) fn recover_by_flow(&self, frame: &mut Frame, pyramid: &LkPyramid) -> usize {
        let config = &self.config.flow;
        let (Some(last), Some(before)) = (&self.last, &self.last_pyramid) else {
            return 0;
        };
        if !config.enabled || last.id.0 + 1 != frame.id.0 {
            return 0;
        }
        let suspects: Vec<usize> = (0..frame.len())
            .filter(|&i| frame.label[i] == Label::Dynamic)
            .collect();
        let all_static: Vec<usize> = (0..frame.len())
            .filter(|&i| frame.in_use[i] && frame.uv_px[i].x.is_finite())
            .collect();
        if suspects.is_empty() || all_static.is_empty() {
            return 0;
        }
        let every = all_static.len().div_ceil(SUPPORT);
        let support: Vec<usize> = all_static.into_iter().step_by(every).collect();
        let asked: Vec<usize> = support.iter().chain(&suspects).copied().collect();

        // Backwards, so that the points are this frame's keypoints.
        let points: Vec<[f32; 2]> = asked.iter().map(|&i| to_f32(&frame.px[i])).collect();
        let predicted: Vec<Option<Vector2<f64>>> = asked
            .iter()
            .map(|&i| {
                let p_world = frame.world_point(i, &self.camera)?;
                let uv = self.camera.project(&(last.camera_from_world * p_world))?;
                Some(self.camera.distort_pixel(&uv))
            })
            .collect();
        let starts: Vec<[f32; 2]> = predicted
            .iter()
            .zip(&points)
            .map(|(to, from)| to.as_ref().map_or(*from, to_f32))
            .collect();
        let lk_config = LkConfig {
            max_residual: Some(self.config.refine.max_residual),
            ..LkConfig::default()
        };
        let Ok(tracks) = lk::track(
            pyramid,
            before,
            &points,
            Some(&starts),
            &lk_config,
            self.par,
        ) else {
            return 0;
        };
        self.tape.put("flow_lk", |page| {
            page.tracks([pyramid, before], [&points, &starts], &tracks);
        });
        let flow = |k: usize| {
            let from = Vector2::from(points[k].map(f64::from));
            tracks[k].is_tracked().then(|| FlowPoint {
                flow: Vector2::from(tracks[k].xy.map(f64::from)) - from,
                predicted: predicted[k].map(|to| to - from),
            })
        };
        let model: Vec<FlowPoint> = (0..support.len()).filter_map(flow).collect();
        let (asked, flows): (Vec<usize>, Vec<FlowPoint>) = (support.len()..asked.len())
            .filter_map(|k| Some((asked[k], flow(k)?)))
            .unzip();
        let Ok(answer) = verify_flow(&model, &flows, config) else {
            return 0;
        };
        self.tape
            .put("flow", |page| page.flow(&model, &flows, &answer));
        let (mut label, mut in_use) = (frame.label.clone(), frame.in_use.clone());
        let mut recovered = 0;
        for (i, verdict) in asked.into_iter().zip(answer.verdicts) {
            if verdict.is_some_and(|v| v.inside) {
                label[i] = Label::Static;
                in_use[i] = true;
                recovered += 1;
            }
        }
        frame.set_labels(label, in_use, &self.camera);
        recovered
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use garad_core::{FrameId, GrayImage};

    use super::*;
    use crate::config::Config;
    use crate::labels::frame::tests::{frame, is_in, places, slam, texture, wall, wall_behind};

    /// What moves between the two pictures, and how far, px.
    const PATCH_PX: [[usize; 2]; 2] = [[48, 112], [32, 96]];
    const SHIFT_PX: usize = 3;

    /// A camera at rest: the second picture is the first, but for a patch that moves to the left.
    /// Suspects are the inner part of the patch and a column of keypoints far from it.
    fn scene(config: Config) -> (Slam, Frame, LkPyramid, [Vec<usize>; 2]) {
        let mut slam = slam(config);
        let first = texture();
        let second = GrayImage::from_fn(160, 120, |x, y| match is_in(PATCH_PX, x, y) {
            true => first[(x + SHIFT_PX, y)],
            false => first[(x, y)],
        });
        let pyramid = |image| LkPyramid::new(image, 1).expect("a picture");
        slam.last = Some(frame(&slam, 20, &wall()));
        slam.last_pyramid = Some(Arc::new(pyramid(&first)));
        let mut now = frame(&slam, 21, &wall());
        let places = places();
        let within = |area: [[usize; 2]; 2]| {
            let all = 0..places.len();
            all.filter(|&i| is_in(area, places[i][0], places[i][1]))
                .collect()
        };
        let moving: Vec<usize> = within([[60, 98], [44, 84]]);
        let still: Vec<usize> = within([[10, 26], [20, 100]]);
        let mut label = vec![Label::Static; now.len()];
        for &i in moving.iter().chain(&still) {
            label[i] = Label::Dynamic;
        }
        let patch: Vec<usize> = within(PATCH_PX);
        let in_use = (0..now.len()).map(|i| label[i] == Label::Static && !patch.contains(&i));
        let in_use = in_use.collect();
        now.set_labels(label, in_use, &slam.camera);
        (slam, now, pyramid(&second), [moving, still])
    }

    #[test]
    fn who_flows_with_the_scene_is_static_again() {
        let (slam, mut now, pyramid, [moving, still]) = scene(Config::default());
        assert!(moving.len() >= 20 && still.len() == 20, "suspects");
        assert_eq!(
            slam.recover_by_flow(&mut now, &pyramid),
            still.len(),
            "some"
        );
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
                    now.px[i]
                );
            }
        }
    }

    /// The camera has gone 10 cm to the right past a box at 1.5 m, in front of a wall at 3 m: with fx = 120 px the
    /// wall has gone 4 px to the left, and something at rest on the box 8 px. The suspects are on the box, which
    /// has gone `box_px`.
    fn past_a_box(box_px: usize) -> (Slam, Frame, LkPyramid, Vec<usize>) {
        let mut slam = slam(Config::default());
        let first = texture();
        let at = |x: usize, y| first[(x.min(159), y)];
        let second = GrayImage::from_fn(160, 120, |x, y| match is_in(PATCH_PX, x, y) {
            true => at(x + box_px, y),
            false => at(x + 4, y),
        });
        let pyramid = |image| LkPyramid::new(image, 1).expect("a picture");
        slam.last = Some(frame(&slam, 20, &wall()));
        slam.last_pyramid = Some(Arc::new(pyramid(&first)));
        let mut now = frame(&slam, 21, &wall_behind(PATCH_PX));
        now.camera_from_world.translation.x = -0.1;
        let mut label = vec![Label::Static; now.len()];
        let mut in_use = vec![true; now.len()];
        let mut suspects = Vec::new();
        for (i, [x, y]) in places().into_iter().enumerate() {
            in_use[i] = !is_in([[36, 124], [20, 108]], x, y);
            if is_in([[64, 98], [48, 84]], x, y) {
                label[i] = Label::Dynamic;
                suspects.push(i);
            }
        }
        now.set_labels(label, in_use, &slam.camera);
        (slam, now, pyramid(&second), suspects)
    }

    /// What is near flows further. The prediction knows, so who has flowed twice as far as the wall is at rest, and
    /// who has kept up with the wall has moved.
    #[test]
    fn predicted_flow_goes_the_way_of_the_flow() {
        for (box_px, label) in [(8, Label::Static), (4, Label::Dynamic)] {
            let (slam, mut now, pyramid, suspects) = past_a_box(box_px);
            assert!(suspects.len() >= 16, "suspects");
            let recovered = slam.recover_by_flow(&mut now, &pyramid);
            let at_rest = suspects.iter().filter(|_| label == Label::Static).count();
            assert_eq!(recovered, at_rest, "{box_px} px");
            assert!(
                suspects.iter().all(|i| now.label[*i] == label),
                "{box_px} px"
            );
        }
    }

    #[test]
    fn without_a_picture_of_just_before_suspects_stay() {
        let (mut slam, now, pyramid, _) = scene(Config::default());
        let recovered = |slam: &Slam| slam.recover_by_flow(&mut now.clone(), &pyramid);
        assert_eq!(recovered(&slam), 20, "as it should be");
        slam.config.flow.enabled = false;
        assert_eq!(recovered(&slam), 0, "switched off");
        slam.config.flow.enabled = true;
        slam.config.flow.min_support = 1000;
        assert_eq!(recovered(&slam), 0, "too few to make a model of");
        slam.config.flow.min_support = 10;
        if let Some(last) = &mut slam.last {
            last.id = FrameId(19);
        }
        assert_eq!(recovered(&slam), 0, "a frame is missing in between");
        slam.last_pyramid = None;
        assert_eq!(recovered(&slam), 0, "no picture");
    }
}
