//! Laws of the field: what holds for any nodes, and where the fast sums must agree with the readable
//! ones.

use garad_core::{Label, Par, Rng};
use garad_crf::{
    Beliefs, Crf, CrfConfig, Cues, Distance, Height, Method, Node, Normalisation, PositionTerms,
    Side, SmallCrf,
};
use nalgebra::{Vector2, Vector3};
use proptest::prelude::*;

/// A room of 4 x 3 x 4 m seen by 640 x 480 pixels, a fifth of it a person who moves; some nodes lack
/// cues or a pixel.
fn room(n: usize, seed: u64) -> Vec<Node> {
    let mut rng = Rng::new(seed);
    (0..n)
        .map(|_| {
            let moves = rng.uniform() < 0.2;
            let z = if moves {
                rng.range(1.8, 2.2)
            } else {
                rng.range(1.0, 5.0)
            };
            let u = if moves {
                rng.range(250.0, 400.0)
            } else {
                rng.range(0.0, 640.0)
            };
            let v = rng.range(0.0, 480.0);
            let error = if moves { 4.0 } else { 0.8 } + 0.7 * rng.normal();
            let count = if moves {
                2 + rng.below(2)
            } else {
                2 + rng.below(20)
            };
            let some = |rng: &mut Rng, share: f64| rng.uniform() < share;
            let tagged = some(&mut rng, 0.8);
            Node {
                p_world: Vector3::new((u - 320.0) * z / 535.0, (v - 240.0) * z / 535.0, z),
                uv_px: some(&mut rng, 0.9).then(|| Vector2::new(u, v)),
                cues: Cues {
                    reproj_px: tagged.then(|| error.abs()),
                    depth_residual: some(&mut rng, 0.7)
                        .then(|| rng.normal().abs() + if moves { 4.0 } else { 0.0 }),
                    observations: tagged.then(|| u32::try_from(count).expect("small")),
                    epipolar_px: None,
                },
                previous: None,
            }
        })
        .collect()
}

fn infer(config: &CrfConfig, nodes: &[Node], par: Par) -> Beliefs {
    let crf = Crf::new(config.clone()).expect("a valid configuration");
    crf.infer(nodes, par).expect("valid nodes")
}

/// LC-CRF's numbers with one-sided likelihoods, their mean, ten iterations.
fn one_sided() -> CrfConfig {
    let mut config = with_method(&CrfConfig::as_printed(), Method::Fast { tail: 1e-12 });
    config.unary.height = Height::Unit;
    config.unary.min_observations = 2;
    config.unary.reprojection.side = Side::Above;
    config.unary.depth.side = Side::Above;
    config.unary.observations.side = Side::Below;
    config.unary.epipolar.side = Side::Above;
    config.kernels.distance = Distance::Squared;
    config.mean_field.normalisation = Normalisation::Rows;
    config.mean_field.self_message = true;
    config
}

fn with_method(config: &CrfConfig, method: Method) -> CrfConfig {
    let mut config = config.clone();
    config.mean_field.method = method;
    config
}

/// Every reading that changes sums.
fn readings() -> Vec<CrfConfig> {
    let mut readings = Vec::new();
    for normalisation in [
        Normalisation::None,
        Normalisation::Rows,
        Normalisation::Symmetric,
    ] {
        for self_message in [true, false] {
            for distance in [Distance::Squared, Distance::Linear] {
                for terms in [
                    PositionTerms::Both,
                    PositionTerms::Space,
                    PositionTerms::Pixel,
                ] {
                    let mut config = CrfConfig::default();
                    config.mean_field.normalisation = normalisation;
                    config.mean_field.self_message = self_message;
                    config.kernels.distance = distance;
                    config.kernels.terms = terms;
                    if normalisation == Normalisation::None {
                        config.kernels.feature_weight = 0.02;
                        config.kernels.position_weight = 0.3;
                    }
                    readings.push(config);
                }
            }
        }
    }
    readings
}

fn furthest(a: &Beliefs, b: &Beliefs) -> f64 {
    let pairs = a.dynamic.iter().zip(&b.dynamic);
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn fast_stays_within_its_bound_under_every_reading() {
    let nodes = room(300, 1);
    for config in readings() {
        let exact = infer(
            &with_method(&config, Method::Reference),
            &nodes,
            Par::Threads(2),
        );
        for tail in [0.0, 1e-12, 1e-6, 1e-2] {
            let fast = infer(
                &with_method(&config, Method::Fast { tail }),
                &nodes,
                Par::Seq,
            );
            let error = furthest(&fast, &exact);
            let bound = fast.error_bound + exact.error_bound;
            assert!(
                error <= bound,
                "{error:e} > {bound:e} at {tail:e}: {config:?}"
            );
        }
        let all = infer(
            &with_method(&config, Method::Fast { tail: 0.0 }),
            &nodes,
            Par::Seq,
        );
        assert!(furthest(&all, &exact) < 1e-10, "every pair: {config:?}");
    }
}

#[test]
fn the_bound_is_worth_having() {
    let nodes = room(600, 2);
    let config = CrfConfig::default();
    let bound = |tail| {
        infer(
            &with_method(&config, Method::Fast { tail }),
            &nodes,
            Par::Seq,
        )
        .error_bound
    };
    let (tight, loose) = (bound(1e-12), bound(1e-3));
    assert!(tight < 1e-8, "{tight:e}");
    assert!(loose > 1e3 * tight, "{loose:e} grows with the tail");
}

#[test]
fn same_bits_for_any_number_of_threads() {
    let nodes = room(700, 3);
    for method in [Method::Reference, Method::Fast { tail: 1e-9 }] {
        let mut config = with_method(&CrfConfig::default(), method);
        config.mean_field.iterations = 3;
        let bits = |par| -> Vec<u64> {
            infer(&config, &nodes, par)
                .dynamic
                .iter()
                .map(|q| q.to_bits())
                .collect()
        };
        let one = bits(Par::Seq);
        for threads in [2, 3] {
            assert_eq!(
                bits(Par::Threads(threads)),
                one,
                "{method:?} on {threads} threads"
            );
        }
    }
}

#[test]
fn a_person_is_found_and_the_room_is_kept() {
    let mut config = one_sided();
    let nodes = room(1500, 4);
    let beliefs = infer(&config, &nodes, Par::Seq);
    assert!(
        beliefs.last_change < 0.05,
        "settled: {}",
        beliefs.last_change
    );
    // The person's nodes without any cue get their label from their neighbours.
    let blank = |node: &Node| node.cues == Cues::default() && node.uv_px.is_some();
    let on_person = |node: &Node| {
        (node.p_world.z - 2.0).abs() < 0.15
            && node.uv_px.is_some_and(|uv| (270.0..380.0).contains(&uv.x))
    };
    let share = |of: &dyn Fn(&Node) -> bool, beliefs: &Beliefs| {
        let labels: Vec<Label> = nodes
            .iter()
            .zip(&beliefs.labels)
            .filter(|(node, _)| of(node))
            .map(|(_, label)| *label)
            .collect();
        let dynamic = labels.iter().filter(|l| **l == Label::Dynamic).count();
        assert!(labels.len() > 5, "a sample of {}", labels.len());
        dynamic as f64 / labels.len() as f64
    };
    let person = share(&|n| blank(n) && on_person(n), &beliefs);
    let wall = share(&|n| n.p_world.z > 3.0, &beliefs);
    assert!(person > 0.6, "{person} of the person's blank nodes");
    assert!(wall < 0.1, "{wall} of the room");
    // Without kernels nodes without cues stay undecided.
    config.kernels.feature_weight = 0.0;
    config.kernels.position_weight = 0.0;
    assert!(
        share(&|n| blank(n), &infer(&config, &nodes, Par::Seq)) == 0.0,
        "no neighbours"
    );
}

/// Errors and counts so far apart that no two nodes share a cell: no grid, the same answer.
#[test]
fn scattered_features() {
    let mut nodes = room(400, 7);
    for (i, node) in nodes.iter_mut().enumerate() {
        let far = u32::try_from(i).expect("small");
        node.cues.reproj_px = Some(3.0 * f64::from(far % 397));
        node.cues.observations = Some(2 + far);
    }
    for self_message in [true, false] {
        let mut config = with_method(&CrfConfig::default(), Method::Reference);
        config.mean_field.self_message = self_message;
        let exact = infer(&config, &nodes, Par::Seq);
        let fast = infer(
            &with_method(&config, Method::Fast { tail: 0.0 }),
            &nodes,
            Par::Threads(2),
        );
        assert!(
            furthest(&fast, &exact) < 1e-12,
            "{}",
            furthest(&fast, &exact)
        );
        // A few of them fit into a grid.
        let few = &nodes[..60];
        let (exact, fast) = (
            infer(&config, few, Par::Seq),
            infer(
                &with_method(&config, Method::Fast { tail: 0.0 }),
                few,
                Par::Seq,
            ),
        );
        let bound = fast.error_bound + exact.error_bound;
        assert!(
            furthest(&fast, &exact) <= bound,
            "{} > {bound}",
            furthest(&fast, &exact)
        );
    }
}

/// As documented at `KernelConfig::feature_weight`.
#[test]
fn small_weights_settle_and_large_ones_do_not() {
    let nodes = room(600, 5);
    let settled = infer(&one_sided(), &nodes, Par::Seq).last_change;
    let moving = infer(&CrfConfig::lc_crf(), &nodes, Par::Seq).last_change;
    assert!(settled < 0.06 && moving > 0.3, "{settled}, {moving}");
}

fn small(nodes: &[Node], log_odds: &[f64], config: &CrfConfig) -> SmallCrf {
    SmallCrf::from_nodes(nodes, log_odds, &config.kernels).expect("one log-odds per node")
}

/// Eq. 4 as printed, with squared distances and the fast sums.
fn literal(weight: f64) -> CrfConfig {
    let mut config = with_method(&CrfConfig::as_printed(), Method::Fast { tail: 1e-12 });
    config.kernels.distance = Distance::Squared;
    config.mean_field.iterations = 60;
    config.kernels.feature_weight = 0.3 * weight;
    config.kernels.position_weight = weight;
    config
}

fn node_strategy() -> impl Strategy<Value = Node> {
    (
        prop::array::uniform3(-1.0..1.0f64),
        prop::option::weighted(0.8, (0.0..100.0f64, 0.0..100.0f64)),
        prop::option::weighted(0.8, (0.0..4.0f64, 0u32..12)),
    )
        .prop_map(|(p, uv, features)| Node {
            p_world: Vector3::from(p),
            uv_px: uv.map(|(u, v)| Vector2::new(u, v)),
            cues: Cues {
                reproj_px: features.map(|f| f.0),
                observations: features.map(|f| f.1),
                ..Cues::default()
            },
            previous: None,
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// KL(q ‖ p) ≥ 0, for any q.
    #[test]
    fn free_energy_is_never_below_its_bound(
        nodes in prop::collection::vec(node_strategy(), 1..9),
        u in prop::array::uniform9(-3.0..3.0f64),
        q in prop::array::uniform9(0.0..=1.0f64),
    ) {
        let crf = small(&nodes, &u[..nodes.len()], &literal(1.0));
        let all = crf.enumerate().expect("few nodes");
        let free = crf.free_energy(&q[..nodes.len()]);
        prop_assert!(free >= -all.log_z - 1e-12, "{free} < {}", -all.log_z);
    }

    /// Each step is the minimum of F along one coordinate.
    #[test]
    fn sequential_sweeps_never_raise_the_free_energy(
        nodes in prop::collection::vec(node_strategy(), 1..13),
        u in prop::array::uniform12(-3.0..3.0f64),
    ) {
        let crf = small(&nodes, &u[..nodes.len()], &literal(2.0));
        let mut q = vec![0.5; nodes.len()];
        let mut before = crf.free_energy(&q);
        for _ in 0..10 {
            crf.sweep(&mut q);
            let after = crf.free_energy(&q);
            prop_assert!(after <= before + 1e-12, "{after} > {before}");
            before = after;
        }
    }

    /// With couplings below the level at which parallel updates contract (Σⱼ Jᵢⱼ < 2), they end where
    /// sequential ones do; and where the best labelling stands out, they name it.
    #[test]
    fn parallel_updates_find_the_best_labelling(
        nodes in prop::collection::vec(node_strategy(), 1..13),
        signs in prop::array::uniform12(any::<bool>()),
        sizes in prop::array::uniform12(1.5..4.0f64),
    ) {
        let n = nodes.len();
        let u: Vec<f64> = (0..n).map(|i| if signs[i] { sizes[i] } else { -sizes[i] }).collect();
        let config = literal(0.12);
        let crf = small(&nodes, &u, &config);
        let beliefs = Crf::new(config).expect("valid").infer_from_log_odds(&nodes, &u, Par::Seq).expect("valid");
        let mut q = vec![0.5; n];
        for _ in 0..60 {
            crf.sweep(&mut q);
        }
        for (a, b) in beliefs.dynamic.iter().zip(&q) {
            prop_assert!((a - b).abs() < 1e-9, "parallel {a}, sequential {b}");
        }
        let all = crf.enumerate().expect("few nodes");
        if all.second_energy - all.map_energy > 1.0 {
            prop_assert_eq!(&beliefs.labels, &all.map);
        }
        let gap = crf.free_energy(&beliefs.dynamic) + all.log_z;
        prop_assert!((-1e-12..0.5).contains(&gap), "F + ln Z = {gap}");
    }

    /// Beliefs do not depend on the order of the nodes.
    #[test]
    fn permuted_nodes_have_permuted_beliefs(seed in 0u64..1000, tail in prop::sample::select(vec![0.0, 1e-12])) {
        let nodes = room(90, seed);
        let mut order: Vec<usize> = (0..nodes.len()).collect();
        let mut rng = Rng::new(seed);
        for i in (1..order.len()).rev() {
            order.swap(i, rng.below(i + 1));
        }
        let config = with_method(&CrfConfig::default(), Method::Fast { tail });
        let shuffled: Vec<Node> = order.iter().map(|&i| nodes[i]).collect();
        let (plain, shuffled) = (infer(&config, &nodes, Par::Seq), infer(&config, &shuffled, Par::Seq));
        for (k, &i) in order.iter().enumerate() {
            prop_assert!((plain.dynamic[i] - shuffled.dynamic[k]).abs() < 1e-9, "node {i}");
        }
    }

    /// Large, tiny and equal numbers: an answer in [0, 1] that is close to the reference, or an error.
    #[test]
    fn poison(
        values in prop::collection::vec(
            prop::array::uniform6(prop::sample::select(vec![
                0.0, -0.0, 1.0, 1e-308, 1e-38, -1e-38, 0.5, 1e15, 1e38, -1e38, 1e300, f64::NAN,
                f64::INFINITY, f64::NEG_INFINITY,
            ])),
            0..40,
        ),
        reading in 0usize..36,
    ) {
        let nodes: Vec<Node> = values
            .iter()
            .map(|v| Node {
                p_world: Vector3::new(v[0], v[1], v[2]),
                uv_px: Some(Vector2::new(v[3], v[4])),
                cues: Cues { reproj_px: Some(v[5]), observations: Some(u32::MAX), ..Cues::default() },
                previous: None,
            })
            .filter(|node| node.validate(0).is_ok() || values.len() < 4)
            .collect();
        let config = &readings()[reading];
        let run = |method| Crf::new(with_method(config, method)).expect("valid").infer(&nodes, Par::Seq);
        match (run(Method::Fast { tail: 1e-12 }), run(Method::Reference)) {
            (Ok(fast), Ok(exact)) => {
                prop_assert!(fast.dynamic.iter().all(|q| (0.0..=1.0).contains(q)), "{fast:?}");
                let (error, bound) = (furthest(&fast, &exact), fast.error_bound + exact.error_bound);
                prop_assert!(error <= bound, "{error} > {bound}");
            }
            (Err(fast), Err(exact)) => prop_assert_eq!(fast.to_string(), exact.to_string()),
            (fast, exact) => prop_assert!(false, "{fast:?} against {exact:?}"),
        }
    }
}

#[test]
fn no_node_and_one_node() {
    let config = CrfConfig::default();
    assert!(infer(&config, &[], Par::Seq).dynamic.is_empty(), "no node");
    let alone = Node {
        cues: Cues {
            reproj_px: Some(0.5),
            observations: Some(9),
            ..Cues::default()
        },
        ..Node::default()
    };
    let beliefs = infer(&config, &[alone], Par::Seq);
    // Its own message alone: 4 (2q - 1) on top of u = -6.9.
    assert!(
        beliefs.dynamic[0] < 1e-3 && beliefs.labels == [Label::Static],
        "{beliefs:?}"
    );
}

#[test]
fn a_node_seen_once_keeps_its_previous_belief() {
    let seen_once = |previous| Node {
        cues: Cues {
            observations: Some(1),
            ..Cues::default()
        },
        previous,
        ..Node::default()
    };
    let nodes = [seen_once(Some(0.8)), seen_once(None)];
    let mut config = CrfConfig::default();
    let keep = infer(&config, &nodes, Par::Seq);
    assert_eq!(
        keep.labels,
        [Label::Dynamic, Label::Static],
        "previous, and undecided"
    );
    assert!(
        (keep.dynamic[0] - 0.8).abs() < 1e-15 && (keep.dynamic[1] - 0.5).abs() < 1e-12,
        "{keep:?}"
    );
    config.unary.thin = garad_crf::ThinEvidence::Neighbours;
    let inferred = infer(&config, &nodes, Par::Seq);
    assert!(
        (inferred.dynamic[0] - 0.5).abs() < 1e-12,
        "its neighbours have no cue"
    );
}

#[test]
fn damping_slows_and_ends_at_the_same_place() {
    let nodes = room(200, 6);
    let mut config = CrfConfig::default();
    config.mean_field.iterations = 400;
    let plain = infer(&config, &nodes, Par::Seq);
    config.mean_field.damping = 0.5;
    let damped = infer(&config, &nodes, Par::Seq);
    assert!(
        plain.last_change < 1e-12 && damped.last_change < 1e-12,
        "both settled"
    );
    assert!(
        furthest(&plain, &damped) < 1e-9,
        "{}",
        furthest(&plain, &damped)
    );
    config.mean_field.iterations = 1;
    let once = infer(&config, &nodes, Par::Seq);
    config.mean_field.damping = 0.0;
    assert!(
        once.last_change < infer(&config, &nodes, Par::Seq).last_change,
        "half a step"
    );
}

#[test]
fn lists_of_different_length() {
    let crf = Crf::new(CrfConfig::default()).expect("valid");
    let error = crf
        .infer_from_log_odds(&[Node::default()], &[], Par::Seq)
        .expect_err("0 of 1");
    assert_eq!(
        error.to_string(),
        "log_odds: 0 entries; expected 1",
        "message"
    );
    let error = crf
        .infer_from_log_odds(&[Node::default()], &[f64::NAN], Par::Seq)
        .expect_err("NaN");
    assert_eq!(
        error.to_string(),
        "node 0: log_odds is NaN; expected a finite number",
        "message"
    );
}

/// One node that hears only itself: ℓ = u + ω (2 q - 1) and q ← (1 - d) σ(ℓ) + d q, with ω and d away from their defaults,
/// for none, one and three iterations; a label is dynamic above the threshold.
#[test]
fn a_single_node_by_hand() {
    let sigmoid = |x: f64| 1.0 / (1.0 + libm::exp(-x));
    let (u, weight, damping) = (-0.4, 0.7, 0.25);
    let mut q = vec![sigmoid(u)];
    for i in 0..3 {
        let logit = u + weight * (2.0 * q[i] - 1.0);
        q.push((1.0 - damping) * sigmoid(logit) + damping * q[i]);
    }
    for iterations in [0, 1, 3] {
        let mut config = CrfConfig::default();
        config.kernels.position_weight = weight;
        config.mean_field.damping = damping;
        config.mean_field.iterations = iterations;
        let expected = q[iterations];
        for (threshold, label) in [
            (expected - 1e-6, Label::Dynamic),
            (expected + 1e-6, Label::Static),
        ] {
            config.threshold = threshold;
            for method in [Method::Reference, Method::Fast { tail: 1e-3 }] {
                let crf = Crf::new(with_method(&config, method)).expect("valid");
                let found = crf.infer_from_log_odds(&[Node::default()], &[u], Par::Seq);
                let found = found.expect("one node");
                let error = (found.dynamic[0] - expected).abs();
                assert!(error < 1e-14, "{iterations} iterations: {found:?}");
                assert_eq!(
                    found.labels,
                    [label],
                    "{iterations} iterations, {threshold}"
                );
                let change = if iterations == 0 {
                    0.0
                } else {
                    (q[iterations] - q[iterations - 1]).abs()
                };
                assert!((found.last_change - change).abs() < 1e-14, "{found:?}");
            }
        }
        config.mean_field.self_message = false;
        let alone = Crf::new(config).expect("valid");
        let alone = alone.infer_from_log_odds(&[Node::default()], &[u], Par::Seq);
        assert!(
            (alone.expect("one node").dynamic[0] - q[0]).abs() < 1e-14,
            "no neighbour"
        );
    }
}

/// Fewer than four observations keep the previous belief, and its label is by the same threshold.
#[test]
fn thin_nodes_by_their_least_number_and_the_threshold() {
    let node = |observations, previous| Node {
        cues: Cues {
            observations: Some(observations),
            ..Cues::default()
        },
        previous: Some(previous),
        ..Node::default()
    };
    let mut config = CrfConfig::default();
    config.unary.min_observations = 4;
    config.threshold = 0.75;
    let nodes = [node(3, 0.75), node(3, 0.76), node(3, 0.6), node(4, 0.9)];
    let found = infer(&config, &nodes, Par::Seq);
    let kept = [0.75, 0.76, 0.6]
        .iter()
        .zip(&found.dynamic)
        .all(|(a, b)| (a - b).abs() < 1e-15);
    assert!(kept && found.dynamic[3] < 0.5, "{found:?}");
    let expected = [Label::Static, Label::Dynamic, Label::Static, Label::Static];
    assert_eq!(found.labels, expected, "above 0.75");
}
