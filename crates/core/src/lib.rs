//! Numbers, poses, cameras, images, pyramids, Gaussian maps and deterministic parallelism.
//!
//! The types that all other crates share; this crate depends on none of them.
//! Reading order: [`real`] (where every transcendental function comes from) → [`so3`], [`se3`]
//! (poses) → [`camera`] (projection, distortion) → [`image`], [`undistort`], [`pyramid`] → [`gaussian`], [`sh`],
//! [`sh_rotation`] (the map) → [`par`] (threads that never change a result),
//! [`lanes`] (nor do instruction sets). [`chi_square`] holds the
//! thresholds of every gate.

pub mod camera;
pub mod chi_square;
pub mod exp;
pub mod gaussian;
pub mod ids;
pub mod image;
pub mod lanes;
pub mod par;
pub mod pyramid;
pub mod real;
pub mod rng;
pub mod se3;
pub mod sh;
pub mod sh_rotation;
pub mod shutter;
pub mod so3;
pub mod trajectory;
pub mod undistort;

pub use camera::{Camera, CameraError, Distortion};
pub use gaussian::{GaussianMap, NewGaussian};
pub use ids::{FrameId, KeyframeId, Label, LandmarkId};
pub use image::{DepthImage, GrayImage, Image, MaskImage, RgbImage};
pub use par::Par;
pub use real::Real;
pub use rng::Rng;
pub use se3::Se3;
pub use shutter::RollingShutter;
pub use so3::So3;
pub use trajectory::StampedPose;
