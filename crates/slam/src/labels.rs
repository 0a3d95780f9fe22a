//! What moves: every frame's keypoints and picture, every keyframe's landmarks
//! (paper sec. III-A, III-B; decision 005).
//!
//! ```text
//! first pose ─→ samples of the frame ─→ witnesses: keyframes of the last seconds ─→ depth cue
//!                                                                                      │
//! keypoint labels, mask ←─ flow check of suspects ←─ conditional random field ←────────┘
//! ```
//!
//! The paper labels the tagged Gaussians once per keyframe. A person who walks in is nobody's
//! landmark yet; so the same field also runs over the samples of every single frame (keypoints and a
//! lattice of pixels), whose one cue is the depth residual against what was seen there before.
//! At a keyframe it runs over the landmarks of the local map with all four cues.

pub(crate) mod displacement;
pub mod flow;
pub mod frame;
pub mod landmarks;
pub(crate) mod witness;

pub use frame::FrameLabels;
