//! The flow check (paper sec. III-B): a suspect that flows as the static scene does is static.

use garad_core::Label;
use garad_features::flow::{FlowPoint, verify_flow};
use garad_features::{LkConfig, LkPyramid, lk};
use nalgebra::Vector2;

use crate::frame::Frame;
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
        let Ok(answer) = verify_flow(&model, &flows, &config.check()) else {
            return 0;
        };
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

#[allow(clippy::cast_possible_truncation, reason = "the tracker works in f32")]
fn to_f32(p: &Vector2<f64>) -> [f32; 2] {
    [p.x as f32, p.y as f32]
}
