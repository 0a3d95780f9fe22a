//! The committed cases of this crate's stages: truth from OpenCV, numpy and mpmath.

use garad_core::chi_square::chi2_2dof_quantile;
use garad_core::{Camera, GrayImage, KeyframeId, Par, Se3, So3};
use garad_features::epipolar::{
    RansacConfig, eight_point, fundamental, fundamental_ransac, point_to_line_px, sampson_px2,
};
use garad_features::fast9::{self, Window};
use garad_features::flow::FlowFit;
use garad_features::lk::{self, reference::scharr};
use garad_features::matching::nearest;
use garad_features::orb::{blur, orientation};
use garad_features::{
    Descriptor, FlowConfig, FlowEstimator, FlowForm, FlowPoint, LkConfig, LkPyramid, MatchConfig,
    OrbConfig, OrbExtractor, PlaceConfig, PlaceIndex, verify_flow,
};
use garad_golden::{Case, Tensor};
use nalgebra::{Matrix3, Vector2, Vector3};

fn gray(tensor: &Tensor) -> GrayImage {
    let &[height, width] = tensor.shape() else {
        panic!("an image has two axes, not {:?}", tensor.shape());
    };
    GrayImage::from_vec(width, height, tensor.u8()).expect("as many pixels as the shape says")
}

fn check(case: &Case, name: &str, got: impl IntoIterator<Item = impl Into<f64>>) {
    let got: Vec<f64> = got.into_iter().map(Into::into).collect();
    case.check(name, &got)
        .unwrap_or_else(|report| panic!("{report}"));
}

fn has(case: &Case, name: &str) -> bool {
    case.output_names().any(|output| output == name)
}

fn count(n: usize) -> u32 {
    u32::try_from(n).expect("counts of test cases are small")
}

#[test]
fn fast() {
    for case in Case::load_all("fast") {
        let image = gray(case.input("image"));
        let threshold = u8::try_from(case.param_usize("threshold")).expect("a byte");
        let corners = fast9::corners(&image, threshold, true);
        check(
            &case,
            "xy",
            corners.iter().flat_map(|c| [count(c.x), count(c.y)]),
        );
        check(&case, "score", corners.iter().map(|c| c.score));
        let all = fast9::corners(&image, threshold, false);
        check(&case, "count_without_nms", [count(all.len())]);
        // The plain loops give the same scores.
        let (mut slow, mut quick) = (GrayImage::default(), GrayImage::default());
        fast9::reference::score_window(&image, threshold, Window::inside(&image), &mut slow);
        fast9::fast::score_window(&image, threshold, Window::inside(&image), &mut quick);
        assert_eq!(slow, quick, "{}: reference and fast", case.name());
    }
}

/// What this crate adds to the pyramid: the blur before description, the derivatives of flow.
#[test]
fn pyramid_filters() {
    for case in Case::load_all("pyramid") {
        let image = gray(case.input("image"));
        check(&case, "gauss7", blur::blur(&image).data().iter().copied());
        let (dx, dy) = scharr(&image);
        check(&case, "scharr_x", dx.data().iter().copied());
        check(&case, "scharr_y", dy.data().iter().copied());
    }
}

#[test]
fn orb() {
    let mut kinds = [0; 2];
    for case in Case::load_all("orb") {
        if has(&case, "atan2") {
            kinds[0] += 1;
            let (y, x) = (case.input("y").f32(), case.input("x").f32());
            let angles = y
                .iter()
                .zip(&x)
                .map(|(&y, &x)| orientation::fast_atan2_deg(y, x));
            check(&case, "atan2", angles);
            continue;
        }
        kinds[1] += 1;
        let config = OrbConfig {
            features: case.param_usize("features"),
            ..OrbConfig::default()
        };
        let mut extractor = OrbExtractor::new(config).expect("valid settings");
        let image = gray(case.input("image"));
        let found = extractor
            .extract(&image, Par::Threads(2))
            .expect("an image");
        let keypoints = &found.keypoints;
        check(&case, "level", keypoints.iter().map(|k| k.level));
        check(&case, "pt", keypoints.iter().flat_map(|k| [k.x, k.y]));
        check(&case, "response", keypoints.iter().map(|k| k.response));
        check(&case, "angle", keypoints.iter().map(|k| k.angle_deg));
        check(
            &case,
            "descriptor",
            found.descriptors.iter().flat_map(Descriptor::to_bytes),
        );
    }
    assert!(
        kinds.iter().all(|&n| n > 0),
        "both kinds of case are there: {kinds:?}"
    );
}

fn descriptors(tensor: &Tensor) -> Vec<Descriptor> {
    let bytes = tensor.u8();
    bytes
        .as_chunks::<32>()
        .0
        .iter()
        .map(Descriptor::from_bytes)
        .collect()
}

#[test]
fn matching() {
    for case in Case::load_all("matching") {
        let (query, train) = (
            descriptors(case.input("query")),
            descriptors(case.input("train")),
        );
        let found: Vec<_> = nearest(&query, &train, Par::Threads(2))
            .into_iter()
            .map(|n| n.expect("train is not empty"))
            .collect();
        check(&case, "nearest", found.iter().map(|n| count(n.train)));
        check(&case, "distance", found.iter().map(|n| n.distance));
        check(&case, "second", found.iter().map(|n| n.second));
        let mutual = MatchConfig {
            max_distance: 256,
            ratio: None,
            mutual: true,
        };
        let matches =
            garad_features::matching::match_descriptors(&query, &train, &mutual, Par::Seq);
        check(
            &case,
            "mutual",
            matches
                .iter()
                .flat_map(|m| [count(m.query), count(m.train)]),
        );
    }
}

fn pairs(tensor: &Tensor) -> Vec<[f32; 2]> {
    tensor.f32().as_chunks::<2>().0.to_vec()
}

#[test]
fn lucas_kanade() {
    for case in Case::load_all("lk") {
        let levels = case.param_usize("levels");
        let prev = LkPyramid::new(&gray(case.input("prev")), levels).expect("an image");
        let next = LkPyramid::new(&gray(case.input("next")), levels).expect("an image");
        let points = pairs(case.input("points"));
        let config = LkConfig::default();
        let run = |track: Track| {
            track(&prev, &next, &points, None, &config, Par::Threads(2)).expect("sizes agree")
        };
        let found = run(lk::track);
        check(
            &case,
            "status",
            found.iter().map(|t| u8::from(t.is_tracked())),
        );
        // Positions are compared on the corners, which come first; the rest is flat or outside.
        let corners = &found[..case.output("xy").shape()[0]];
        for name in ["xy", "xy_opencv"] {
            check(&case, name, corners.iter().flat_map(|t| t.xy));
        }
        for name in ["residual", "residual_opencv"] {
            check(&case, name, corners.iter().map(|t| t.residual));
        }
        if has(&case, "flow_truth") {
            let moved = corners.iter().zip(&points);
            let flow = moved.flat_map(|(t, p)| [t.xy[0] - p[0], t.xy[1] - p[1]]);
            check(&case, "flow_truth", flow);
        }
        assert_eq!(
            run(lk::track_reference),
            found,
            "{}: reference and fast",
            case.name()
        );
    }
}

type Track = fn(
    &LkPyramid,
    &LkPyramid,
    &[[f32; 2]],
    Option<&[[f32; 2]]>,
    &LkConfig,
    Par,
) -> Result<Vec<garad_features::LkTrack>, garad_features::FeatureError>;

fn pixels(tensor: &Tensor) -> Vec<Vector2<f64>> {
    let values = tensor.f64();
    let pairs = values.as_chunks::<2>().0.iter();
    pairs.map(|&[x, y]| Vector2::new(x, y)).collect()
}

#[test]
fn epipolar() {
    for case in Case::load_all("epipolar") {
        let (uv1, uv2) = (pixels(case.input("uv1")), pixels(case.input("uv2")));
        let intrinsics = case.input("intrinsics").f64();
        let camera = Camera::pinhole((640, 480), intrinsics.try_into().expect("four numbers"))
            .expect("valid");
        let rotation = Matrix3::from_row_slice(&case.input("rotation").f64());
        let translation = Vector3::from_row_slice(&case.input("translation").f64());
        let motion = Se3::new(So3::from_matrix(&rotation), translation);
        // F has no scale: bring it to the scale and sign of the expected one.
        let f = fundamental(&camera, &camera, &motion);
        let expected = Matrix3::from_row_slice(&case.output("fundamental").f64());
        let scaled = f * (expected.norm() / f.norm() * expected.dot(&f).signum());
        check(&case, "fundamental", scaled.transpose().iter().copied());

        let distances: Vec<_> = uv1
            .iter()
            .zip(&uv2)
            .map(|(a, b)| point_to_line_px(&f, a, b))
            .collect();
        check(&case, "distance_in_1", distances.iter().map(|d| d[0]));
        check(&case, "distance_in_2", distances.iter().map(|d| d[1]));
        check(
            &case,
            "sampson",
            uv1.iter().zip(&uv2).map(|(a, b)| sampson_px2(&f, a, b)),
        );

        let exact = pixels(case.input("exact_uv2"));
        let linear = eight_point(&uv1, &exact).expect("general position");
        let worst = uv1
            .iter()
            .zip(&exact)
            .map(|(a, b)| sampson_px2(&linear, a, b).sqrt());
        let worst = worst.fold(0.0, f64::max);
        assert!(
            worst <= 1e-6,
            "{}: exact pairs within {worst} px",
            case.name()
        );

        let is_wrong = case.input("is_wrong").i64();
        let config = RansacConfig::default();
        let found = fundamental_ransac(&uv1, &uv2, &config, Par::Threads(2)).expect("solvable");
        let (mut kept, mut right, mut kept_right) = (0.0, 0.0, 0.0);
        for (&inlier, &wrong) in found.inliers.iter().zip(&is_wrong) {
            kept += f64::from(inlier);
            right += f64::from(wrong == 0);
            kept_right += f64::from(inlier && wrong == 0);
        }
        let (recall, precision) = (kept_right / right, kept_right / kept);
        let verdict = format!("{}: recall {recall}, precision {precision}", case.name());
        assert!(recall >= 0.97 && precision >= 0.97, "{verdict}");
    }
}

/// Flow vectors of a case, with predictions where it has them.
fn flow_points(case: &Case, who: &str) -> Vec<FlowPoint> {
    let flow = pixels(case.input(&format!("{who}_flow")));
    let predicted = match case.try_input(&format!("{who}_predicted")) {
        Some(tensor) => pixels(tensor).into_iter().map(Some).collect(),
        None => vec![None; flow.len()],
    };
    let both = flow.into_iter().zip(predicted);
    both.map(|(flow, predicted)| FlowPoint { flow, predicted })
        .collect()
}

#[test]
fn flow() {
    for case in Case::load_all("flow") {
        let estimator = match case.param_str("estimator") {
            "moments" => FlowEstimator::Moments,
            "median_mad" => FlowEstimator::MedianMad,
            "trimmed" => FlowEstimator::Trimmed,
            other => panic!("{}: no estimator {other}", case.name()),
        };
        let model = match case.param_str("form") {
            "raw" => FlowForm::Raw,
            "residual" => FlowForm::Residual,
            other => panic!("{}: no form {other}", case.name()),
        };
        let config = FlowConfig {
            enabled: true,
            model,
            estimator,
            covariance_floor_px2: case.param_f64("covariance_floor_px2"),
            min_support: 3,
            chi2: case.param_f64("chi2"),
        };
        let [fixed, suspects] = ["static", "suspect"].map(|who| flow_points(&case, who));
        let found = verify_flow(&fixed, &suspects, &config).expect("finite flow");
        let FlowFit::Model(model) = found.fit else {
            panic!("{}: {:?}", case.name(), found.fit);
        };
        check(&case, "mean", model.mean.iter().copied());
        check(&case, "covariance", model.covariance.iter().copied());
        check(&case, "support", [count(model.support)]);
        let verdicts = found.verdicts.iter().map(|v| v.expect("a model"));
        check(&case, "distance2", verdicts.clone().map(|v| v.distance2));
        check(&case, "inside", verdicts.map(|v| u8::from(v.inside)));
        let levels = case.input("levels").f64();
        check(
            &case,
            "quantiles",
            levels.iter().map(|&p| chi2_2dof_quantile(p)),
        );
    }
}

#[test]
fn place() {
    for case in Case::load_all("place") {
        let all = descriptors(case.input("descriptors"));
        let mut rest = all.as_slice();
        let lengths = case.input("length").i64();
        let mut pictures = lengths.iter().map(|&n| {
            let n = usize::try_from(n).expect("a length");
            let (picture, after) = rest.split_at(n);
            rest = after;
            picture
        });
        let config = PlaceConfig {
            tables: case.param_usize("tables"),
            bits: case.param_usize("bits"),
        };
        let seed = case.param_usize("seed") as u64;
        let mut index = PlaceIndex::new(config, seed).expect("valid settings");
        let &[_, keyframes] = case.output("score").shape() else {
            panic!("{}: scores have two axes", case.name());
        };
        let ids: Vec<_> = (0..count(keyframes)).map(KeyframeId).collect();
        for (&id, picture) in ids.iter().zip(pictures.by_ref().take(keyframes)) {
            index.add(id, picture);
        }
        let (mut scores, mut order) = (Vec::new(), Vec::new());
        for picture in pictures {
            scores.extend(
                ids.iter()
                    .map(|&id| index.score(id, picture).unwrap_or(-1.0)),
            );
            let found = index.query(picture, keyframes, |_| false);
            order.extend(found.iter().map(|candidate| candidate.id.0));
        }
        check(&case, "score", scores);
        check(&case, "order", order);
    }
}
