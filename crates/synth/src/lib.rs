//! Dynamic RGB-D scenes with exact poses, depth, flow and masks.
//!
//! A furnished room or a hall, people who walk through it and a hand-held camera, rendered by a ray caster, with
//! all ground truth. Every frame of a [`Scene`] is a pure function of the [`SceneConfig`] and the number
//! of the frame.
//!
//! Reading order: [`config`] (the scenes) → `shape` (rays and solids) → `pattern`, `material`, `walls`,
//! `decor`, `clothes` (textures) → `solid`, `furniture`, `desk`, `room`, `hall` (the rooms) → `course`, `gait`,
//! `figure`, `actor`, `cast` (moving objects) → `camera_path` → `light`, `view`, `render`, `flow`
//! (images) → [`noise`] (the sensor) → [`scene`] (all together).

mod actor;
mod camera_path;
mod cast;
mod clothes;
pub mod config;
mod course;
mod decor;
mod desk;
mod figure;
mod flow;
mod furniture;
mod gait;
mod hall;
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
mod walls;

pub use config::{SceneConfig, SceneName, SynthError};
pub use scene::{MASK_MEMORY_FRAMES, Scene, SynthFrame};
