//! Iterations by hand: their gradients are given, so every number follows from the rules.

use Label::{Dynamic, Static};
use garad_core::{Label, NewGaussian, RgbImage, So3};

use super::*;
use crate::config::{Optimiser, RateConfig};

/// A trainer, its map, and what every iteration is given.
struct Run {
    trainer: Trainer,
    map: GaussianMap,
    config: TrainConfig,
    densify: Option<DensifyConfig>,
    extent_m: f64,
    /// Every gradient but that at the centres, 1/px.
    gradient: f32,
    by_mean_px: [f32; 2],
}

impl Run {
    /// Views 0 to `views` - 1, and small, half opaque Gaussians.
    fn new(views: u32, gaussians: u32) -> Self {
        let camera = Camera::pinhole((44, 28), [40.0, 42.0, 21.3, 14.2]).expect("valid");
        let mut run = Self {
            trainer: Trainer::new(&camera, 11).expect("valid"),
            map: GaussianMap::new(0),
            config: TrainConfig::default(),
            densify: None,
            extent_m: 3.0,
            gradient: 1.0,
            by_mean_px: [0.0; 2],
        };
        (0..views).for_each(|k| run.add_view(k));
        for i in 0..gaussians {
            run.map.push(&NewGaussian {
                mean: [i as f32, 0.0, 2.0],
                sigma_m: 0.02,
                opacity: 0.5,
                color: [0.5; 3],
                landmark: None,
                born: KeyframeId(i),
            });
        }
        run
    }

    fn add_view(&mut self, keyframe: u32) {
        let (keyframe, rgb) = (KeyframeId(keyframe), RgbImage::new(44, 28, [0; 3]));
        (self.trainer).add_view(TrainingView::new(keyframe, rgb, None, None, 0));
    }

    fn step(&mut self, pick: Pick) -> Result<Option<TrainStep>, TrainError> {
        let scene = TrainingScene {
            poses: &[],
            extent_m: self.extent_m,
            window_runs: 3,
        };
        let (g, by_mean_px) = (self.gradient, self.by_mean_px);
        let compared = |_: &Trainer, map: &GaussianMap, _| {
            let n = map.len();
            Ok(Compared {
                loss: 0.25,
                gradients: Gradients {
                    means: vec![[g; 3]; n],
                    log_scales: vec![[g; 3]; n],
                    quaternions: vec![[g; 4]; n],
                    opacity_logits: vec![g; n],
                    sh: vec![[g; 3]; map.sh.len()],
                    pose: [0.0; 6],
                    means2d: vec![by_mean_px; n],
                    conics: vec![[0.0; 3]; n],
                    opacities: vec![0.0; n],
                    colors: vec![[0.0; 3]; n],
                    depths: vec![0.0; n],
                },
                radii: vec![1; n],
            })
        };
        let densify = self.densify.as_ref();
        (self.trainer).step_by(&mut self.map, pick, scene, &self.config, densify, compared)
    }

    /// The keyframes and levels of the next iterations.
    fn picks(&mut self, pick: Pick, n: usize) -> Vec<(u32, usize)> {
        let mut next = || self.step(pick).expect("finite").expect("something");
        let steps = (0..n).map(|_| next());
        steps.map(|step| (step.keyframe.0, step.level)).collect()
    }

    fn keyframes(&mut self, n: usize) -> Vec<u32> {
        let picks = self.picks(Pick::Shuffled, n);
        let mut keyframes: Vec<_> = picks.into_iter().map(|(keyframe, _)| keyframe).collect();
        keyframes.sort_unstable();
        keyframes
    }
}

fn at(x_m: f64) -> Se3 {
    let turn = So3::exp(&Vector3::new(0.1, 0.7, 0.0));
    Se3::new(turn, Vector3::new(x_m, 0.0, 0.0)).inverse()
}

#[test]
fn the_first_iteration_of_a_job_and_every_second_is_on_the_newest() {
    use Pick::{Shuffled, Youngest};
    let picks = [0, 1, 2, 3, 4].map(Pick::beside_tracking);
    assert_eq!(picks, [Youngest, Shuffled, Youngest, Shuffled, Youngest]);
    let newest = Run::new(3, 1).picks(Youngest, 2);
    assert_eq!(newest, [(2, 2), (2, 2)], "of three");
}

#[test]
fn each_view_has_its_turn_and_a_new_one_in_the_next_round() {
    let mut run = Run::new(3, 1);
    assert_eq!(run.keyframes(3), [0, 1, 2], "the first round");
    let first = run.keyframes(1)[0];
    run.add_view(3);
    assert_eq!(run.picks(Pick::Youngest, 1)[0].0, 3, "out of turn");
    let rest: Vec<u32> = (0..3).filter(|k| *k != first).collect();
    assert_eq!(run.keyframes(2), rest, "the second round goes on");
    assert_eq!(run.keyframes(4), [0, 1, 2, 3], "the third");
    let mut orders = Run::new(3, 1);
    let orders: Vec<_> = (0..8).map(|_| orders.picks(Pick::Shuffled, 3)).collect();
    let differ = |pair: &[Vec<(u32, usize)>]| pair[0][0].0 != pair[1][0].0;
    assert!(orders.windows(2).any(differ), "drawn anew: {orders:?}");
}

/// Views at 0, 5, 5.1 and 9 m: the second goes, whether it has had its turn or not.
#[test]
fn a_dropped_view_has_no_turn_and_the_others_keep_theirs() {
    let poses = [0.0, 5.0, 5.1, 9.0].map(at);
    for turns in 0..4 {
        let mut run = Run::new(4, 1);
        let had: Vec<u32> = (run.picks(Pick::Shuffled, turns).into_iter())
            .map(|(keyframe, _)| keyframe)
            .collect();
        run.trainer.thin_views(4, &poses);
        assert_eq!(run.trainer.views(), 4, "no more than allowed");
        run.trainer.thin_views(3, &poses);
        let kept: Vec<u32> = run.trainer.view_keyframes().map(|k| k.0).collect();
        assert_eq!(kept, [0, 2, 3], "of the two nearest the older goes");
        if turns > 0 {
            let left: Vec<u32> = (kept.iter().copied())
                .filter(|keyframe| !had.contains(keyframe))
                .collect();
            assert_eq!(run.keyframes(left.len()), left, "after {turns} turns");
        }
        assert_eq!(run.keyframes(3), kept, "the next round");
    }
}

#[test]
fn each_view_runs_through_the_levels_on_its_own() {
    let mut run = Run::new(1, 1);
    run.config.uses_per_level = 2;
    let levels = |run: &mut Run| -> Vec<usize> {
        let picks = run.picks(Pick::Youngest, 5).into_iter();
        picks.map(|(_, level)| level).collect()
    };
    assert_eq!(levels(&mut run), [2, 2, 1, 1, 0], "the first view");
    run.add_view(1);
    assert_eq!(levels(&mut run), [2, 2, 1, 1, 0], "the second");
}

#[test]
fn without_a_view_or_a_gaussian_there_is_no_iteration() {
    assert_eq!(Run::new(0, 1).step(Pick::Youngest).expect("no error"), None);
    assert_eq!(Run::new(0, 1).step(Pick::Shuffled).expect("no error"), None);
    let mut empty = Run::new(1, 0);
    empty.config.uses_per_level = 1;
    assert_eq!(empty.step(Pick::Youngest).expect("no error"), None);
    empty.map = Run::new(0, 1).map;
    assert_eq!(empty.picks(Pick::Youngest, 1), [(0, 2)], "no use before");
}

#[test]
fn the_degree_rises_every_so_many_iterations() {
    for (sh_every, sh_degree, expected) in [
        (2, 2, [0, 0, 1, 1, 2, 2, 2]),
        (3, 1, [0, 0, 0, 1, 1, 1, 1]),
        (0, 2, [2; 7]),
    ] {
        let mut run = Run::new(1, 2);
        (run.config.sh_every, run.config.sh_degree) = (sh_every, sh_degree);
        let degrees = expected.map(|_| {
            run.step(Pick::Youngest).expect("finite");
            run.map.sh_degree()
        });
        assert_eq!(degrees, expected, "every {sh_every}, up to {sh_degree}");
    }
}

/// The first step of Adam is the rate, that of gradient descent the rate times the gradient.
#[test]
fn each_group_has_its_rate() {
    let rates = RateConfig {
        mean: 0.01,
        log_scale: 0.03,
        quaternion: 0.02,
        opacity_logit: 0.08,
        sh: 0.05,
        sh_rest_divisor: 8.0,
    };
    for (optimiser, gradient, factor, sh_rest) in [
        (Optimiser::Adam, 0.25, 1.0, 0.05 / 8.0),
        (Optimiser::Sgd, 0.25, 0.25, 0.25 * 0.05),
    ] {
        let mut run = Run::new(1, 2);
        run.config = TrainConfig {
            optimiser,
            rates: rates.clone(),
            sh_degree: 1,
            sh_every: 0,
            ..TrainConfig::default()
        };
        run.map.raise_sh_degree(1);
        run.gradient = gradient;
        let before = run.map.clone();
        run.step(Pick::Youngest).expect("finite");
        let near = |old: &[f32], new: &[f32], rate: f64, what: &str| {
            for (old, new) in old.iter().zip(new) {
                let step = f64::from(old - new);
                assert!((step - rate).abs() < 1e-6, "{optimiser:?} {what}: {step}");
            }
        };
        let after = &run.map;
        let flat = |rows: &[[f32; 3]]| rows.as_flattened().to_vec();
        near(
            &flat(&before.means),
            &flat(&after.means),
            factor * 0.01 * 3.0,
            "mean",
        );
        let [old, new] = [&before, after].map(|map| flat(&map.log_scales));
        near(&old, &new, factor * 0.03, "log-scale");
        let [old, new] = [&before, after].map(|map| map.quaternions.as_flattened().to_vec());
        near(&old, &new, factor * 0.02, "quaternion");
        near(
            &before.opacity_logits,
            &after.opacity_logits,
            factor * 0.08,
            "opacity",
        );
        for i in 0..2 {
            let [old, new] = [&before, after].map(|map| flat(map.sh_of(i)));
            near(&old[..3], &new[..3], factor * 0.05, "degree 0");
            near(&old[3..], &new[3..], sh_rest, "degree 1");
        }
    }
}

#[test]
fn a_gradient_that_is_not_finite_changes_nothing() {
    let mut run = Run::new(1, 2);
    run.densify = Some(DensifyConfig {
        every: 1,
        ..DensifyConfig::default()
    });
    run.by_mean_px = [1.0; 2];
    let before = run.map.clone();
    for bad in [f32::NAN, f32::INFINITY] {
        run.gradient = bad;
        let error = run.step(Pick::Youngest).expect_err("not finite");
        assert!(matches!(error, TrainError::Optim(_)), "{error}");
    }
    assert_eq!(run.map, before, "neither parameters nor rows");
    let moved = run.trainer.state().groups.means.moments().iter().flatten();
    assert!(moved.copied().all(|m| m.abs() <= 0.0), "nor moments");
}

#[test]
fn density_control_comes_every_so_many_iterations_and_starts_its_sums_anew() {
    let mut run = Run::new(1, 2);
    run.config.uses_per_level = 1;
    // (3, 4) half images of 11 x 7 pixels.
    run.by_mean_px = [3.0 * 2.0 / 11.0, 4.0 * 2.0 / 7.0];
    run.step(Pick::Youngest).expect("finite");
    assert_eq!(run.trainer.state().seen, [0; 0], "without density control");

    run = Run::new(1, 2);
    run.config.uses_per_level = 1;
    run.densify = Some(DensifyConfig {
        every: 3,
        grad_threshold: 2.0,
        ..DensifyConfig::default()
    });
    run.by_mean_px = [3.0 * 2.0 / 11.0, 4.0 * 2.0 / 7.0];
    run.trainer.windows(&run.map)[1].push(Dynamic);
    run.trainer.windows(&run.map)[1].push(Static);
    let (mut counts, mut sums) = (Vec::new(), Vec::new());
    for _ in 0..6 {
        let step = run
            .step(Pick::Youngest)
            .expect("finite")
            .expect("an iteration");
        counts.push(step.gaussians);
        let state = run.trainer.state();
        sums.push((
            state.seen.first().copied(),
            state.gradient.first().map(|sum| (100.0 * sum).round()),
        ));
    }
    assert_eq!(counts, [2, 2, 4, 4, 4, 8], "each is cloned");
    // The same gradient per pixel counts twice at 22 x 14 pixels, and four times at 44 x 28.
    let expected = [
        (Some(1), Some(500.0)),
        (Some(2), Some(1500.0)),
        (None, None),
        (Some(1), Some(2000.0)),
        (Some(2), Some(4000.0)),
        (None, None),
    ];
    assert_eq!(sums, expected);
    let windows: Vec<_> = (run.trainer.state().windows.iter())
        .map(|w| (w.seen(), w.dynamic_runs(3)))
        .collect();
    let [not, twice] = [(0, 0), (2, 1)];
    assert_eq!(
        windows,
        [not, twice, not, twice, not, twice, not, twice],
        "of the parent"
    );
    assert_eq!(run.trainer.state().groups.means.rows(), 8, "a row each");
}

/// Born at keyframes 0 to 5; the newest view is of keyframe 5.
#[test]
fn beside_tracking_only_young_gaussians_are_cloned() {
    for (young_keyframes, cloned) in [
        (0, vec![5]),
        (2, vec![3, 4, 5]),
        (9, vec![0, 1, 2, 3, 4, 5]),
    ] {
        let mut run = Run::new(6, 6);
        run.densify = Some(DensifyConfig {
            every: 1,
            young_keyframes,
            ..DensifyConfig::default()
        });
        run.by_mean_px = [1.0, 0.0];
        run.step(Pick::Shuffled).expect("finite");
        let born: Vec<_> = run.map.born[6..].iter().map(|k| k.0).collect();
        assert_eq!(born, cloned, "{young_keyframes}");
    }
}

/// Of four: faded, too large, to be split, and one that stays.
#[test]
fn density_control_drops_faded_large_and_split_ones() {
    for (prune_large, rows) in [(true, 4), (false, 6)] {
        let mut run = Run::new(1, 4);
        run.gradient = 0.0;
        run.extent_m = 10.0;
        run.map.opacity_logits[0] = -2.0; // 0.12
        run.map.log_scales[1][2] = Real::ln(1.1f32);
        run.map.log_scales[2][1] = Real::ln(0.5f32);
        run.map.landmark = [0, 1, 2, 3]
            .map(|i| Some(garad_core::LandmarkId(i)))
            .to_vec();
        run.densify = Some(DensifyConfig {
            every: 1,
            grad_threshold: 5.0,
            split_extent: 0.03,
            min_opacity: 0.2,
            prune_large,
            young_keyframes: 0,
            ..DensifyConfig::default()
        });
        run.step(Pick::Youngest).expect("finite");
        let tags: Vec<_> = run.map.landmark.iter().flatten().map(|l| l.0).collect();
        let expected: &[u32] = if prune_large { &[2, 3] } else { &[1, 2, 3] };
        assert_eq!(tags, expected, "without a gradient: {prune_large}");

        run.by_mean_px = [2.0, 0.0]; // 11 half images at a quarter of the size
        run.step(Pick::Youngest).expect("finite");
        let tags: Vec<_> = run.map.landmark.iter().flatten().map(|l| l.0).collect();
        assert_eq!(
            tags,
            [3],
            "parents of children are dropped, those of clones stay"
        );
        assert_eq!(
            run.map.len(),
            rows,
            "with a clone and two children each: {prune_large}"
        );
    }
}

#[test]
fn pruning_drops_static_gaussians_below_the_given_opacity() {
    let mut run = Run::new(1, 4);
    run.map.opacity_logits = vec![-1.0, -0.5, -1.0, 2.0]; // 0.27, 0.38, 0.27, 0.88
    run.map.label[2] = Dynamic;
    run.trainer.windows(&run.map)[3].push(Static);
    run.trainer.prune(&mut run.map, 0.3);
    assert_eq!(run.map.opacity_logits, [-0.5, -1.0, 2.0]);
    let seen: Vec<_> = (run.trainer.state().windows.iter())
        .map(LabelWindow::seen)
        .collect();
    assert_eq!(seen, [0, 0, 1], "windows stay with their Gaussians");
}

#[test]
fn the_extent_is_that_of_the_cameras_around_their_mean() {
    let corner = |x: f64, z: f64| {
        let turn = So3::exp(&Vector3::new(0.4, -0.9, 0.2));
        Se3::new(turn, Vector3::new(x, 0.0, z)).inverse()
    };
    for (poses, expected) in [
        (vec![], 1.0),
        (vec![corner(9.0, 9.0)], 1.0),
        (vec![corner(0.0, 0.0), corner(1.8, 0.0)], 1.0),
        (vec![corner(0.0, 0.0), corner(4.0, 0.0)], 2.2),
        (
            vec![corner(0.0, 0.0), corner(4.0, 0.0), corner(0.0, 7.0)],
            1.1 * 212f64.sqrt() / 3.0,
        ),
    ] {
        let extent_m = extent_m(&poses);
        assert!(
            (extent_m - expected).abs() < 1e-12,
            "{extent_m}: {expected}"
        );
    }
}

#[test]
fn the_weight_of_a_dynamic_gaussian_is_its_share_of_dynamic_runs() {
    let mut window = LabelWindow::default();
    for label in [Dynamic, Dynamic, Static, Dynamic] {
        window.push(label);
    }
    let windows = [window, LabelWindow::default()];
    for (n, expected) in [(1, 1.0), (2, 0.5), (4, 0.75), (5, 0.6)] {
        assert_eq!(
            belief_and_age(&windows, n),
            [expected, 0.0],
            "of the last {n}"
        );
    }
}
