//! Traces: the inputs and outputs of every stage over some frames, as `.npy` files with an index.
//!
//! ```text
//! FOLDER/trace.json                 stage, frame, tensor, dtype, shape, unit, file; in the order of the data
//! FOLDER/000010/pose_0/after.npy    frame / stage and its how many-th run in the frame / tensor
//! ```
//!
//! [`diff`](diff::diff) compares two of them, or one with a folder of the same layout that a port
//! has filled.

pub mod diff;

use std::collections::BTreeSet;
use std::fmt;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::error::GoldenError;
use crate::manifest::{read, read_npy};
use crate::tensor::{Dtype, Tensor};
use crate::tol::{self, Tolerance};

/// Name of the index.
pub const INDEX: &str = "trace.json";

/// `trace.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Index {
    /// 1.
    pub schema: u32,
    /// What was run: program, recording, frames, seed.
    pub about: serde_json::Value,
    /// The tensors in the order of the data: what differs first is where to look.
    pub tensors: Vec<Entry>,
}

/// A tensor of the trace.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// Frame of the run, from 0.
    pub frame: u32,
    /// Stage.
    pub stage: String,
    /// A stage may run several times in a frame: which time, from 0.
    pub call: usize,
    /// Taken by the stage, or made by it.
    pub role: Role,
    /// Name within the stage.
    pub tensor: String,
    /// Element type as numpy names it.
    pub dtype: String,
    /// Sizes, slowest first.
    pub shape: Vec<usize>,
    /// Unit, `1` for none.
    pub unit: String,
    /// File, relative to the folder.
    pub file: String,
}

/// On which side of a stage a tensor stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Taken.
    Input,
    /// Made.
    Output,
}

impl Entry {
    /// The path every trace has for this tensor: `FRAME/STAGE_CALL/TENSOR.npy`.
    #[must_use]
    pub fn path_of(frame: u32, stage: &str, call: usize, tensor: &str) -> String {
        format!("{frame:06}/{stage}_{call}/{tensor}.npy")
    }

    /// Whether it is the same run of the same stage.
    #[must_use]
    pub fn same_run(&self, other: &Self) -> bool {
        self.frame == other.frame && self.stage == other.stage && self.call == other.call
    }
}

/// `frame 10, pose, run 0, after`
impl fmt::Display for Entry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "frame {}, {}", self.frame, self.stage)?;
        if self.call > 0 {
            write!(f, ", run {}", self.call)?;
        }
        write!(f, ", {}", self.tensor)
    }
}

impl Index {
    /// Reads a folder's index.
    ///
    /// # Errors
    /// [`GoldenError`] naming the file and what is wrong with it: the text, the schema, a file
    /// that lies outside of the folder, or one that two tensors have.
    pub fn load(folder: &Path) -> Result<Self, GoldenError> {
        let path = folder.join(INDEX);
        let index: Self =
            serde_json::from_slice(&read(&path)?).map_err(|source| GoldenError::Json {
                path: path.clone(),
                source,
            })?;
        if index.schema != 1 {
            let found = index.schema;
            return Err(GoldenError::Schema { path, found });
        }
        let mut files = BTreeSet::new();
        for entry in &index.tensors {
            let inside = |part: &str| !(part.is_empty() || part.starts_with('.'));
            if entry.file.contains('\\') || !entry.file.split('/').all(inside) {
                return Err(GoldenError::Tensor {
                    path,
                    tensor: entry.to_string(),
                    problem: format!("file '{}' is not a plain path", entry.file),
                });
            }
            if !files.insert(entry.file.as_str()) {
                return Err(GoldenError::Tensor {
                    path,
                    tensor: entry.to_string(),
                    problem: format!("file '{}' is that of an earlier tensor", entry.file),
                });
            }
        }
        Ok(index)
    }
}

/// The numbers of a tensor; type and shape must be those the index states.
///
/// # Errors
/// [`GoldenError`] naming the file and what is wrong with it.
pub fn load_tensor(folder: &Path, entry: &Entry) -> Result<Tensor, GoldenError> {
    let path = folder.join(&entry.file);
    let tensor = read_npy(&path)?;
    let stated = Dtype::from_name(&entry.dtype);
    if (Some(tensor.dtype()), tensor.shape()) == (stated, &entry.shape[..]) {
        return Ok(tensor);
    }
    let (dtype, shape) = (tensor.dtype().name(), tensor.shape());
    let problem = format!(
        "holds {dtype} {shape:?}, not {} {:?}",
        entry.dtype, entry.shape
    );
    Err(GoldenError::Tensor {
        path,
        tensor: entry.to_string(),
        problem,
    })
}

/// Tolerances of the tensors that a correct port may have otherwise; all others are exact. Names are
/// those of [`tol::TABLE`].
#[rustfmt::skip]
const TOLERANCES: &[(&str, &str, &str)] = &[
    ("keypoints", "uv_px", "camera.undistorted"),
    ("predict", "", "pose.pose"),
    ("pose", "after", "pose.pose"), ("pose", "before", "pose.pose"), ("pose", "cost", "pose.cost"),
    ("depth_planes", "", "trace.residual"), ("depth_pose", "", "trace.residual"),
    ("depth_pose", "after", "pose.pose"), ("depth_pose", "before", "pose.pose"),
    ("depth_pose", "p_world", "bundle.points"), ("depth_pose", "uv_px", "lk.xy"),
    ("pose", "p_world", "bundle.points"), ("pose", "uv_px", "lk.xy"), ("pose", "third_px", "lk.xy"),
    ("label", "p_world", "bundle.points"), ("label", "depth_residual", "trace.residual"),
    ("label", "log_odds", "trace.residual"), ("label", "belief", "trace.belief"),
    ("flow_lk", "starts", "lk.xy"), ("flow_lk", "xy", "lk.xy"), ("flow_lk", "residual", "lk.residual"),
    ("flow", "", "trace.flow"), ("flow", "inside", "exact"),
    ("relocalise", "camera_from_world", "pose.pose"),
    ("gaussian_mask", "camera_from_world", "pose.pose"), ("gaussian_mask", "p_world", "bundle.points"),
    ("gaussian_mask", "opacity_0", "trace.image"), ("gaussian_mask", "depth_m_0", "trace.image"),
    ("gaussian_mask", "opacity_1", "trace.image"), ("gaussian_mask", "depth_m_1", "trace.image"),
    ("gaussian_mask", "opacity_2", "trace.image"), ("gaussian_mask", "depth_m_2", "trace.image"),
    ("restore", "dynamic_uv_px", "lk.xy"),
    ("loop", "located", "pose.pose"), ("loop", "a_from_b", "pose.pose"), ("loop", "poses_before", "pose.pose"),
    ("loop", "poses_after", "trace.loop"), ("loop", "drift_m", "pose.pose"),
    ("densify", "gradient", "trace.loss"), ("densify", "extent_m", "trace.residual"),
    ("match_local_map", "visible_uv_px", "lk.xy"),
    ("subpixel", "points", "lk.xy"), ("subpixel", "starts", "lk.xy"), ("subpixel", "xy", "lk.xy"),
    ("subpixel", "residual", "lk.residual"),
    ("label_map", "p_world", "bundle.points"), ("label_map", "uv_px", "lk.xy"),
    ("label_map", "cues", "trace.residual"), ("label_map", "belief", "trace.belief"),
    ("bundle", "poses_before", "pose.pose"), ("bundle", "poses_after", "pose.pose"),
    ("bundle", "points_before", "bundle.points"), ("bundle", "points_after", "bundle.points"),
    ("bundle", "uv_px", "lk.xy"), ("bundle", "third_px", "lk.xy"), ("bundle", "cost", "trace.cost"),
    ("trajectory", "camera_from_world", "pose.pose"), ("trajectory", "p_world", "bundle.points"),
    ("insert", "new_p_world", "bundle.points"),
    ("train", "camera_from_world", "pose.pose"), ("train", "target", "raster.f32.color"),
    ("train", "color", "trace.image"), ("train", "depth_m", "trace.image"),
    ("train", "opacity", "trace.image"), ("train", "loss", "trace.loss"),
];

/// Stages with Gaussians, ...
const MAP_STAGES: [&str; 6] = [
    "map_before",
    "gaussian_mask",
    "label_gaussians",
    "insert",
    "densify",
    "map_after",
];

/// ... and the tolerances of their parameters.
const MAP_TOLERANCES: &[(&str, &str)] = &[
    ("means", "trace.means"),
    ("log_scales", "trace.log_scales"),
    ("quaternions", "trace.quaternions"),
    ("opacity_logits", "trace.opacity_logits"),
    ("sh", "trace.sh"),
];

/// What a tensor of a correct port is held to: the table's last entry for it, else the same numbers.
#[must_use]
pub fn tolerance(stage: &str, tensor: &str) -> &'static Tolerance {
    let name = tensor.strip_prefix("before_").unwrap_or(tensor);
    let is_map = MAP_STAGES.contains(&stage);
    let parameter = MAP_TOLERANCES.iter().find(|(t, _)| is_map && *t == name);
    let of = |(s, t, _): &&(&str, &str, &str)| *s == stage && (t.is_empty() || *t == tensor);
    let stages = TOLERANCES.iter().rfind(of).map(|(_, _, name)| name);
    let name = stages
        .or(parameter.map(|(_, name)| name))
        .unwrap_or(&"exact");
    tol::find(name).unwrap_or(&tol::TABLE[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_tensors_have_one_file() {
        let entry = |call, tensor: &str, file: &str| Entry {
            frame: 3,
            stage: "pose".to_owned(),
            call,
            role: Role::Input,
            tensor: tensor.to_owned(),
            dtype: "f64".to_owned(),
            shape: vec![2],
            unit: "m".to_owned(),
            file: file.to_owned(),
        };
        let first = entry(0, "before", "a/before.npy");
        for (second, good) in [
            (entry(0, "after", "a/after.npy"), true),
            (entry(0, "before", "b/before.npy"), true),
            (entry(1, "after", "a/before.npy"), false),
        ] {
            let index = Index {
                schema: 1,
                about: serde_json::Value::Null,
                tensors: vec![first.clone(), second.clone()],
            };
            let folder = tempfile::tempdir().expect("a folder");
            let text = serde_json::to_string(&index).expect("JSON");
            std::fs::write(folder.path().join(INDEX), text).expect("written");
            let found = Index::load(folder.path()).map_err(|error| error.to_string());
            let words = "'a/before.npy' is that of an earlier tensor";
            match found {
                Ok(found) => assert!(good && found == index, "{second}"),
                Err(error) => assert!(!good && error.contains(words), "{error}"),
            }
        }
    }

    #[test]
    fn every_tolerance_is_in_the_table() {
        assert_eq!(
            tol::TABLE[0].name,
            "exact",
            "what is held to when nothing is said"
        );
        for (stage, tensor, name) in TOLERANCES {
            assert!(tol::find(name).is_some(), "{stage} {tensor}: no '{name}'");
        }
        for (tensor, name) in MAP_TOLERANCES {
            assert!(tol::find(name).is_some(), "{tensor}: no '{name}'");
        }
        let name = |stage, tensor| tolerance(stage, tensor).name;
        assert_eq!(name("orb", "xy"), "exact", "not in the list");
        assert_eq!(name("insert", "means"), "trace.means", "a parameter");
        assert_eq!(name("densify", "before_means"), "trace.means", "as well");
        assert_eq!(name("train", "means"), "exact", "not of the map");
        assert_eq!(name("insert", "landmark"), "exact", "an id");
        assert_eq!(name("pose", "after"), "pose.pose", "a tensor");
        assert_eq!(
            name("depth_planes", "x"),
            "trace.residual",
            "the whole stage"
        );
        assert_eq!(name("depth_pose", "after"), "pose.pose", "the last entry");
    }
}
