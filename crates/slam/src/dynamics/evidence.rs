//! [`DepthEvidence`]: what the depth images of other times say about a point.

use garad_core::{Camera, Label, Se3};
use garad_crf::DepthNoise;
use nalgebra::Vector3;

use super::free_space::{FreeSpace, Visibility};

/// The free space of another time, and the pose it was seen from.
#[derive(Debug)]
pub struct HistoryView<'a> {
    /// What it saw to be empty.
    pub free_space: &'a FreeSpace,
    /// Its pose.
    pub camera_from_world: Se3,
    /// Frames between then and now.
    pub age_frames: u32,
}

/// The free space of all views that a frame is compared with.
#[derive(Debug)]
pub struct FreeSpaceHistory<'a> {
    /// Of all views.
    pub camera: &'a Camera,
    /// Of the depth camera.
    pub noise: &'a DepthNoise,
    /// The views, in any order.
    pub views: Vec<HistoryView<'a>>,
}

/// What all views together say about a point.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DepthEvidence {
    /// Distance in front of the surface seen there, in standard deviations of the sensor: the
    /// largest of all views, 0 if all that see the point have it on a static surface, `None` if no
    /// view sees it.
    pub residual: Option<f64>,
    /// Age of the oldest view that has the point on a static surface, frames.
    pub agreed_frames: u32,
}

impl FreeSpaceHistory<'_> {
    /// The evidence on a point: its depth cue, and how long it has been on a static surface.
    #[must_use]
    pub fn query(&self, p_world: &Vector3<f64>) -> DepthEvidence {
        let mut evidence = DepthEvidence::default();
        for view in &self.views {
            let so_far = evidence.residual.unwrap_or(0.0);
            let pose = &view.camera_from_world;
            match (view.free_space).query(p_world, self.camera, pose, self.noise) {
                Visibility::InFront(sigmas) => evidence.residual = Some(so_far.max(sigmas)),
                Visibility::OnSurface(Label::Static) => {
                    evidence.residual = Some(so_far);
                    evidence.agreed_frames = evidence.agreed_frames.max(view.age_frames);
                }
                Visibility::OnSurface(Label::Dynamic)
                | Visibility::Occluded
                | Visibility::Unknown => {}
            }
        }
        evidence
    }
}

#[cfg(test)]
mod tests {
    use Label::{Dynamic, Static};
    use garad_core::{DepthImage, MaskImage};
    use nalgebra::Vector6;

    use super::*;
    use crate::mask::MOVING;

    const NOISE: DepthNoise = DepthNoise {
        per_m: 0.0,
        floor_m: 0.1,
    };

    /// What a view measured all over, its label and age, and the motion of the world before its camera.
    type Seen = (f32, Label, u32, f64);
    /// Residual and age.
    type Found = (Option<f64>, u32);

    /// The evidence on the point at 2 m on the axis.
    fn evidence(views: &[Seen]) -> Found {
        let camera = Camera::pinhole((64, 48), [60.0, 50.0, 31.5, 23.5]).expect("valid");
        let free_space = |(depth_m, label, ..): &Seen| {
            let mut free_space = FreeSpace::new(&DepthImage::new(64, 48, *depth_m), 8.0);
            if *label == Dynamic {
                free_space.set_moving(MaskImage::new(16, 12, MOVING));
            }
            free_space
        };
        let seen: Vec<FreeSpace> = views.iter().map(free_space).collect();
        let view = |((_, _, age_frames, z), free_space)| HistoryView {
            free_space,
            camera_from_world: Se3::exp(&Vector6::new(0.0, 0.0, z, 0.0, 0.0, 0.0)),
            age_frames,
        };
        let history = FreeSpaceHistory {
            camera: &camera,
            noise: &NOISE,
            views: views.iter().copied().zip(&seen).map(view).collect(),
        };
        let found = history.query(&Vector3::new(0.0, 0.0, 2.0));
        (found.residual, found.agreed_frames)
    }

    /// At σ = 0.1 m the point is 5 σ before 2.5 m, 2.5 σ before 2.25 m, on 2 m, and hidden by 1 m.
    #[test]
    fn the_largest_residual_and_the_oldest_static_surface_count() {
        let cases: &[(&[Seen], Found)] = &[
            (&[], (None, 0)),
            (&[(1.0, Static, 9, 0.0)], (None, 0)),
            (&[(0.0, Static, 9, 0.0)], (None, 0)),
            (&[(2.0, Dynamic, 9, 0.0)], (None, 0)),
            (&[(2.0, Static, 9, 0.0)], (Some(0.0), 9)),
            (&[(2.5, Static, 9, 0.0)], (Some(5.0), 0)),
            (&[(2.5, Dynamic, 9, 0.0)], (Some(5.0), 0)),
            (
                &[
                    (2.25, Static, 30, 0.0),
                    (2.5, Static, 20, 0.0),
                    (2.0, Static, 10, 0.0),
                ],
                (Some(5.0), 10),
            ),
            (
                &[
                    (2.0, Static, 10, 0.0),
                    (2.5, Static, 20, 0.0),
                    (2.25, Static, 30, 0.0),
                ],
                (Some(5.0), 10),
            ),
            (
                &[
                    (2.0, Static, 7, 0.0),
                    (2.0, Static, 31, 0.0),
                    (2.0, Static, 12, 0.0),
                ],
                (Some(0.0), 31),
            ),
            (
                &[
                    (2.0, Static, 7, 0.0),
                    (2.0, Dynamic, 31, 0.0),
                    (1.0, Static, 40, 0.0),
                    (0.0, Static, 50, 0.0),
                ],
                (Some(0.0), 7),
            ),
        ];
        for (views, expected) in cases {
            assert_eq!(evidence(views), *expected, "{views:?}");
        }
    }

    /// A camera half a metre ahead has the point at 1.5 m, one half a metre behind at 2.5 m.
    #[test]
    fn each_view_has_its_own_pose() {
        let views = [(2.0, Static, 9, -0.5), (2.5, Static, 4, 0.5)];
        assert_eq!(evidence(&views[..1]), (Some(5.0), 0), "ahead");
        assert_eq!(evidence(&views[1..]), (Some(0.0), 4), "behind");
        assert_eq!(evidence(&views), (Some(5.0), 4), "both");
    }
}
