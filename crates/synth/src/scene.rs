//! [`Scene`]: a synthetic recording.

use std::sync::{Arc, OnceLock};

use garad_core::{Camera, DepthImage, Image, MaskImage, Par, RgbImage, Se3, StampedPose};

use crate::actor::Actor;
use crate::camera_path::CameraPath;
use crate::cast::{actors, furnishing};
use crate::config::{SceneConfig, SceneName, SynthError};
use crate::flow;
use crate::light::{Lighting, brightness, lamps};
use crate::noise;
use crate::render::{Rendered, render};
use crate::room::furnished;
use crate::solid::Solid;
use crate::view::View;

/// A moving object that has stood still for this many frames is static again in the mask.
pub const MASK_MEMORY_FRAMES: usize = 10;

/// One frame with its ground truth.
#[derive(Debug, Clone, PartialEq)]
pub struct SynthFrame {
    /// Seconds since the first frame.
    pub t_s: f64,
    /// Colour.
    pub rgb: RgbImage,
    /// Depth along the optical axis, metres: exact to an f32, or as measured; 0 where missing. In
    /// [`SceneName::Hall`] it is missing beyond [`noise::HALL_RANGE_M`].
    pub depth: DepthImage,
    /// 255 on objects that move or have moved within the last [`MASK_MEMORY_FRAMES`] frames, else 0.
    pub mask: MaskImage,
    /// 0 for the room, 1, 2, ... for the movable objects, whether they move or not.
    pub object: Image<u8>,
    /// Exact pose.
    pub world_from_camera: Se3,
}

/// A scene; its frames can be computed in any order.
///
/// World axes: x and y along the walls, z up, origin in the middle of the floor. Motion is a
/// function of time, defined for every frame number: one beyond [`Scene::len`] is not an error.
///
/// # Example
/// ```
/// use garad_core::Par;
/// use garad_synth::{Scene, SceneConfig, SceneName};
/// # fn main() -> Result<(), garad_synth::SynthError> {
/// let config = SceneConfig { width: 64, height: 48, ..SceneConfig::new(SceneName::Walking) };
/// let scene = Scene::new(&config)?;
/// let frame = scene.frame(12, Par::Seq);
/// assert_eq!(frame.rgb.size(), (64, 48));
/// assert!(frame.depth.data().iter().all(|&z| z > 0.3 && z < 7.0)); // a closed room
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct Scene {
    config: SceneConfig,
    camera: Camera,
    path: CameraPath,
    room: Arc<Vec<Solid>>,
    actors: Vec<Actor>,
    /// Computed with the first frame; poses and flow do not need it.
    lighting: Arc<OnceLock<Lighting>>,
}

impl Scene {
    /// Builds the room and its moving objects.
    ///
    /// # Errors
    /// [`SynthError`] for an invalid size, rate or number of frames.
    pub fn new(config: &SceneConfig) -> Result<Self, SynthError> {
        config.validate()?;
        let (width, height) = (config.width, config.height);
        // 525 px at 640 columns, and a principal point a few pixels off the centre, as in any real camera,
        // so that code which ignores cx and cy fails
        let scale = width as f64 / 640.0;
        let cx = 0.5 * (width as f64 - 1.0) + 2.75 * scale;
        let cy = 0.5 * (height as f64 - 1.0) - 3.5 * scale;
        let camera = Camera::pinhole((width, height), [525.0 * scale, 525.0 * scale, cx, cy])?;
        Ok(Self {
            camera,
            path: CameraPath::new(config.name, config.seed),
            room: Arc::new(furnished(
                furnishing(config.name),
                texture_seed(config.seed),
            )),
            actors: if config.static_twin {
                Vec::new()
            } else {
                actors(config.name, config.seed)
            },
            lighting: Arc::default(),
            config: config.clone(),
        })
    }

    /// The same recording without moving objects; it shares the room and its light.
    #[must_use]
    pub fn static_twin(&self) -> Self {
        let mut twin = self.clone();
        twin.config.static_twin = true;
        twin.actors.clear();
        twin
    }

    /// Another scene with the same settings. If the furniture is the same, it shares the room and its
    /// light, which take longer to compute than a frame.
    #[must_use]
    pub fn sibling(&self, name: SceneName) -> Self {
        let mut other = self.clone();
        other.config.name = name;
        other.path = CameraPath::new(name, self.config.seed);
        if !self.config.static_twin {
            other.actors = actors(name, self.config.seed);
        }
        if furnishing(name) != furnishing(self.config.name) {
            other.room = Arc::new(furnished(furnishing(name), texture_seed(self.config.seed)));
            other.lighting = Arc::default();
        }
        other
    }

    /// The settings.
    #[must_use]
    pub fn config(&self) -> &SceneConfig {
        &self.config
    }

    /// The camera: f = 525/640 of the width, no distortion.
    #[must_use]
    pub fn camera(&self) -> Camera {
        self.camera
    }

    /// Number of frames.
    #[must_use]
    #[allow(
        clippy::len_without_is_empty,
        reason = "a scene has at least one frame"
    )]
    pub fn len(&self) -> usize {
        self.config.frames
    }

    /// Number of movable objects; their ids are 1 to this.
    #[must_use]
    pub fn movers(&self) -> usize {
        self.actors.len()
    }

    /// Time of a frame, seconds: index / fps.
    #[must_use]
    pub fn timestamp(&self, index: usize) -> f64 {
        index as f64 / self.config.fps
    }

    /// Exact pose of the camera.
    #[must_use]
    pub fn world_from_camera(&self, index: usize) -> Se3 {
        self.path.world_from_camera(self.timestamp(index))
    }

    /// The poses of all frames.
    #[must_use]
    pub fn trajectory(&self) -> Vec<StampedPose> {
        (0..self.len())
            .map(|i| StampedPose {
                t_s: self.timestamp(i),
                world_from_camera: self.world_from_camera(i),
            })
            .collect()
    }

    /// One frame. The same bits for every `par` and in any order of frames.
    #[must_use]
    pub fn frame(&self, index: usize, par: Par) -> SynthFrame {
        let lighting = self
            .lighting
            .get_or_init(|| Lighting::bake(&self.room, lamps(self.config.name), par));
        let exact = render(
            &self.view(index),
            lighting,
            self.brightness(index),
            self.config.supersample,
            par,
        );
        let moving: Vec<u8> = self
            .actors
            .iter()
            .filter(|actor| self.counts_as_moving(actor, index))
            .map(|actor| actor.object)
            .collect();
        let mask = exact
            .object
            .map(|id| if moving.contains(id) { 255 } else { 0 });
        let (rgb, depth, object) = self.sensed(exact, index, par);
        SynthFrame {
            t_s: self.timestamp(index),
            rgb,
            depth,
            mask,
            object,
            world_from_camera: self.world_from_camera(index),
        }
    }

    /// The frame without the objects that count as moving in it: what a map of the static scene would show
    /// at that moment. It contains objects at rest, unlike the frame of the twin; an object enters or
    /// leaves it when its mask changes. Its own mask is empty.
    #[must_use]
    pub fn background(&self, index: usize, par: Par) -> SynthFrame {
        let mut still = self.clone();
        still
            .actors
            .retain(|actor| !self.counts_as_moving(actor, index));
        still.frame(index, par)
    }

    /// Brightness of the light in a frame: 1, or nearly 0 while the light is off.
    #[must_use]
    pub fn brightness(&self, index: usize) -> f32 {
        brightness(self.config.name, self.timestamp(index))
    }

    /// Exact optical flow from frame `i` to frame `j`, pixels: the displacement of the surface point at the
    /// centre of each pixel. Each rigid part of an object has its own motion. NaN where the point is
    /// hidden in frame `j` or outside its image.
    #[must_use]
    pub fn flow(&self, i: usize, j: usize, par: Par) -> Image<[f32; 2]> {
        let camera_from_world = self.world_from_camera(j).inverse();
        flow::flow(&self.view(i), &self.view(j), &camera_from_world, par)
    }

    fn view(&self, index: usize) -> View {
        let t_s = self.timestamp(index);
        let movers = self.actors.iter().flat_map(|actor| actor.solids(t_s));
        let solids = self.room.iter().copied().chain(movers).collect();
        View::new(self.camera, &self.world_from_camera(index), solids)
    }

    fn sensed(&self, exact: Rendered, index: usize, par: Par) -> (RgbImage, DepthImage, Image<u8>) {
        let (mut rgb, mut depth) = (exact.rgb, exact.depth);
        if self.config.noise {
            let key = (self.config.seed, index as u64);
            rgb = noise::measured_rgb(&rgb, key, par);
            depth = noise::measured_depth(&depth, &exact.incidence, key, par);
        }
        if self.config.name == SceneName::Hall {
            depth = depth.map(|&z| {
                if f64::from(z) > noise::HALL_RANGE_M {
                    0.0
                } else {
                    z
                }
            });
        }
        (rgb, depth, exact.object)
    }

    /// Whether it moves in the interval before this frame, or did so within the memory of the mask. For
    /// the first frame the interval after it counts.
    fn counts_as_moving(&self, actor: &Actor, index: usize) -> bool {
        let t = |k: usize| self.timestamp(k);
        (index.saturating_sub(MASK_MEMORY_FRAMES)..=index).any(|k| {
            let before = k.saturating_sub(1);
            actor.moves_between(t(before), t(before + 1))
        })
    }
}

#[allow(
    clippy::cast_possible_truncation,
    reason = "any 32 bits of the seed are good"
)]
fn texture_seed(seed: u64) -> u32 {
    (seed ^ (seed >> 32)) as u32
}
