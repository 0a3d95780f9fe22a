//! [`Moment`]: a snapshot drawn for the report.

use anyhow::Result;
use garad_core::{Par, RgbImage};
use garad_eval::report::Strip;
use garad_eval::{ImageQuality, compare_images};
use garad_raster::{Include, RenderOptions, fast};

use crate::images;
use crate::run::RunResult;
use crate::run::snapshot::Snapshot;

/// A snapshot with its labels and, if the frame has a pose, what the static part of the map shows from it.
pub(super) struct Moment<'a> {
    snapshot: &'a Snapshot,
    labels: RgbImage,
    rendered: Option<View>,
}

struct View {
    color: RgbImage,
    depth: RgbImage,
    /// Outside the mask, if there is one; `None` where it covers the image.
    quality: Option<ImageQuality>,
}

impl<'a> Moment<'a> {
    pub(super) fn draw(result: &RunResult, snapshot: &'a Snapshot) -> Result<Self> {
        let mut poses = result.trajectory.iter();
        let pose = poses.find(|p| p.t_s.to_bits() == snapshot.t_s.to_bits());
        let rendered = match pose {
            None => None,
            Some(pose) => {
                let par = Par::new(result.threads);
                let options = RenderOptions {
                    include: Include::StaticOnly,
                    ..RenderOptions::default()
                };
                let camera_from_world = pose.world_from_camera.inverse();
                let (map, camera) = (result.gaussians(), result.slam.camera());
                let rendered = fast::render(map, camera, &camera_from_world, &options, par)?;
                let depth = rendered.normalized_depth();
                let color = images::color_image(&rendered);
                // People are not in the map: what they cover is not compared.
                let mask = snapshot.truth.as_ref().or(snapshot.mask.as_ref());
                Some(View {
                    quality: compare_images(&color, &snapshot.rgb, mask, par).ok(),
                    depth: images::depth_image(&depth, images::depth_range(&depth)),
                    color,
                })
            }
        };
        Ok(Self {
            snapshot,
            labels: images::keypoint_image(snapshot),
            rendered,
        })
    }

    /// File names and images.
    pub(super) fn images(&self) -> Vec<(String, &RgbImage)> {
        let mut images = vec![("input", &self.snapshot.rgb), ("labels", &self.labels)];
        if let Some(view) = &self.rendered {
            images.extend([("render", &view.color), ("depth", &view.depth)]);
        }
        let named = |(name, image)| (format!("{:06}_{name}.png", self.snapshot.frame), image);
        images.into_iter().map(named).collect()
    }

    /// What the static part of the map shows, if the frame has a pose.
    pub(super) fn into_color(self) -> Option<RgbImage> {
        self.rendered.map(|view| view.color)
    }

    pub(super) fn strip(&self) -> Strip<'_> {
        Strip {
            frame: self.snapshot.frame,
            t_s: self.snapshot.t_s,
            input: &self.snapshot.rgb,
            render: self.rendered.as_ref().map(|view| &view.color),
            labels: Some(&self.labels),
            quality: self.rendered.as_ref().and_then(|view| view.quality),
            outside_mask: self.snapshot.truth.is_some() || self.snapshot.mask.is_some(),
        }
    }
}
