//! The Gaussian mask (sec. III-A, III-B): the dynamic Gaussians, rendered where the camera is expected, bring their label back to
//! the keypoints through the levels of the image pyramid (decision 020).
//!
//! ```text
//! dynamic Gaussians ─→ rendered at levels 2, 1, 0 ─→ keypoints in the mask: suspects ─→ flow check ─→ FrameLabels
//!                                                                                          │
//!                                        landmarks restored, and their Gaussians at the next job ←─┘
//! ```

use std::borrow::Cow;

use garad_core::{Camera, DepthImage, GaussianMap, Label, LandmarkId, MaskImage};
use garad_features::LkPyramid;
use garad_raster::fast::{Coverage, coverage};
use nalgebra::{Vector2, Vector3};

use super::flow_check::at_rest;
use super::mask::{label_at, mask_from_beliefs};
use super::past::{ReferenceImage, nearest_to_rest};
use super::samples::{FrameView, Lattice, Sample, keypoint_samples};
use crate::config::GaussianMaskConfig;
use crate::context::Context;
use crate::frame::keypoint_depth::nearest_pixel;
use crate::frame::{Frame, FrameLabels};
use crate::map::Map;
use crate::mapping::coarse_to_fine::TOP_LEVEL;
use crate::mask::{self, CELL_PX, MOVING};
use crate::trace::Recorder;

/// The dynamic Gaussians rendered alone, at every level of eq. 16, the full image first.
#[derive(Debug)]
pub(crate) struct GaussianMask<'a> {
    config: &'a GaussianMaskConfig,
    levels: Vec<Coverage>,
}

impl<'a> GaussianMask<'a> {
    /// Renders them from the frame's pose, without those whose surface has gone: at their means the frame's depth, if
    /// it is known and to be compared, is another.
    pub(crate) fn render(
        context: &'a Context,
        dynamic: &GaussianMap,
        frame: &Frame,
        depth: &DepthImage,
    ) -> Self {
        let (camera, config) = (&context.camera, &context.config.labels.gaussian_mask);
        let is_there = |mean: &[f32; 3]| {
            let p_cam = frame.camera_from_world * Vector3::from(mean.map(f64::from));
            let px = camera
                .project(&p_cam)
                .map(|uv_px| camera.distort_pixel(&uv_px));
            let at = px.and_then(|px| nearest_pixel(&px, depth.size()));
            let measured_m = at.map(|at| f64::from(depth[at])).filter(|z| *z > 0.0);
            measured_m.is_none_or(|z| (z - p_cam.z).abs() < config.depth_m)
        };
        let mut dynamic = Cow::Borrowed(dynamic);
        if config.depth_m > 0.0 {
            let keep: Vec<bool> = dynamic.means.iter().map(is_there).collect();
            dynamic.to_mut().retain(|i| keep[i]);
        }
        let level = |level| {
            let camera = context.camera.level(level);
            coverage(&dynamic, &camera, &frame.camera_from_world, context.par)
                .expect("the Gaussians of a map and a finite pose")
        };
        Self {
            config,
            levels: (0..=TOP_LEVEL).map(level).collect(),
        }
    }

    /// The label at a pixel of the undistorted image, for a keypoint of this scale: it is looked up in the level
    /// whose scale 2ˡ is nearest to its own, by their ratio. Dynamic where the accumulated opacity is above
    /// `opacity`, and the depth, if it is known and to be compared, is that of the rendered surface.
    pub(crate) fn label(&self, uv_px: &Vector2<f64>, scale: f64, depth_m: Option<f64>) -> Label {
        let is_past = |level: &usize| scale * scale > 2.0 * f64::from(1u32 << (2 * level));
        let level = (0..TOP_LEVEL).take_while(is_past).count();
        self.label_at_level(level, uv_px, depth_m)
    }

    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "float to integer saturates; `get` refuses what lies outside"
    )]
    fn label_at_level(&self, level: usize, uv_px: &Vector2<f64>, depth_m: Option<f64>) -> Label {
        let rendered = &self.levels[level];
        let at = uv_px / f64::from(1u32 << level) + Vector2::new(0.5, 0.5);
        let at = (at.x >= 0.0 && at.y >= 0.0).then_some((at.x as usize, at.y as usize));
        let pixel = at.and_then(|at| Some((at, f64::from(*rendered.opacity.get(at.0, at.1)?))));
        let is_moving = pixel.is_some_and(|(at, opacity)| {
            let rendered_m = f64::from(rendered.depth[at]) / opacity;
            let is_surface = |z: f64| (z - rendered_m).abs() < self.config.depth_m;
            let compared = depth_m.filter(|_| self.config.depth_m > 0.0);
            opacity > self.config.opacity && compared.is_none_or(is_surface)
        });
        match is_moving {
            true => Label::Dynamic,
            false => Label::Static,
        }
    }

    /// The mask in cells of the recorded image.
    fn cells(&self, centres: &CellCentres) -> MaskImage {
        MaskImage::from_fn(centres.columns, centres.rows, |x, y| {
            let uv_px = centres.uv_px[y * centres.columns + x];
            match uv_px.map(|uv_px| self.label_at_level(TOP_LEVEL, &uv_px, None)) {
                Some(Label::Dynamic) => MOVING,
                _ => 0,
            }
        })
    }
}

/// The centres of the cells of a mask in the undistorted image, px; `None` outside of it.
#[derive(Debug, Clone)]
pub(crate) struct CellCentres {
    columns: usize,
    rows: usize,
    uv_px: Vec<Option<Vector2<f64>>>,
}

impl CellCentres {
    pub(crate) fn new(camera: &Camera) -> Self {
        let (columns, rows) = (
            camera.width.div_ceil(CELL_PX),
            camera.height.div_ceil(CELL_PX),
        );
        let centre = |c: usize| (c * CELL_PX) as f64 + (CELL_PX as f64 - 1.0) / 2.0;
        let cells = (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y)));
        let uv_px = |(x, y)| camera.undistort_pixel(&Vector2::new(centre(x), centre(y)));
        Self {
            columns,
            rows,
            uv_px: cells.map(uv_px).collect(),
        }
    }
}

/// What a frame's labels are made of, beside the frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MaskLabelling<'a> {
    pub(crate) dynamic: &'a GaussianMap,
    pub(crate) map: &'a Map,
    pub(crate) lattice: &'a Lattice,
    /// Needed unless the mask is carried along surfaces (`surface_share`).
    pub(crate) centres: Option<&'a CellCentres>,
    pub(crate) references: &'a [ReferenceImage<'a>],
}

/// Labels a frame's keypoints by the Gaussian mask: those in it are suspects, and the flow check sets some static
/// again, with their landmarks. Samples of the lattice are checked in the same way, so that the
/// mask loses the blocks that are at rest.
pub(crate) fn label_by_mask(
    context: &Context,
    view: FrameView<'_>,
    given: MaskLabelling<'_>,
    recorder: &mut Recorder,
) -> FrameLabels {
    let FrameView { frame, depth, .. } = view;
    let (camera, config) = (&context.camera, &context.config.labels);
    let mask = GaussianMask::render(context, given.dynamic, frame, depth);
    let scale = |i: usize| context.scales[usize::from(frame.keypoints[i].level)];
    let label = (0..frame.len()).map(|i| mask.label(&frame.uv_px[i], scale(i), frame.depth_m[i]));
    let mut label: Vec<Label> = label.collect();
    let keypoints = keypoint_samples(frame, camera);
    let blocks = given.lattice.samples(frame, depth, context);
    let label_of_block = |sample: &Sample| {
        let uv_px = camera.project(&(frame.camera_from_world * sample.p_world));
        let uv_px = uv_px.expect("a sample lies in front of the camera");
        mask.label_at_level(TOP_LEVEL, &uv_px, Some(sample.depth_m))
    };

    let (of_keypoints, of_blocks) = (keypoints.iter(), blocks.iter().flatten());
    let samples: Vec<Sample> = (of_keypoints.clone().map(|(_, sample)| *sample))
        .chain(of_blocks.clone().copied())
        .collect();
    let suspected: Vec<bool> = (of_keypoints.map(|(i, _)| label[*i]))
        .chain(of_blocks.map(label_of_block))
        .map(|label| label == Label::Dynamic)
        .collect();
    recorder.record("gaussian_mask", |record| {
        let of = (given.dynamic, frame);
        record.gaussian_mask(of, &mask.levels, &label, &samples, &suspected);
    });
    let rests = rests(
        context,
        view.pyramid,
        given.references,
        &samples,
        &suspected,
        recorder,
    );
    let (keypoints_rest, blocks_rest) = rests.split_at(keypoints.len());
    let restored = keypoints.iter().zip(keypoints_rest);
    let restored = restored.filter(|(_, rests)| **rests).map(|((i, _), _)| *i);
    let restored: Vec<usize> = restored.collect();
    for i in &restored {
        label[*i] = Label::Static;
    }

    let cells = if config.gaussian_mask.surface_share > 0.0 {
        let moves = suspected[keypoints.len()..].iter().zip(blocks_rest);
        let moves = moves.map(|(suspected, rests)| f64::from(u8::from(*suspected && !rests)));
        let (beliefs, share): (Vec<f64>, f64) =
            (moves.collect(), config.gaussian_mask.surface_share);
        let cells = mask_from_beliefs(
            given.lattice,
            &blocks,
            &beliefs,
            depth,
            config.edge_ratio,
            share,
        );
        for (i, label) in label.iter_mut().enumerate() {
            if restored.binary_search(&i).is_err()
                && label_at(&cells, &frame.px[i]) == Label::Dynamic
            {
                *label = Label::Dynamic;
            }
        }
        cells
    } else {
        let centres = given
            .centres
            .expect("given where the rendered mask alone decides");
        let mut cells = mask.cells(centres);
        let with_depth = (0..blocks.len()).filter(|b| blocks[*b].is_some());
        for (block, _) in with_depth.zip(blocks_rest).filter(|(_, rests)| **rests) {
            given.lattice.clear(&mut cells, block);
        }
        cells
    };
    let near = mask::dilated(&cells, config.reach_px.div_ceil(CELL_PX));
    let in_use = (0..frame.len()).map(|i| {
        let is_near = config.reach_px > 0 && label_at(&near, &frame.px[i]) == Label::Dynamic;
        label[i] == Label::Static && (!is_near || restored.binary_search(&i).is_ok())
    });
    let of_flow = (&rests[..], &restored[..]);
    let labels = FrameLabels {
        in_use: in_use.collect(),
        restored: restored_landmarks(context, given.map, frame, of_flow, recorder),
        label,
        cells,
    };
    recorder.record("masks", |record| record.labels(&labels));
    labels
}

/// Which suspects the flow check finds at rest; none without an earlier image.
fn rests(
    context: &Context,
    pyramid: Option<&LkPyramid>,
    references: &[ReferenceImage<'_>],
    samples: &[Sample],
    suspected: &[bool],
    recorder: &mut Recorder,
) -> Vec<bool> {
    let reference = nearest_to_rest(references, context.config.labels.rest_frames);
    match (pyramid, reference) {
        (Some(pyramid), Some(reference)) => {
            at_rest(context, pyramid, *reference, samples, suspected, recorder)
        }
        _ => vec![false; samples.len()],
    }
}

/// The dynamic landmarks that restored keypoints show: of those that project near a keypoint, the one whose
/// descriptor is nearest to its own.
fn restored_landmarks(
    context: &Context,
    map: &Map,
    frame: &Frame,
    (rests, restored): (&[bool], &[usize]),
    recorder: &mut Recorder,
) -> Vec<LandmarkId> {
    let (camera, config) = (&context.camera, &context.config.tracking);
    let dynamic = map.landmarks().filter(|(_, l)| l.label() == Label::Dynamic);
    let seen = dynamic.filter_map(|(id, landmark)| {
        let uv_px = camera.project(&(frame.camera_from_world * landmark.p_world))?;
        camera.contains(&uv_px).then_some((id, landmark, uv_px))
    });
    let seen: Vec<_> = seen.collect();
    let shown = |&i: &usize| {
        let scale = context.scales[usize::from(frame.keypoints[i].level)];
        let radius_px = config.local_radius_px * scale;
        let near = seen
            .iter()
            .filter(|(_, _, uv_px)| (uv_px - frame.uv_px[i]).norm() < radius_px);
        let distances = near.map(|(id, landmark, _)| {
            let distance = landmark.descriptor.distance(&frame.descriptors[i]);
            (distance, *id)
        });
        let nearest = distances.min();
        nearest.filter(|(distance, _)| *distance <= config.match_distance)
    };
    let mut landmarks: Vec<LandmarkId> =
        restored.iter().filter_map(shown).map(|(_, l)| l).collect();
    landmarks.sort_unstable();
    landmarks.dedup();
    recorder.record("restore", |record| {
        let seen = (seen.iter()).map(|(id, landmark, uv_px)| (*id, &landmark.descriptor, *uv_px));
        record.restore(seen, rests, restored, &landmarks);
    });
    landmarks
}

#[cfg(test)]
mod tests;
