//! Image quality of the map: every frame against the render from its estimated pose.

use anyhow::Result;
use garad_core::undistort::Undistortion;
use garad_core::{Camera, DepthImage, Distortion, GaussianMap, Par, RgbImage, StampedPose};
use garad_eval::{DepthMetrics, GHOST_GAP_M, RenderMetrics, compare_images, depth_l1, ghosts};
use garad_raster::{Include, RenderOptions, fast};

use crate::progress::Progress;
use crate::source::SourceFrame;

/// Means over frames.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct RenderQuality {
    /// Whole image.
    pub all: RenderMetrics,
    /// Outside the mask (255 moving, 128 unknown); only frames with a mask count.
    pub outside_mask: RenderMetrics,
    /// Rendered depth against measured depth, outside the mask.
    pub depth: DepthMetrics,
    /// Frames evaluated.
    pub frames: usize,
}

/// PSNR, SSIM and depth error of the static Gaussians, means over the frames that have a pose.
///
/// Images of a distorted camera are undistorted first (bilinear); pixels outside the distorted image do not
/// count. Frames that cannot be read are left out, like frames without a pose.
///
/// # Errors
/// If the map cannot be rendered.
pub fn judge(
    map: &GaussianMap,
    camera: &Camera,
    trajectory: &[StampedPose],
    frames: impl Iterator<Item = Result<SourceFrame>>,
    par: Par,
    quiet: bool,
) -> Result<RenderQuality> {
    let pinhole = Camera {
        distortion: Distortion::default(),
        ..*camera
    };
    let straight = Undistortion::new(camera);
    let unseen = straight.unseen();
    let options = RenderOptions {
        include: Include::StaticOnly,
        ..RenderOptions::default()
    };
    let (mut all, mut outside) = (Sums::default(), Sums::default());
    let mut depth = DepthSums::default();
    let mut progress = Progress::new("judging", trajectory.len(), quiet);
    for frame in frames.flatten() {
        let Some(pose) = pose_at(trajectory, frame.t_s) else {
            continue;
        };
        let camera_from_world = pose.world_from_camera.inverse();
        let rendered = fast::render(map, &pinhole, &camera_from_world, &options, par)?;
        let color = crate::images::color_image(&rendered);
        let truth = straightened(&straight, &frame.rgb, par);
        all.add(compare_images(&color, &truth, Some(&unseen), par)?);
        let mask = frame.truth.as_ref().or(frame.mask.as_ref());
        let mask = mask.map(|m| straight.nearest(m, 255));
        let measured = straight.nearest(&frame.depth, 0.0);
        let drawn = rendered.normalized_depth();
        if let Ok(error) = depth_l1(&drawn, &measured, mask.as_ref()) {
            depth.add(error);
        }
        let background = nearest_around(&measured);
        if let Ok(found) = ghosts(&drawn, &background, mask.as_ref(), GHOST_GAP_M) {
            depth.ghosts += found.fraction;
        }
        if let Some(mask) = mask
            && let Ok(quality) = compare_images(&color, &truth, Some(&mask), par)
        {
            outside.add(quality);
        }
        progress.step("");
    }
    progress.finish();
    Ok(RenderQuality {
        all: all.mean(),
        outside_mask: outside.mean(),
        depth: depth.mean(),
        frames: all.count,
    })
}

/// The pose of this very time stamp, to the microsecond that trajectory files hold.
fn pose_at(trajectory: &[StampedPose], t_s: f64) -> Option<&StampedPose> {
    let first = trajectory.partition_point(|p| p.t_s < t_s - 1e-6);
    trajectory
        .get(first)
        .filter(|p| (p.t_s - t_s).abs() <= 1e-6)
}

/// The undistorted image, in 8 bits.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a value in [0, 1] times 255, rounded"
)]
fn straightened(straight: &Undistortion, rgb: &RgbImage, par: Par) -> RgbImage {
    let to_u8 = |v: f32| (v * 255.0 + 0.5) as u8;
    straight.color(rgb, par).map(|c| c.map(to_u8))
}

/// Radius in which the nearest measured depth counts as the background: a splat at an edge extends a few
/// pixels over it, and colour and depth are misaligned by a few pixels.
const EDGE_PX: usize = 6;

/// The smallest measured depth in the square of [`EDGE_PX`] around each pixel that has a depth.
fn nearest_around(depth: &DepthImage) -> DepthImage {
    let (width, height) = depth.size();
    let least = |values: &mut dyn Iterator<Item = f32>| {
        let known = values.filter(|z| *z > 0.0);
        known.fold(f32::INFINITY, f32::min)
    };
    let around = |c: usize, n: usize| c.saturating_sub(EDGE_PX)..(c + EDGE_PX + 1).min(n);
    let rows = DepthImage::from_fn(width, height, |x, y| {
        least(&mut depth.row(y)[around(x, width)].iter().copied())
    });
    DepthImage::from_fn(width, height, |x, y| {
        if depth[(x, y)] > 0.0 {
            least(&mut around(y, height).map(|y| rows[(x, y)]))
        } else {
            0.0
        }
    })
}

#[derive(Default)]
struct Sums {
    psnr_db: f64,
    ssim: f64,
    count: usize,
}

impl Sums {
    fn add(&mut self, quality: garad_eval::ImageQuality) {
        // Equal images have no finite PSNR; 100 dB is beyond any 8-bit difference.
        self.psnr_db += quality.psnr_db.min(100.0);
        self.ssim += quality.ssim;
        self.count += 1;
    }

    fn mean(&self) -> RenderMetrics {
        let mean = |sum: f64| (self.count > 0).then(|| sum / self.count as f64);
        RenderMetrics {
            psnr_db: mean(self.psnr_db),
            ssim: mean(self.ssim),
        }
    }
}

#[derive(Default)]
struct DepthSums {
    l1_m: f64,
    coverage: f64,
    ghosts: f64,
    count: usize,
}

impl DepthSums {
    fn add(&mut self, error: garad_eval::DepthL1) {
        self.l1_m += error.mean_m;
        self.coverage += error.coverage;
        self.count += 1;
    }

    fn mean(&self) -> DepthMetrics {
        let mean = |sum: f64| (self.count > 0).then(|| sum / self.count as f64);
        DepthMetrics {
            l1_m: mean(self.l1_m),
            coverage: mean(self.coverage),
            ghosts: mean(self.ghosts),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::Se3;

    #[test]
    fn edges_are_not_ghosts() {
        let mut depth = DepthImage::new(20, 3, 4.0);
        depth[(2, 1)] = 1.0;
        depth[(15, 1)] = 0.0;
        let nearest = nearest_around(&depth);
        assert_eq!(
            (nearest[(8, 2)], nearest[(9, 2)], nearest[(15, 1)]),
            (1.0, 4.0, 0.0),
            "six pixels away, seven, unknown"
        );
    }

    #[test]
    fn poses_are_found_by_their_time() {
        let pose = |t_s| StampedPose {
            t_s,
            world_from_camera: Se3::identity(),
        };
        let path = [pose(1.0), pose(1.033_333), pose(1.066_667)];
        let found = pose_at(&path, 1.033_333_3).expect("within a microsecond");
        assert!((found.t_s - 1.033_333).abs() < 1e-9, "the second");
        assert!(pose_at(&path, 1.05).is_none(), "between two");
        assert!(pose_at(&path, 2.0).is_none(), "after the last");
    }
}
