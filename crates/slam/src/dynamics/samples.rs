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
    use super::*;
    use crate::config::Config;
    use crate::testing::{World, wall};

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
}
