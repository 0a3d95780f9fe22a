//! The examples by hand of the book that are no test elsewhere.

use garad_core::pyramid::halve;
use garad_core::{
    Camera, GaussianMap, GrayImage, KeyframeId, Label, NewGaussian, Par, Real, Se3, So3,
};
use garad_crf::unary::log_odds;
use garad_crf::{Crf, CrfConfig, Cues, Node};
use garad_features::fast9::{CIRCLE, corners};
use garad_optim::RobustKernel;
use garad_raster::losses::opacity_penalty;
use garad_raster::{RenderOptions, render};
use nalgebra::{Vector2, Vector3};

fn near(got: f64, expected: f64, what: &str) {
    // As many digits as the book prints.
    let tolerance = 6e-4 * expected.abs().max(1.0);
    assert!(
        (got - expected).abs() < tolerance,
        "{what}: {got}, the book says {expected}"
    );
}

/// The examples by hand of the first half of the book that are no test elsewhere.
#[test]
fn examples_by_hand_of_images_and_poses() {
    let camera = Camera::pinhole((640, 480), [525.0, 525.0, 319.5, 239.5]).expect("a camera");
    let p = Vector3::new(0.2, -0.1, 2.0);
    for (level, expected) in [(0, [372.0, 213.25]), (1, [186.0, 106.625])] {
        let uv = camera.level(level).project(&p).expect("in front");
        near(uv.x, expected[0], "u");
        near(uv.y, expected[1], "v");
    }
    let turned = So3::exp(&Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2)) * Vector3::x();
    assert!(
        (turned - Vector3::y()).norm() < 1e-15,
        "x goes to y: {turned}"
    );

    let mut image = GrayImage::new(16, 16, 0);
    image[(4, 4)] = 255;
    let half = halve(&image);
    assert_eq!((half[(2, 2)], half[(1, 2)]), (36, 6), "one white pixel");

    let mut corner = GrayImage::new(7, 7, 100);
    let pixel = |k: usize| {
        let (x, y) = CIRCLE[k];
        ((x + 3).unsigned_abs(), (y + 3).unsigned_abs())
    };
    for k in 0..9 {
        corner[pixel(k)] = 130;
    }
    let scores = |image: &GrayImage, t| corners(image, t, true).iter().map(|c| c.score).collect();
    let found: Vec<u8> = scores(&corner, 20);
    assert_eq!(found, [29], "nine brighter by 30");
    corner[pixel(4)] = 115;
    let (none, weak): (Vec<u8>, Vec<u8>) = (scores(&corner, 20), scores(&corner, 7));
    assert_eq!((none, weak), (vec![], vec![14]), "one of them by 15");

    let huber = RobustKernel::Huber {
        delta: 5.991f64.sqrt(),
    };
    near(huber.rho(6.25), 6.247, "Huber's cost");
    near(huber.weight(6.25), 0.979, "Huber's weight");
    let by_point = camera.project_jacobian(&p);
    let row = Vector3::new(by_point.m11, by_point.m12, by_point.m13);
    let turn = p.cross(&row);
    for (k, expected) in [262.5, 0.0, -26.25, 2.625, 530.25, 26.25]
        .into_iter()
        .enumerate()
    {
        near(
            if k < 3 { row[k] } else { turn[k - 3] },
            expected,
            "row of u",
        );
    }
}

/// The same for the paper's loop: three Gaussians of one person, the depth of the second unknown.
#[test]
fn examples_by_hand_of_the_papers_loop() {
    let cues = |depth_residual| Cues {
        reproj_px: Some(0.0),
        depth_residual,
        observations: Some(1),
        epipolar_px: None,
    };
    let mut config = CrfConfig::default();
    config.unary.min_observations = 1;
    near(log_odds(&cues(Some(5.0)), &config.unary), 0.263, "weight 1");
    config.unary.depth.weight = 8.0;
    near(log_odds(&cues(Some(5.0)), &config.unary), 1.437, "weight 8");
    near(log_odds(&cues(None), &config.unary), -1.259, "no depth");
    let nodes: Vec<Node> = [Some(5.0), None, Some(5.0)]
        .into_iter()
        .enumerate()
        .map(|(i, residual)| Node {
            p_world: Vector3::new(0.1 * i as f64, 0.0, 2.0),
            uv_px: Some(Vector2::new(15.0 * i as f64, 0.0)),
            cues: cues(residual),
            previous: None,
        })
        .collect();
    for (iterations, expected) in [
        (1, [0.903, 0.363]),
        (2, [0.958, 0.584]),
        (5, [0.994, 0.912]),
    ] {
        config.mean_field.iterations = iterations;
        let crf = Crf::new(config.clone()).expect("valid");
        let beliefs = crf.infer(&nodes, Par::Seq).expect("finite");
        near(beliefs.dynamic[0], expected[0], "first");
        near(beliefs.dynamic[1], expected[1], "second");
        near(beliefs.dynamic[2], expected[0], "third");
    }
}

/// The same for splats, losses and sums.
#[test]
fn examples_by_hand_of_splats_and_losses() {
    let mut map = GaussianMap::<f64>::new(0);
    map.push(&NewGaussian {
        mean: [0.05, -0.03, 1.5],
        sigma_m: 0.1,
        opacity: 0.77,
        color: [0.5 + 0.282_094_79 * 0.7, 0.4, 0.5],
        landmark: None,
        born: KeyframeId(0),
    });
    map.quaternions[0] = [0.9, 0.2, -0.3, 0.25];
    map.log_scales[0] = [0.22, 0.09, 0.05].map(Real::ln);
    let options = RenderOptions::default();
    let draw = |map: &GaussianMap<f64>, size, k: [f64; 4]| {
        let camera = Camera::pinhole(size, k).expect("a camera");
        let drawn = render(map, &camera, &Se3::identity(), &options, Par::Seq);
        drawn.expect("an image").projected[0]
    };
    let splat = draw(&map, (24, 18), [25.0, 27.0, 11.5, 8.5]);
    near(splat.mean_px[0], 12.333, "u");
    near(splat.mean_px[1], 7.96, "v");
    near(splat.color[0], 0.697, "red");
    near(splat.opacity, 0.77, "opacity");
    let f = splat.footprint;
    assert_eq!(
        (splat.radius_px, f.x0, f.x1, f.y0, f.y1),
        (9, 0, 24, 0, 16),
        "footprint"
    );

    map.means[0] = [0.0, 0.0, 2.0];
    map.log_scales[0] = [0.1f64; 3].map(Real::ln);
    let round = draw(&map, (64, 48), [100.0, 100.0, 31.5, 23.5]);
    near(1.0 / round.inv_var_y, 25.3, "variance of a round splat");
    assert_eq!(round.radius_px, 16, "its radius");

    let penalty = opacity_penalty(&[3.0f64], &[Label::Dynamic], None).expect("one label each");
    near(
        penalty.opacity_logits[0],
        0.086,
        "gradient of an opaque one",
    );
    let [large, one] = [1e8f32, 1.0];
    let sums = [(large + one) - large, (large - large) + one];
    assert!(
        sums[0] < 0.5 && sums[1] > 0.5,
        "the order matters: {sums:?}"
    );
}
