//! Known poses with wrong matches, and input that allows no pose.

use super::*;
use crate::reprojection::DepthObservation;
use nalgebra::{Vector2, Vector6};

const BF: f64 = 40.0;

fn camera() -> Camera {
    Camera::pinhole((640, 480), [535.4, 539.2, 320.1, 247.6]).unwrap()
}

/// n matches of which the first `wrong` are anywhere, the others within noise.
fn matches(seed: u64, n: usize, wrong: usize, noise_px: f64) -> (Se3, Vec<PoseObservation>) {
    let mut rng = Rng::keyed(8, &[seed]);
    let pose = Se3::exp(&Vector6::from_fn(|_, _| rng.normal()));
    let observations = (0..n)
        .map(|i| {
            let seen = Vector2::new(rng.range(0.0, 640.0), rng.range(0.0, 480.0));
            let depth_m = rng.range(0.8, 6.0);
            let uv_px = if i < wrong {
                Vector2::new(rng.range(0.0, 640.0), rng.range(0.0, 480.0))
            } else {
                seen + Vector2::new(rng.normal(), rng.normal()) * noise_px
            };
            let depth = DepthObservation::right_from_depth(uv_px.x, 1.0, depth_m, 0.02, BF);
            PoseObservation {
                p_world: pose.inverse() * camera().unproject(&seen, depth_m),
                uv_px,
                sigma_px: 1.0,
                depth: (i % 3 != 0).then_some(depth),
            }
        })
        .collect();
    (pose, observations)
}

fn solve(observations: &[PoseObservation]) -> Option<PnpResult> {
    solve_pnp_ransac(&camera(), observations, &PnpConfig::default(), Par::Seq).unwrap()
}

#[test]
fn half_of_the_matches_may_be_wrong() {
    for seed in 0..20 {
        let (truth, observations) = matches(seed, 120, 60, 0.7);
        let result = solve(&observations).unwrap_or_else(|| panic!("seed {seed}: no pose"));
        let error = (result.camera_from_world * truth.inverse()).log().norm();
        assert!(error < 0.02, "seed {seed}: {error}");
        assert_eq!(result.n_inliers, count(&result.inlier), "counted");
        let right = count(&result.inlier[60..]);
        assert!(right >= 55, "seed {seed}: {right} of 60 found again");
        assert!(
            result.n_inliers - right <= 2,
            "seed {seed}: outliers accepted"
        );
    }
}

#[test]
fn clean_matches_end_early_and_exactly() {
    let (truth, observations) = matches(1, 50, 0, 0.0);
    let result = solve(&observations).unwrap();
    assert_eq!(result.samples, BATCH, "one batch");
    assert_eq!(result.n_inliers, 50, "all");
    let error = (result.camera_from_world * truth.inverse()).log().norm();
    assert!(error < 1e-6, "{error}");
}

#[test]
fn threads_change_nothing() {
    let (_, observations) = matches(3, 100, 50, 1.0);
    let config = PnpConfig::default();
    let run = |par| solve_pnp_ransac(&camera(), &observations, &config, par).unwrap();
    let expected = run(Par::Seq);
    assert!(expected.is_some(), "a pose");
    for threads in [2, 3] {
        assert_eq!(run(Par::Threads(threads)), expected, "{threads} threads");
    }
}

#[test]
fn no_pose_is_a_result() {
    let (_, all) = matches(5, 60, 60, 1.0);
    assert_eq!(solve(&all), None, "nothing but wrong matches");
    assert_eq!(solve(&[]), None, "nothing");
    assert_eq!(solve(&all[..2]), None, "two");
    let (_, good) = matches(6, 9, 0, 0.5);
    assert_eq!(solve(&good), None, "nine agree, ten are asked for");
    let on_a_line = |i: usize| PoseObservation {
        p_world: Vector3::new(0.01 * i as f64, 0.0, 2.0),
        uv_px: Vector2::new(320.0 + 2.0 * i as f64, 240.0),
        sigma_px: 1.0,
        depth: None,
    };
    let line: Vec<_> = (0..30).map(on_a_line).collect();
    assert_eq!(solve(&line), None, "a line");
    let one: Vec<_> = (0..30).map(|_| on_a_line(3)).collect();
    assert_eq!(solve(&one), None, "one place");
}

#[test]
fn bad_input_is_named() {
    let (_, good) = matches(7, 20, 0, 0.5);
    let error_of = |observations: &[PoseObservation], config: &PnpConfig| {
        let result = solve_pnp_ransac(&camera(), observations, config, Par::Seq);
        result.unwrap_err().to_string()
    };
    let mut nan = good.clone();
    nan[4].p_world.y = f64::NAN;
    let error = error_of(&nan, &PnpConfig::default());
    assert!(error.contains("p_world of observation 4"), "{error}");
    let mut no_sigma = good.clone();
    no_sigma[2].sigma_px = 0.0;
    let error = error_of(&no_sigma, &PnpConfig::default());
    assert!(error.contains("sigma_px of observation 2"), "{error}");
    for confidence in [0.0, 1.0, f64::NAN] {
        let config = PnpConfig {
            confidence,
            ..PnpConfig::default()
        };
        let error = error_of(&good, &config);
        assert!(error.contains("confidence"), "{confidence}: {error}");
    }
}

#[test]
fn samples_by_hand() {
    // Half right: 1 in 8 triples is clean; ln 0.01 / ln 0.875 = 34.5.
    assert_eq!(samples_needed(0.5, 0.99), 35);
    assert_eq!(samples_needed(1.0, 0.99), 1, "all right");
    assert_eq!(samples_needed(0.0, 0.99), usize::MAX, "none");
    let mut rng = Rng::new(0);
    for _ in 0..50 {
        let mut three = three_of(3, &mut rng);
        three.sort_unstable();
        assert_eq!(three, [0, 1, 2], "all different");
    }
}

/// 40 exact matches of which half are wrong: 1 in 8 triples is clean. ln(1 - c)/ln(7/8) is 5.2, 34.5 and 51.7
/// for the confidences; the rule is asked after each batch of 32.
#[test]
fn draws_end_by_confidence_and_by_their_limit() {
    let (truth, mut observations) = matches(2, 40, 20, 0.0);
    for (i, o) in observations[..20].iter_mut().enumerate() {
        o.uv_px.y += 1e3 + 90.0 * i as f64; // nowhere near
    }
    for (confidence, max_samples, expected) in [
        (0.5, 300, 32),
        (0.99, 300, 35),
        (0.999, 300, 52),
        (0.999, 45, 45),
        (0.999, 20, 20),
    ] {
        let config = PnpConfig {
            confidence,
            max_samples,
            ..PnpConfig::default()
        };
        let result = solve_pnp_ransac(&camera(), &observations, &config, Par::Seq);
        let result = result.unwrap().expect("a pose");
        assert_eq!(result.samples, expected, "{confidence}, {max_samples}");
        assert_eq!(result.n_inliers, 20, "the right ones");
        let error = (result.camera_from_world * truth.inverse()).log().norm();
        assert!(error < 1e-6, "{error}");
    }
    for (min_inliers, found) in [(20, true), (21, false)] {
        let config = PnpConfig {
            min_inliers,
            ..PnpConfig::default()
        };
        let result = solve_pnp_ransac(&camera(), &observations, &config, Par::Seq);
        assert_eq!(result.unwrap().is_some(), found, "{min_inliers} of 20");
    }
}

/// One draw hits three right matches of 20 among 40 in an eighth of the cases: by seed, and as the
/// first draw of that seed.
#[test]
fn the_seed_decides_the_draws() {
    let (_, mut observations) = matches(2, 40, 20, 0.0);
    for (i, o) in observations[..20].iter_mut().enumerate() {
        o.uv_px.y += 1e3 + 90.0 * i as f64;
    }
    let found = |seed: u64, max_samples: usize| {
        let config = PnpConfig {
            seed,
            max_samples,
            ..PnpConfig::default()
        };
        let result = solve_pnp_ransac(&camera(), &observations, &config, Par::Seq);
        result.unwrap().is_some()
    };
    let mut hits = 0;
    for seed in 0..64 {
        let clean = |i: u64| {
            let triple = three_of(40, &mut Rng::keyed(seed, &[i]));
            triple.iter().all(|&k| k >= 20)
        };
        assert_eq!(found(seed, 1), clean(0), "seed {seed}, one draw");
        assert_eq!(
            found(seed, 3),
            (0..3).any(clean),
            "seed {seed}, three draws"
        );
        hits += usize::from(clean(0));
    }
    assert!((2..20).contains(&hits), "an eighth of 64: {hits}");
}

/// A point 2 m ahead seen 0, 1, 1.5, 2 and 50 σ beside its place, and one behind; gate 1.5² = 2.25 on pixels,
/// 2² = 4 with depth, whose readings are exact but for the fourth, 1.5 σ off.
#[test]
fn hypotheses_are_judged_by_pixels_and_refined_ones_with_depth() {
    let camera = Camera::pinhole((640, 480), [500.0, 400.0, 320.0, 240.0]).unwrap();
    let off_sigma = [0.0, 1.0, 1.5, 2.0, 50.0, 0.0];
    let observations: Vec<PoseObservation> = (0..6)
        .map(|i| PoseObservation {
            p_world: Vector3::new(0.0, 0.0, if i == 5 { -2.0 } else { 2.0 }),
            uv_px: Vector2::new(320.0, 240.0 + 2.0 * off_sigma[i]),
            sigma_px: 2.0,
            depth: (i % 2 == 1).then_some(DepthObservation::Disparity {
                disparity_px: 12.5 + if i == 3 { 0.75 } else { 0.0 },
                sigma_px: 0.5,
            }),
        })
        .collect();
    let config = PnpConfig {
        pose: PoseConfig {
            bf: 25.0,
            chi2_2d: 2.25,
            chi2_3d: 4.0,
            ..PoseConfig::default()
        },
        ..PnpConfig::default()
    };
    let problem = Pnp {
        intrinsics: Intrinsics::new(&camera, config.pose.bf),
        bearings: Vec::new(),
        observations: &observations,
        config: &config,
    };
    let judged = problem.judge(Se3::identity());
    assert!(
        (judged.cost - (1.0 + 2.25 + 3.0 * 2.25)).abs() < 1e-12,
        "{judged:?}"
    );
    assert_eq!(judged.n_inliers, 3, "0, 1 and 1.5 σ");
    let inliers = |with_depth| problem.inliers(&Se3::identity(), with_depth);
    assert_eq!(
        inliers(false),
        [true, true, true, false, false, false],
        "pixels"
    );
    assert_eq!(
        inliers(true),
        [true, true, true, false, false, false],
        "depth: 4 + 2.25 > 4"
    );
    let mut exact = observations.clone();
    exact[3].depth = observations[1].depth;
    let problem = Pnp {
        observations: &exact,
        ..problem
    };
    let inliers = problem.inliers(&Se3::identity(), true);
    assert_eq!(
        inliers,
        [true, true, true, true, false, false],
        "2 σ with its depth"
    );
}

/// With a gate that nothing passes all poses cost the same: the first pose of the first triple that allows one is taken,
/// whatever the threads.
#[test]
fn of_equal_hypotheses_the_first_is_taken() {
    let (_, observations) = matches(4, 12, 3, 1.0);
    let camera = camera();
    let mut config = PnpConfig::default();
    config.pose.chi2_2d = -1.0;
    let problem = Pnp {
        intrinsics: Intrinsics::new(&camera, config.pose.bf),
        bearings: (observations.iter())
            .map(|o| camera.unproject(&o.uv_px, 1.0))
            .collect(),
        observations: &observations,
        config: &config,
    };
    let poses = |i: usize| {
        let mut rng = Rng::keyed(config.seed, &[i as u64]);
        let triple = three_of(observations.len(), &mut rng);
        p3p(
            &triple.map(|k| problem.bearings[k]),
            &triple.map(|k| observations[k].p_world),
        )
    };
    let mut several = 0;
    for i in 0..40 {
        let (found, poses) = (problem.sample(i).map(|h| h.pose), poses(i));
        several += usize::from(poses.len() > 1);
        assert_eq!(found, poses.first().copied(), "triple {i}");
    }
    assert!(several >= 10, "{several} triples with several poses");
    let first = (0..config.max_samples).find_map(|i| poses(i).first().copied());
    for par in [Par::Seq, Par::new(3)] {
        let (found, drawn) = problem.consensus(par).expect("a pose");
        assert_eq!(Some(found), first, "{par:?}");
        assert_eq!(drawn, config.max_samples, "{par:?}: nobody agrees");
    }
}
