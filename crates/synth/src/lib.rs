//! Dynamic RGB-D scenes with exact poses, depth, flow and masks.
//!
//! A furnished room, people who walk through it and a hand-held camera, rendered by a ray caster:
//! what a SLAM system needs to be judged, with nothing to download and every truth known. Ask a
//! [`Scene`] for any frame; it is a pure function of the [`SceneConfig`] and the frame's number.
//!
//! Reading order: [`config`] (what there is) → `shape` (rays and solids) → `pattern`, `material`,
//! `decor`, `clothes` (textures) → `solid`, `furniture`, `room` (the place) → `course`, `figure`,
//! `actor`, `cast` (who moves) → `camera_path` → `light`, `view`, `render`, `flow` (the picture) →
//! [`noise`] (the sensor) → [`scene`] (all together).

mod actor;
mod camera_path;
mod cast;
mod clothes;
pub mod config;
mod course;
mod decor;
mod figure;
mod flow;
mod furniture;
mod light;
mod material;
pub mod noise;
mod pattern;
mod render;
mod room;
pub mod scene;
mod shape;
mod solid;
mod view;

pub use config::{SceneConfig, SceneName, SynthError};
pub use scene::{MASK_MEMORY_FRAMES, Scene, SynthFrame};
