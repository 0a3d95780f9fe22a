//! The pose of a frame from its links to static landmarks (eq. 11).

use garad_optim::{CentrePrior, PoseConfig, optimise_pose};

use super::observation::link_observation;
use crate::context::Context;
use crate::frame::{Frame, PoseInformation};
use crate::map::Map;
use crate::trace::Recorder;

/// Links without which no pose is computed.
const MIN_LINKS: usize = 3;

/// Optimises the frame's pose over its links to static landmarks (eq. 11, solved by
/// [`optimise_pose`]) and unlinks the outliers. Returns the number of inliers; 0 leaves the pose as
/// it was.
pub(crate) fn pose_from_links(
    context: &Context,
    map: &Map,
    frame: &mut Frame,
    recorder: &mut Recorder,
) -> usize {
    let mut keypoints = Vec::new();
    let mut observations = Vec::new();
    for i in 0..frame.len() {
        let Some(landmark) = frame.landmark[i].and_then(|l| map.static_landmark(l)) else {
            frame.landmark[i] = None;
            continue;
        };
        debug_assert!(frame.in_use[i], "only keypoints in use are linked");
        keypoints.push(i);
        observations.push(link_observation(context, frame, i, landmark));
    }
    if observations.len() < MIN_LINKS {
        return 0;
    }
    let before = frame.camera_from_world;
    let prior = centre_prior(frame);
    let solution = optimise_pose(
        &context.camera,
        &observations,
        &before,
        &PoseConfig {
            prior,
            ..pose_config(context)
        },
    )
    .expect("at least three observations, of finite numbers");
    if !solution.camera_from_world.is_finite() {
        return 0;
    }
    recorder.record("pose", |record| {
        record.pose_lm(
            &keypoints,
            &observations,
            &before,
            prior.as_ref(),
            &solution,
        );
    });
    frame.camera_from_world = solution.camera_from_world;
    frame.information = PoseInformation {
        matrix: solution.information,
        links: solution.n_inliers,
    };
    for (&i, inlier) in keypoints.iter().zip(&solution.inlier) {
        if !inlier {
            frame.landmark[i] = None;
        }
    }
    solution.n_inliers
}

/// What the camera's motion so far says of the frame's centre.
pub(crate) fn centre_prior(frame: &Frame) -> Option<CentrePrior> {
    let expected = frame.expected?;
    Some(CentrePrior {
        centre_m: expected.centre_m,
        root_information: expected.information.cholesky()?.l(),
    })
}

/// The settings of eq. 11's solver.
pub(crate) fn pose_config(context: &Context) -> PoseConfig {
    PoseConfig {
        bf: context.config.tracking.bf,
        ..PoseConfig::default()
    }
}

#[cfg(test)]
mod tests {
    use garad_core::Se3;
    use nalgebra::{Matrix3, Vector3};

    use super::*;
    use crate::config::Config;
    use crate::frame::CentreEstimate;
    use crate::testing::{World, cloud, small_motion, uneven_camera};

    /// 70 landmarks and a frame that sees them all from [`small_motion`], linked, thought to be at the origin.
    fn linked() -> (World, Frame) {
        let mut config = Config::default();
        config.tracking.bf = 36.0;
        let mut world = World::with_camera(uneven_camera(), config);
        let seen = world.see(0, &cloud(), &Se3::identity());
        let made = world.remember(seen, &cloud());
        let mut now = world.see(1, &cloud(), &small_motion());
        for (i, id) in made.into_iter().enumerate() {
            now.landmark[i] = Some(id);
            now.depth_m[i] = Some((small_motion() * cloud()[i]).z);
        }
        (world, now)
    }

    fn solve(world: &World, frame: &mut Frame) -> usize {
        pose_from_links(&world.context, &world.map, frame, &mut Recorder::default())
    }

    fn off(frame: &Frame) -> f64 {
        (frame.camera_from_world * small_motion().inverse())
            .log()
            .norm()
    }

    #[test]
    fn what_moves_is_gone_or_does_not_fit_is_unlinked() {
        let (mut world, mut now) = linked();
        let id = |i: usize| now.landmark[i].expect("linked");
        world.set_moving(&[id(3), id(4)]);
        world.map.drop_landmark(id(5));
        now.uv_px[6].x += 9.0;
        now.depth_m[7] = Some(1.0);
        now.landmark[8] = None;
        assert_eq!(solve(&world, &mut now), 64, "six of 70 are out");
        assert!(off(&now) < 1e-5, "{} from the truth", off(&now));
        let unlinked: Vec<_> = (0..70).filter(|&i| now.landmark[i].is_none()).collect();
        assert_eq!(unlinked, [3, 4, 5, 6, 7, 8], "links");
        assert_eq!(now.information.links, 64, "links behind the information");
        assert!(now.information.matrix[(0, 0)] > 0.0, "information");
    }

    #[test]
    fn two_links_are_no_pose() {
        for (links, inliers) in [(0, 0), (2, 0), (3, 3)] {
            let (world, mut now) = linked();
            for i in 0..70 {
                // Far apart: 0, 34 and 69.
                let kept = [0, 34, 69][..links].contains(&i);
                now.landmark[i] = now.landmark[i].filter(|_| kept);
            }
            assert_eq!(solve(&world, &mut now), inliers, "{links} links");
            let stays = now.camera_from_world == Se3::identity();
            assert_eq!(stays, links < 3, "{links} links");
            assert_eq!(now.information.links, inliers, "{links} links");
        }
    }

    /// The centre is expected 2 mm off, so precisely (σ = 0.1 mm) that 70 links (σ about 3 mm) give way.
    #[test]
    fn where_the_camera_is_expected_counts() {
        let (world, mut now) = linked();
        now.depth_m.fill(None);
        let expected = |offset_m: f64| CentreEstimate {
            centre_m: small_motion().inverse().translation + Vector3::new(offset_m, 0.0, 0.0),
            information: Matrix3::identity() * 1e8,
        };
        let mut free = now.clone();
        solve(&world, &mut free);
        now.expected = Some(expected(0.002));
        solve(&world, &mut now);
        let centre = |frame: &Frame| frame.center().x - small_motion().inverse().translation.x;
        assert!(centre(&free).abs() < 1e-5, "without: {}", centre(&free));
        assert!(
            (centre(&now) - 0.002).abs() < 1e-4,
            "there: {}",
            centre(&now)
        );
    }

    /// Σ⁻¹ = L Lᵀ of L = [[2, 0, 0], [3, 5, 0], [-1, 4, 7]].
    #[test]
    fn the_prior_is_the_root_of_the_information() {
        let (_, mut frame) = linked();
        assert_eq!(centre_prior(&frame), None, "nothing expected");
        let centre_m = Vector3::new(0.5, -0.25, 2.0);
        let mut information = Matrix3::new(4.0, 6.0, -2.0, 6.0, 34.0, 17.0, -2.0, 17.0, 66.0);
        frame.expected = Some(CentreEstimate {
            centre_m,
            information,
        });
        let prior = centre_prior(&frame).expect("positive definite");
        assert_eq!(prior.centre_m, centre_m, "centre");
        let expected = Matrix3::new(2.0, 0.0, 0.0, 3.0, 5.0, 0.0, -1.0, 4.0, 7.0);
        assert!(
            (prior.root_information - expected).norm() < 1e-12,
            "{prior:?}"
        );
        information[(2, 2)] = -1.0;
        frame.expected = Some(CentreEstimate {
            centre_m,
            information,
        });
        assert_eq!(centre_prior(&frame), None, "no information at all");
    }

    #[test]
    fn the_solver_has_the_bf_of_the_configuration() {
        let (world, _) = linked();
        let expected = PoseConfig {
            bf: 36.0,
            ..PoseConfig::default()
        };
        assert_eq!(
            pose_config(&world.context),
            expected,
            "all else as in ORB-SLAM"
        );
    }
}
