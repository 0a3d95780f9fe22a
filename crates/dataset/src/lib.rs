//! Readers of RGB-D recordings in the layouts people have (folders and archives), calibrations, trajectories and PLY
//! maps, and writers of the last two. No algorithms.
//!
//! ```text
//! folder | .tgz | .tar | .zip ──source──► layout ──► frames (TUM: rgb.txt, depth.txt ──list──► associate) ──► Dataset
//!                                           │         camera.txt ──calibration────────────────────────────────┤
//!                                           └──► its camera, its poses; groundtruth.txt ──trajectory──────────┘
//! Dataset::read(i), frames(n) ──decode──► Frame (colour, depth in metres)
//! Dataset::read_mask, read_own_mask ──decode──► true mask, if there is one
//! ```
//!
//! Reading order: [`dataset`] → [`calibration`] → [`associate`](fn@associate) → [`trajectory`],
//! [`bonn`] → [`ply`]. The limits for hostile files are in [`limits`].
//!
//! # Example
//! ```no_run
//! use garad_dataset::{Dataset, OpenOptions};
//! let dataset = Dataset::open("rgbd_dataset_freiburg3_walking_xyz.tgz".as_ref(), &OpenOptions::default())?;
//! for frame in dataset.frames(2) {
//!     let frame = frame?;
//!     let centre_m = frame.depth[(320, 240)];
//! }
//! # Ok::<(), garad_dataset::DatasetError>(())
//! ```

mod archive;
mod associate;
mod atomic;
pub mod bonn;
pub mod calibration;
#[cfg(test)]
mod damage;
pub mod dataset;
mod decode;
mod errors;
mod files;
mod frames;
mod layout;
pub mod limits;
mod list;
mod options;
pub mod plausibility;
pub mod ply;
mod source;
mod text;
pub mod trajectory;

pub use associate::associate;
pub use atomic::{temporary_of, write_atomically, write_bytes_atomically};
pub use bonn::bonn_camera_from_marker;
pub use calibration::{Calibration, Preset};
pub use dataset::{Dataset, Frame, LeftOut, MASK_FOLDER};
pub use errors::DatasetError;
pub use frames::Frames;
pub use options::OpenOptions;
pub use plausibility::{DepthRange, FirstLook};
pub use ply::{PlyOptions, read_ply, write_ply};
pub use trajectory::{format_trajectory, parse_trajectory, read_trajectory, write_trajectory};
