//! Fixtures of the unit tests: a small camera in front of a wall, and its frames.

use garad_core::{
    Camera, DepthImage, FrameId, GrayImage, KeyframeId, Label, LandmarkId, MaskImage, Par, Real,
    Rng, Se3, So3,
};
use garad_crf::LabelWindowConfig;
use garad_features::{Descriptor, Keypoint, LkPyramid};
use nalgebra::{Vector2, Vector3};

use crate::config::Config;
use crate::context::Context;
use crate::dynamics::samples::FrameView;
use crate::dynamics::{Dynamics, NewView};
use crate::frame::{Frame, Levels};
use crate::map::Map;
use crate::observer::{Observer, Stage};
use crate::trace::Recorder;

/// Distance of the wall, metres.
const WALL_M: f32 = 3.0;

/// What the stages of tracking and labelling read and own.
pub(crate) struct World {
    pub(crate) context: Context,
    pub(crate) map: Map,
    pub(crate) dynamics: Dynamics,
}

impl World {
    /// An empty map and a camera of 160 x 120 pixels.
    pub(crate) fn new(config: Config) -> Self {
        let camera = Camera::pinhole((160, 120), [120.0, 120.0, 79.5, 59.5]).expect("valid");
        Self::with_camera(camera, config)
    }

    pub(crate) fn with_camera(camera: Camera, config: Config) -> Self {
        let context = Context::new(camera, config, 0, Par::Seq).expect("valid");
        Self {
            map: Map::default(),
            dynamics: Dynamics::new(&context).expect("valid"),
            context,
        }
    }

    /// Three keyframes at the same place that observe 300 points of the wall, and these points.
    pub(crate) fn three_views() -> (Self, Vec<LandmarkId>) {
        let mut world = Self::new(Config::default());
        let depth = wall();
        let first = world.frame(0, &depth);
        let first = world.map.add_keyframe(first);
        let World { context, map, .. } = &mut world;
        let made: Vec<_> = (0..300)
            .map(|i| {
                let p_world = map.keyframe(first).world_point(i, &context.camera);
                map.add_landmark(p_world.expect("on the wall"), first, i, &context.scales)
            })
            .collect();
        for id in [20, 40] {
            let mut seen = world.frame(id, &depth);
            seen.landmark = made.iter().copied().map(Some).collect();
            world.map.add_keyframe(seen);
        }
        (world, made)
    }

    /// Keyframes at the poses of [`turned`], frames 0, 10, 20, ..., and landmarks, each given by its
    /// observers, first the one that makes it. Landmark i is keypoint i everywhere; it lies where its first
    /// observer sees it.
    pub(crate) fn observing(config: Config, keyframes: u32, landmarks: &[&[u32]]) -> Self {
        let camera = Camera::pinhole((160, 120), [120.0, 110.0, 78.5, 60.5]).expect("valid");
        let mut world = Self::with_camera(camera, config);
        let (depth, points) = (wall(), places().into_iter().take(landmarks.len()));
        let points = keypoints(points);
        for k in 0..keyframes {
            let mut frame = world.frame_of(10 * k, &points, &depth);
            frame.camera_from_world = turned(k);
            world.map.add_keyframe(frame);
        }
        let World { context, map, .. } = &mut world;
        for (i, observers) in landmarks.iter().enumerate() {
            let first = KeyframeId(observers[0]);
            let p_world = map.keyframe(first).world_point(i, &context.camera);
            let p_world = p_world.expect("on the wall");
            let id = map.add_landmark(p_world, first, i, &context.scales);
            for k in &observers[1..] {
                map.add_observation(id, KeyframeId(*k), i);
            }
            map.refresh(id, &context.scales);
        }
        world
    }

    /// A landmark is dynamic from now on.
    pub(crate) fn set_dynamic(&mut self, landmark: u32) {
        let landmark = self.map.landmark_mut(LandmarkId(landmark));
        let landmark = landmark.expect("a landmark of the map");
        landmark.push_label(Label::Dynamic, &LabelWindowConfig::default());
    }

    /// Who observes a landmark with which keypoint; nobody if it was dropped.
    pub(crate) fn observers(&self, landmark: u32) -> Vec<(u32, usize)> {
        let landmark = self.map.landmark(LandmarkId(landmark));
        let observations = landmark.map(|l| l.observations.iter());
        observations.map_or(Vec::new(), |o| o.map(|(k, i)| (k.0, *i)).collect())
    }

    /// A frame with a keypoint at each of [`places`].
    pub(crate) fn frame(&self, id: u32, depth: &DepthImage) -> Frame {
        self.frame_of(id, &keypoints(places()), depth)
    }

    pub(crate) fn frame_of(&self, id: u32, keypoints: &[Keypoint], depth: &DepthImage) -> Frame {
        let descriptors = vec![Descriptor::default(); keypoints.len()];
        self.frame_with(id, keypoints, descriptors, depth)
    }

    /// The images of points of the world, without depth; the k-th point has a descriptor of its own.
    pub(crate) fn see(&self, id: u32, points: &[Vector3<f64>], camera_from_world: &Se3) -> Frame {
        let mut rng = Rng::new(7);
        let (keypoints, descriptors) = (points.iter())
            .map(|p| {
                let uv_px = (self.context.camera).project(&(*camera_from_world * *p));
                let uv_px = uv_px.expect("in front of the camera");
                let keypoint = Keypoint {
                    x: uv_px.x.to_f32(),
                    y: uv_px.y.to_f32(),
                    level: 0,
                    angle_deg: 0.0,
                    response: 1.0,
                };
                (keypoint, Descriptor([(); 4].map(|()| rng.next_u64())))
            })
            .collect::<(Vec<_>, Vec<_>)>();
        self.frame_with(id, &keypoints, descriptors, &DepthImage::new(160, 120, 0.0))
    }

    /// Adds a keyframe whose k-th keypoint makes a landmark of the k-th point.
    pub(crate) fn remember(&mut self, frame: Frame, points: &[Vector3<f64>]) -> Vec<LandmarkId> {
        let (map, scales) = (&mut self.map, &self.context.scales);
        let id = map.add_keyframe(frame);
        (points.iter().enumerate())
            .map(|(i, p)| map.add_landmark(*p, id, i, scales))
            .collect()
    }

    /// Makes landmarks dynamic.
    pub(crate) fn set_moving(&mut self, landmarks: &[LandmarkId]) {
        for id in landmarks {
            let landmark = self.map.landmark_mut(*id).expect("in the map");
            landmark.push_label(Label::Dynamic, &self.context.config.labels.window);
        }
    }

    fn frame_with(
        &self,
        id: u32,
        keypoints: &[Keypoint],
        descriptors: Vec<Descriptor>,
        depth: &DepthImage,
    ) -> Frame {
        let config = &self.context.config;
        let levels = Levels::new(depth.size(), 1.2, 8, config.features.exact_levels);
        Frame::new(
            FrameId(id),
            f64::from(id) / 30.0,
            keypoints.to_vec(),
            descriptors,
            depth,
            None,
            &self.context.camera,
            &levels,
            config,
        )
    }

    /// Adds a keyframe and its free space.
    pub(crate) fn keep(&mut self, frame: Frame, depth: &DepthImage) -> KeyframeId {
        let id = self.map.add_keyframe(frame);
        let view = NewView {
            frame: self.map.keyframe(id),
            reference: id,
            depth,
            image: None,
            cells: None,
        };
        (self.dynamics).add_view(&self.context, &self.map, view);
        id
    }

    /// Labels a frame and returns its mask in cells.
    pub(crate) fn label(
        &self,
        frame: &mut Frame,
        depth: &DepthImage,
        pyramid: Option<&LkPyramid>,
    ) -> Option<MaskImage> {
        let view = FrameView {
            frame,
            depth,
            pyramid,
        };
        let (context, recorder) = (&self.context, &mut Recorder::default());
        let labels = (self.dynamics).label_frame(context, view, &self.map, recorder)?;
        frame.apply_labels(&labels, &context.camera);
        Some(labels.cells)
    }
}

/// camera_from_world of keyframe k: about another axis each, so that no two of them commute.
pub(crate) fn turned(k: u32) -> Se3 {
    let k = f64::from(k);
    Se3::new(
        So3::exp(&Vector3::new(0.11 * k, 0.03 * k * k, -0.05 * k)),
        Vector3::new(0.2 * k, -0.1 * k * k, 0.07 * k),
    )
}

/// Farthest that two poses take a point of a cube of 2 m apart, metres.
pub(crate) fn apart(a: &Se3, b: &Se3) -> f64 {
    let corners =
        (0..8).map(|i| Vector3::from([0, 1, 2].map(|bit| 1.0 - f64::from(i >> bit & 1) * 2.0)));
    let apart = corners.map(|p| (*a * p - *b * p).norm());
    apart.fold(0.0, f64::max)
}

/// Keypoints of level 0 at these pixels.
pub(crate) fn keypoints(places: impl IntoIterator<Item = [usize; 2]>) -> Vec<Keypoint> {
    let keypoint = |[x, y]: [usize; 2]| Keypoint {
        x: x as f32,
        y: y as f32,
        level: 0,
        angle_deg: 0.0,
        response: 1.0,
    };
    places.into_iter().map(keypoint).collect()
}

/// Blots of 3 x 3 pixels.
pub(crate) fn texture() -> GrayImage {
    let mut rng = Rng::new(11);
    let blots = GrayImage::from_fn(60, 41, |_, _| {
        40 + u8::try_from(rng.below(170)).expect("u8")
    });
    GrayImage::from_fn(160, 120, |x, y| blots[(x / 3, y / 3)])
}

pub(crate) fn wall() -> DepthImage {
    DepthImage::new(160, 120, WALL_M)
}

/// A box half way to the wall that covers these columns and rows.
pub(crate) fn wall_behind(box_px: [[usize; 2]; 2]) -> DepthImage {
    DepthImage::from_fn(160, 120, |x, y| match is_in(box_px, x, y) {
        true => 0.5 * WALL_M,
        false => WALL_M,
    })
}

pub(crate) fn is_in([[x0, x1], [y0, y1]]: [[usize; 2]; 2], x: usize, y: usize) -> bool {
    (x0..x1).contains(&x) && (y0..y1).contains(&y)
}

/// Every 8th pixel each way: 20 columns of 15 keypoints.
pub(crate) fn places() -> Vec<[usize; 2]> {
    let columns = (4..160).step_by(8);
    columns
        .flat_map(|x| (4..120).step_by(8).map(move |y| [x, y]))
        .collect()
}

/// A camera of 160 x 120 pixels whose numbers all differ.
pub(crate) fn uneven_camera() -> Camera {
    Camera::pinhole((160, 120), [110.0, 130.0, 78.0, 61.0]).expect("valid")
}

/// 70 points 2 to 3.5 m in front of [`uneven_camera`] at the origin, 14 px from each other.
pub(crate) fn cloud() -> Vec<Vector3<f64>> {
    let camera = uneven_camera();
    let places = (0..10).flat_map(|i| (0..7).map(move |j| (i, j)));
    places
        .map(|(i, j)| {
            let px = Vector2::new(f64::from(14 * i + 17), f64::from(14 * j + 16));
            camera.unproject(&px, 2.0 + 0.5 * f64::from((2 * i + 3 * j) % 4))
        })
        .collect()
}

/// A motion of a few pixels: rotation and translation about every axis.
pub(crate) fn small_motion() -> Se3 {
    Se3::exp(&[0.03, -0.02, 0.05, 0.012, -0.017, 0.02].into())
}

/// The stages that began, in order; each must end before the next.
#[derive(Debug, Default)]
pub(crate) struct Stages {
    pub(crate) begun: Vec<Stage>,
    open: Option<Stage>,
}

impl Observer for Stages {
    fn begin(&mut self, stage: Stage) {
        assert_eq!(self.open.replace(stage), None, "stages do not nest");
        self.begun.push(stage);
    }

    fn end(&mut self, stage: Stage) {
        assert_eq!(self.open.take(), Some(stage), "what ended");
    }
}
