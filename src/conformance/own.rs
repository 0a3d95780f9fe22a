//! [`answers`]: this project's own stages as a backend, so that the tool can be seen at work.

mod features;
mod fields;
mod geometry;
mod judging;
mod labels;
mod pictures;
mod poses;
mod raster;
mod recordings;
mod training;

use std::collections::BTreeMap;

use garad_core::Real;
use garad_golden::judge::Answers;
use garad_golden::{Case, Dtype, Tensor};

use fields::Fields;

/// Stages that [`answers`] computes: all that have cases of their own.
pub const STAGES: [&str; 33] = [
    "decode",
    "associate",
    "bonn",
    "ply",
    "se3",
    "camera",
    "pyramid",
    "fast",
    "orb",
    "matching",
    "lk",
    "epipolar",
    "flow",
    "robust",
    "reprojection",
    "place",
    "pnp",
    "pose_lm",
    "bundle",
    "pose_graph",
    "unary",
    "kernel",
    "mean_field",
    "label_window",
    "sh",
    "projection_covariance",
    "raster",
    "raster_backward",
    "losses",
    "adam",
    "train_step",
    "trajectory",
    "image_metrics",
];

/// A case that the stage could not be given.
#[derive(Debug)]
pub struct OwnError(String);

impl std::fmt::Display for OwnError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for OwnError {}

/// In which numbers, where a stage has both.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Width {
    /// The reference.
    F64,
    /// What a GPU computes in; the fast implementations.
    F32,
}

/// A list of outputs as it grows, by name.
#[derive(Debug, Default)]
struct Outputs(BTreeMap<String, Result<Tensor, String>>);

impl Outputs {
    /// Adds numbers under the shape the case has for them, so far as their count allows.
    fn put<T: Real>(&mut self, name: &str, values: impl IntoIterator<Item = T>) {
        let values: Vec<T> = values.into_iter().collect();
        let (dtype, bytes) = if size_of::<T>() == 4 {
            let narrow = values.iter().map(|v| v.to_f32().to_le_bytes());
            (Dtype::F32, narrow.flatten().collect())
        } else {
            let wide = values.iter().map(|v| v.to_f64().to_le_bytes());
            (Dtype::F64, wide.flatten().collect())
        };
        let tensor = Tensor::from_bytes(dtype, vec![values.len()], bytes);
        let tensor = tensor.ok_or_else(|| "too many numbers".to_owned());
        self.0.insert(name.to_owned(), tensor);
    }

    /// Whole numbers, exact in f64.
    fn put_whole(&mut self, name: &str, values: impl IntoIterator<Item = impl Into<f64>>) {
        self.put::<f64>(name, values.into_iter().map(Into::into));
    }

    /// Gives each output the shape of the expected one where it has as many numbers.
    fn shaped(self, case: &Case) -> Answers {
        let shape = |name: &str, tensor: Tensor| {
            let known = case.output_names().any(|output| output == name);
            let wanted = known.then(|| case.output(name));
            match wanted.filter(|wanted| wanted.len() == tensor.len()) {
                Some(wanted) => tensor.clone().reshape(wanted.shape()).unwrap_or(tensor),
                None => tensor,
            }
        };
        let shaped = self.0.into_iter();
        shaped
            .map(|(name, tensor)| {
                let tensor = tensor.map(|tensor| shape(&name, tensor));
                (name, tensor)
            })
            .collect()
    }
}

/// The outputs of a case by this project's own stage; `None` if it is not one of [`STAGES`].
///
/// # Errors
/// [`OwnError`] if the case lacks what the stage needs.
pub fn answers(case: &Case, width: Width) -> Result<Option<Answers>, OwnError> {
    let fields = Fields(case);
    let narrow = width == Width::F32;
    let outputs = match case.stage() {
        "decode" => recordings::decode(fields)?,
        "associate" => recordings::pairs(fields)?,
        "bonn" => recordings::bonn(fields)?,
        "ply" => recordings::ply(fields)?,
        "pyramid" => pictures::pyramid(fields)?,
        "epipolar" => pictures::epipolar(fields)?,
        "flow" => pictures::flow(fields)?,
        "place" => pictures::place(fields)?,
        "robust" => poses::robust(fields)?,
        "reprojection" => poses::reprojection(fields)?,
        "pose_lm" => poses::pose(fields)?,
        "pnp" => poses::pnp(fields)?,
        "bundle" => poses::bundle(fields)?,
        "pose_graph" => poses::pose_graph(fields)?,
        "unary" => labels::unary(fields)?,
        "kernel" => labels::kernels(fields)?,
        "mean_field" => labels::mean_field(fields)?,
        "label_window" => labels::window(fields)?,
        "trajectory" => judging::trajectory(fields)?,
        "image_metrics" => judging::image_metrics(fields)?,
        "se3" => geometry::se3(fields)?,
        "camera" => geometry::camera(fields)?,
        "fast" => features::fast(fields)?,
        "orb" => features::orb(fields)?,
        "matching" => features::matching(fields)?,
        "lk" => features::lucas_kanade(fields)?,
        "sh" if narrow => raster::harmonics::<f32>(fields)?,
        "sh" => raster::harmonics::<f64>(fields)?,
        "projection_covariance" if narrow => raster::projection(fields, raster::FAST)?,
        "projection_covariance" => raster::projection(fields, raster::REFERENCE)?,
        "raster" if narrow => raster::forward(fields, raster::FAST)?,
        "raster" => raster::forward(fields, raster::REFERENCE)?,
        "raster_backward" if narrow => raster::backward(fields, raster::FAST)?,
        "raster_backward" => raster::backward(fields, raster::REFERENCE)?,
        "losses" if narrow => training::losses::<f32>(fields)?,
        "losses" => training::losses::<f64>(fields)?,
        "adam" if narrow => training::adam::<f32>(fields)?,
        "adam" => training::adam::<f64>(fields)?,
        "train_step" if narrow => training::train_step(fields, raster::FAST)?,
        "train_step" => training::train_step(fields, raster::REFERENCE)?,
        _ => return Ok(None),
    };
    Ok(Some(outputs.shaped(case)))
}
