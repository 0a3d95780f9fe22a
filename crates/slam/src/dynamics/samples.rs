//! [`Sample`]: the nodes of a frame's field, keypoints with depth and a lattice of pixels.

use garad_core::{Camera, DepthImage, MaskImage};
use garad_features::LkPyramid;
use nalgebra::{Vector2, Vector3};

use crate::context::Context;
use crate::frame::Frame;
use crate::mask::CELL_PX;

/// A frame to be labelled, and its images.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FrameView<'a> {
    pub(crate) frame: &'a Frame,
    pub(crate) depth: &'a DepthImage,
    pub(crate) pyramid: Option<&'a LkPyramid>,
}

/// One sample in the field.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sample {
    pub(crate) px: Vector2<f64>,
    pub(crate) depth_m: f64,
    pub(crate) p_world: Vector3<f64>,
}

/// Keypoints with depth, by index.
pub(crate) fn keypoint_samples(frame: &Frame, camera: &Camera) -> Vec<(usize, Sample)> {
    (0..frame.len())
        .filter_map(|i| {
            let sample = Sample {
                px: frame.px[i],
                depth_m: frame.depth_m[i]?,
                p_world: frame.world_point(i, camera)?,
            };
            let finite = sample.p_world.iter().all(|v| v.is_finite());
            finite.then_some((i, sample))
        })
        .collect()
}

/// The lattice of samples: one pixel at the centre of every block.
#[derive(Debug, Clone)]
pub(crate) struct Lattice {
    pub(super) step_px: usize,
    pub(super) columns: usize,
    pub(super) rows: usize,
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

    /// Pixel and depth of every sample: the depth nearest to the centre of its block.
    fn depths(&self, depth: &DepthImage, max_depth_m: f64) -> Vec<Option<([usize; 2], f64)>> {
        let (width, height) = depth.size();
        let half = self.step_px / 2;
        (0..self.len())
            .map(|i| {
                let x = ((i % self.columns) * self.step_px + half).min(width - 1);
                let y = ((i / self.columns) * self.step_px + half).min(height - 1);
                // Outwards along the row and the column: a hole in the depth is often small.
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

    /// Nothing moves in a block of a mask in cells.
    pub(crate) fn clear(&self, cells: &mut MaskImage, block: usize) {
        let (column, row) = (block % self.columns, block / self.columns);
        let first = |c: usize| (c * self.step_px).div_ceil(CELL_PX);
        for y in first(row)..first(row + 1).min(cells.height()) {
            let end = first(column + 1).min(cells.width());
            cells.row_mut(y)[first(column)..end].fill(0);
        }
    }

    /// The samples of a frame, block by block; `None` without depth nearby.
    pub(crate) fn samples(
        &self,
        frame: &Frame,
        depth: &DepthImage,
        context: &Context,
    ) -> Vec<Option<Sample>> {
        let camera = &context.camera;
        let world_from_camera = frame.camera_from_world.inverse();
        let depths = self.depths(depth, context.config.features.max_depth_m);
        let sample = |found: Option<([usize; 2], f64)>| {
            let ([x, y], depth_m) = found?;
            let px = Vector2::new(x as f64, y as f64);
            let uv_px = camera.undistort_pixel(&px)?;
            Some(Sample {
                px,
                depth_m,
                p_world: world_from_camera * camera.unproject(&uv_px, depth_m),
            })
        };
        depths.into_iter().map(sample).collect()
    }
}

#[cfg(test)]
mod tests {
    use garad_core::{Distortion, Se3};
    use nalgebra::Vector6;

    use super::*;
    use crate::config::Config;
    use crate::testing::{World, keypoints, wall};

    #[test]
    fn samples_search_beside_a_hole() {
        let lattice = Lattice::new(&World::new(Config::default()).context.camera, 16);
        let mut depth = wall();
        for (x, y) in [(8, 8), (9, 8), (7, 8), (8, 9)] {
            depth[(x, y)] = 0.0;
        }
        for y in 0..16 {
            depth.row_mut(y)[16..48].fill(0.0);
        }
        depth[(40, 8)] = 8.5;
        let samples = lattice.depths(&depth, 8.0);
        assert_eq!(samples.len(), 80, "10 x 8");
        assert_eq!(samples[0], Some(([8, 7], 3.0)), "above the hole");
        assert_eq!(samples[1], None, "nothing in reach");
        assert_eq!(samples[2], None, "too far");
        assert_eq!(samples[3], Some(([56, 8], 3.0)), "the middle of its block");
    }

    /// 160 x 120 pixels are 40 x 30 cells of 4 px.
    #[test]
    fn clearing_a_block_clears_its_cells_alone() {
        let camera = World::new(Config::default()).context.camera;
        let cleared = |step_px, block| {
            let mut cells = MaskImage::new(40, 30, 255);
            Lattice::new(&camera, step_px).clear(&mut cells, block);
            let places = (0..30).flat_map(|y| (0..40).map(move |x| (x, y)));
            places.filter(|at| cells[*at] == 0).collect::<Vec<_>>()
        };
        // Blocks of 16 px, 10 to the row, are 4 x 4 cells.
        let block = |x0: usize, y0: usize, rows: usize| -> Vec<_> {
            let rows = y0..y0 + rows;
            rows.flat_map(|y| (x0..x0 + 4).map(move |x| (x, y)))
                .collect()
        };
        assert_eq!(cleared(16, 0), block(0, 0, 4), "the first");
        assert_eq!(cleared(16, 23), block(12, 8, 4), "column 3, row 2");
        assert_eq!(cleared(16, 79), block(36, 28, 2), "the last, cut off");
        // Blocks of 10 px begin within cells; a cell belongs to the block that its first pixel is in.
        assert_eq!(
            cleared(10, 1),
            [(3, 0), (4, 0), (3, 1), (4, 1), (3, 2), (4, 2)]
        );
        let mut of_all: Vec<_> = (0..16 * 12).flat_map(|b| cleared(10, b)).collect();
        of_all.sort_unstable();
        let count = of_all.len();
        of_all.dedup();
        assert_eq!((count, of_all.len()), (1200, 1200), "each cell once");
    }

    /// 70 x 50 pixels of a lens with distortion: 5 x 4 blocks of 16 px, the last ones cut off.
    fn world() -> World {
        let mut camera = Camera::pinhole((70, 50), [60.0, 50.0, 36.0, 22.0]).expect("valid");
        camera.distortion = Distortion {
            k1: -0.2,
            ..Distortion::default()
        };
        World::with_camera(camera, Config::default())
    }

    fn pose() -> Se3 {
        Se3::exp(&Vector6::new(0.3, -0.2, 0.5, 0.2, -0.1, 0.4))
    }

    /// The point of the world whose image is recorded at this pixel, typed again.
    fn expected(camera: &Camera, [x, y]: [f64; 2], depth_m: f64) -> Vector3<f64> {
        let uv = camera.undistort_pixel(&Vector2::new(x, y)).expect("inside");
        let ray = Vector3::new((uv.x - 36.0) / 60.0, (uv.y - 22.0) / 50.0, 1.0);
        pose().rotation.matrix().transpose() * (ray * depth_m - pose().translation)
    }

    fn assert_sample(sample: &Sample, camera: &Camera, px: [f64; 2], depth_m: f64) {
        assert_eq!(sample.px, Vector2::from(px), "recorded pixel");
        assert!((sample.depth_m - depth_m).abs() < 1e-6, "{px:?}");
        let off = (sample.p_world - expected(camera, px, depth_m)).norm();
        assert!(off < 1e-6, "{px:?}: {off} m");
    }

    #[test]
    fn keypoints_with_depth_are_samples_under_their_own_index() {
        let world = world();
        let camera = &world.context.camera;
        let depth = DepthImage::from_fn(70, 50, |x, _| if x < 30 { 2.0 } else { 3.0 });
        let places = keypoints([[5, 7], [29, 20], [60, 40], [12, 33]]);
        let mut frame = world.frame_of(0, &places, &depth);
        frame.camera_from_world = pose();
        let samples = keypoint_samples(&frame, camera);
        let indices: Vec<usize> = samples.iter().map(|(i, _)| *i).collect();
        assert_eq!(indices, [0, 2, 3], "the second is on a depth edge");
        for ((_, sample), (px, depth_m)) in
            samples
                .iter()
                .zip([([5.0, 7.0], 2.0), ([60.0, 40.0], 3.0), ([12.0, 33.0], 2.0)])
        {
            assert_sample(sample, camera, px, depth_m);
        }
        frame.uv_px[2].x = f64::NAN;
        let indices = keypoint_samples(&frame, camera).into_iter().map(|(i, _)| i);
        assert_eq!(Vec::from_iter(indices), [0, 3], "one has no ideal pixel");
    }

    #[test]
    fn a_sample_is_the_middle_of_its_block_in_the_world() {
        let mut world = world();
        world.context.config.features.max_depth_m = 2.5;
        let depth = DepthImage::from_fn(70, 50, |x, _| if x < 48 { 2.0 } else { 2.6 });
        let mut frame = world.frame_of(0, &[], &depth);
        frame.camera_from_world = pose();
        let lattice = Lattice::new(&world.context.camera, 16);
        assert_eq!((lattice.columns, lattice.rows, lattice.len()), (5, 4, 20));
        let samples = lattice.samples(&frame, &depth, &world.context);
        assert_eq!(samples.len(), 20, "blocks");
        for (i, sample) in samples.iter().enumerate() {
            let (column, row) = (i % 5, i / 5);
            let px = [16 * column + 8, (16 * row + 8).min(49)].map(|c| c as f64);
            match sample {
                Some(sample) => assert_sample(sample, &world.context.camera, px, 2.0),
                None => assert!(column > 2, "block {i} has depth"),
            }
            assert_eq!(sample.is_some(), column < 3, "block {i}: 2.6 m is too far");
        }
    }

    /// A hole of the sensor around (24, 24): the nearest depth is taken, right before left before below before above,
    /// and none from 8 px on.
    #[test]
    fn beside_a_hole_the_order_is_right_left_below_above() {
        let lattice = Lattice::new(&world().context.camera, 16);
        let at = |filled: &[(usize, usize)]| {
            let mut depth = DepthImage::new(70, 50, 0.0);
            for (k, place) in filled.iter().enumerate() {
                depth[*place] = 1.0 + k as f32;
            }
            let found = lattice.depths(&depth, 8.0)[6];
            found.map(|([x, y], _)| (x, y))
        };
        let [right, left, below, above] = [(27, 24), (21, 24), (24, 27), (24, 21)];
        assert_eq!(at(&[above, below, left, right]), Some(right));
        assert_eq!(at(&[above, below, left]), Some(left));
        assert_eq!(at(&[above, below]), Some(below));
        assert_eq!(at(&[above, (28, 24)]), Some(above), "nearer");
        assert_eq!(at(&[(31, 24)]), Some((31, 24)), "7 px");
        assert_eq!(
            at(&[(32, 24), (16, 24), (24, 32), (24, 16), (27, 27)]),
            None
        );
    }
}
