//! One frame: samples, their depth cue, the field, keypoint labels and the mask.

use garad_core::{Camera, DepthImage, FrameId, Image, Label, MaskImage, Real};
use garad_crf::{Cues, Node, unary};
use nalgebra::{Vector2, Vector3};

use super::witness::{CELL_PX, Court, Statement, Verdict};
use crate::frame::Frame;
use crate::mask::{self, MOVING};
use crate::system::Slam;

/// What was found out about a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct FrameLabels {
    /// The frame.
    pub frame: FrameId,
    /// Place of every keypoint in the recorded picture, px, and its label.
    pub keypoints: Vec<([f64; 2], Label)>,
    /// 255 where something moves, one value per 4 x 4 pixels.
    pub cells: MaskImage,
}

impl FrameLabels {
    /// The mask of a whole picture of this size.
    #[must_use]
    pub fn mask(&self, (width, height): (usize, usize)) -> MaskImage {
        full_size(&self.cells, (width, height))
    }
}

/// Cells as pixels.
pub(crate) fn full_size(cells: &MaskImage, (width, height): (usize, usize)) -> MaskImage {
    MaskImage::from_fn(width, height, |x, y| {
        cells
            .get(x / CELL_PX, y / CELL_PX)
            .copied()
            .unwrap_or_default()
    })
}

/// The lattice of samples: one pixel in the middle of every block, and the ray through it.
#[derive(Debug, Clone)]
pub(crate) struct Lattice {
    step_px: usize,
    columns: usize,
    rows: usize,
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

    /// Pixel and depth of every sample: the depth nearest to the middle of its block.
    fn samples(&self, depth: &DepthImage, max_depth_m: f64) -> Vec<Option<([usize; 2], f64)>> {
        let (width, height) = depth.size();
        let half = self.step_px / 2;
        (0..self.len())
            .map(|i| {
                let x = ((i % self.columns) * self.step_px + half).min(width - 1);
                let y = ((i / self.columns) * self.step_px + half).min(height - 1);
                // Outwards along a row, then along a column: a hole in the depth is often small.
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
}

/// One sample in the field.
#[derive(Debug, Clone, Copy)]
struct Sample {
    px: Vector2<f64>,
    depth_m: f64,
    p_world: Vector3<f64>,
}

impl Slam {
    /// Labels the frame's keypoints from its first pose, unlinks those that move, and returns the
    /// mask in cells. `None` before the bootstrap is over or when the witnesses contradict nearly
    /// everything, which is a wrong pose rather than a crowd.
    pub(crate) fn label_frame(&self, frame: &mut Frame, depth: &DepthImage) -> Option<MaskImage> {
        let config = &self.config.labels;
        if frame.id.0 < config.bootstrap_frames || self.witnesses.is_empty() {
            return None;
        }
        let keypoints = self.keypoint_samples(frame);
        let max_depth_m = self.config.features.max_depth_m;
        let lattice = self.lattice.samples(depth, max_depth_m);
        let world_from_camera = frame.camera_from_world.inverse();
        let lattice: Vec<Option<Sample>> = lattice
            .into_iter()
            .map(|found| {
                let ([x, y], depth_m) = found?;
                let px = Vector2::new(x as f64, y as f64);
                let uv_px = self.camera.undistort_pixel(&px)?;
                Some(Sample {
                    px,
                    depth_m,
                    p_world: world_from_camera * self.camera.unproject(&uv_px, depth_m),
                })
            })
            .collect();

        let samples: Vec<Sample> = keypoints
            .iter()
            .map(|(_, sample)| *sample)
            .chain(lattice.iter().flatten().copied())
            .collect();
        let verdicts = self.hear(&samples, frame.id);
        let judged = verdicts.iter().filter_map(|v| v.residual);
        let suspects = judged.clone().filter(|r| *r > config.suspect_sigmas);
        let (judged, suspects) = (judged.count(), suspects.count());
        if suspects as f64 > config.max_moving * judged as f64 {
            return None;
        }
        let nodes: Vec<Node> = samples
            .iter()
            .map(|sample| Node {
                p_world: sample.p_world,
                uv_px: Some(sample.px),
                ..Node::default()
            })
            .collect();
        let log_odds: Vec<f64> = verdicts.iter().map(|v| self.log_odds(v)).collect();
        // Numbers come from depths and poses that are finite: the answer is never an error.
        let beliefs = self.crf.infer_from_log_odds(&nodes, &log_odds, self.par);
        let beliefs = beliefs.ok()?;

        let (of_keypoints, of_lattice) = beliefs.dynamic.split_at(keypoints.len());
        let cells = self.cells(&lattice, of_lattice, depth);
        let mut label: Vec<Label> = frame.px.iter().map(|px| label_at(&cells, px)).collect();
        // Keypoints crowd where there is texture and back each other up there; the lattice is even.
        for ((i, _), belief) in keypoints.iter().zip(of_keypoints) {
            if *belief > self.config.crf.threshold {
                label[*i] = Label::Dynamic;
            }
        }
        let near = mask::dilated(&cells, config.reach_px.div_ceil(CELL_PX));
        let in_use = frame
            .px
            .iter()
            .zip(&label)
            .map(|(px, label)| *label == Label::Static && label_at(&near, px) == Label::Static);
        let in_use = in_use.collect();
        frame.set_labels(label, in_use, &self.camera);
        Some(cells)
    }

    /// What a verdict says for the moving of a sample. That it stands where something stood a moment
    /// ago says little: a person takes a second to leave their own outline. That it stood there a
    /// second ago says a lot.
    fn log_odds(&self, verdict: &Verdict) -> f64 {
        let config = &self.config.labels;
        let unary = &self.config.crf.unary;
        let trust = match verdict.residual {
            None => config.trust_unknown,
            Some(_) => {
                let settled = f64::from(verdict.agreed_for) / f64::from(config.settle_frames);
                let [young, old] = [config.trust_young, config.trust_old];
                young + (old - young) * settled.min(1.0)
            }
        };
        let cues = Cues {
            depth_residual: verdict.residual,
            ..Cues::default()
        };
        let likelihood = match verdict.residual {
            None => 1.0,
            Some(_) => unary::p_static(&cues, unary),
        };
        let p = (likelihood * trust).max(unary.clamp);
        Real::ln((1.0 - p) / p)
    }

    /// Keypoints with depth, by index.
    fn keypoint_samples(&self, frame: &Frame) -> Vec<(usize, Sample)> {
        (0..frame.len())
            .filter_map(|i| {
                let sample = Sample {
                    px: frame.px[i],
                    depth_m: frame.depth_m[i]?,
                    p_world: frame.world_point(i, &self.camera)?,
                };
                sample
                    .p_world
                    .iter()
                    .all(|v| v.is_finite())
                    .then_some((i, sample))
            })
            .collect()
    }

    /// What the keyframes of the last seconds say about the samples.
    fn hear(&self, samples: &[Sample], now: FrameId) -> Vec<Verdict> {
        let court = self.court(now);
        self.par
            .map_chunks(samples.len(), 128, |range| {
                let heard = range.map(|i| court.hear(&samples[i].p_world));
                heard.collect::<Vec<_>>()
            })
            .concat()
    }

    /// The witnesses of the last `memory_frames` frames, and where they stood.
    pub(crate) fn court(&self, now: FrameId) -> Court<'_> {
        let oldest = now.0.saturating_sub(self.config.labels.memory_frames);
        let recent = self.witnesses.iter().filter_map(|(k, witness)| {
            let keyframe = self.map.keyframe(*k);
            (keyframe.id.0 >= oldest).then_some(Statement {
                witness,
                camera_from_world: keyframe.camera_from_world,
                age: now.0 - keyframe.id.0,
            })
        });
        Court {
            camera: &self.camera,
            noise: &self.config.labels.noise,
            statements: recent.collect(),
        }
    }

    /// The mask in cells: the mean belief of the samples around, weighted by how near they are in
    /// the picture (linear over one step) and in depth. Cells without depth go by the picture.
    fn cells(&self, lattice: &[Option<Sample>], beliefs: &[f64], depth: &DepthImage) -> MaskImage {
        let mut of_sample = vec![None; lattice.len()];
        let mut next = beliefs.iter();
        for (slot, sample) in of_sample.iter_mut().zip(lattice) {
            if let Some(sample) = sample {
                *slot = next.next().map(|belief| (*sample, *belief));
            }
        }
        let config = &self.config.labels;
        let (width, height) = depth.size();
        let (columns, rows) = (width.div_ceil(CELL_PX), height.div_ceil(CELL_PX));
        let step = self.lattice.step_px as f64;
        let half = CELL_PX as f64 / 2.0 - 0.5;
        Image::from_fn(columns, rows, |cx, cy| {
            let center = [cx, cy].map(|c| (c * CELL_PX) as f64 + half);
            let at = |c: usize, n: usize| (c * CELL_PX + CELL_PX / 2).min(n - 1);
            let z = f64::from(depth[(at(cx, width), at(cy, height))]);
            let block = [cx, cy].map(|c| c * CELL_PX / self.lattice.step_px);
            let (mut sum, mut weights) = (0.0, 0.0);
            for y in block[1].saturating_sub(1)..(block[1] + 2).min(self.lattice.rows) {
                for x in block[0].saturating_sub(1)..(block[0] + 2).min(self.lattice.columns) {
                    let Some((sample, belief)) = &of_sample[y * self.lattice.columns + x] else {
                        continue;
                    };
                    let dx = (sample.px.x - center[0]).abs() / (1.5 * step);
                    let dy = (sample.px.y - center[1]).abs() / (1.5 * step);
                    let mut weight = (1.0 - dx).max(0.0) * (1.0 - dy).max(0.0);
                    if z > 0.0 {
                        let d = (sample.depth_m - z) / (config.edge_ratio * z);
                        weight *= Real::exp(-0.5 * d * d) + 1e-6;
                    }
                    sum += weight * belief;
                    weights += weight;
                }
            }
            let moves = weights > 0.0 && sum > self.config.crf.threshold * weights;
            if moves { MOVING } else { 0 }
        })
    }
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to integer saturates; `get` refuses what lies outside"
)]
fn label_at(cells: &MaskImage, px: &Vector2<f64>) -> Label {
    let cell = |c: f64| (c + 0.5).max(0.0) as usize / CELL_PX;
    match cells.get(cell(px.x), cell(px.y)) {
        Some(&MOVING) => Label::Dynamic,
        _ => Label::Static,
    }
}
