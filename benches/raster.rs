//! The rasterizer in f32: 10 000 to 200 000 Gaussians, three sizes of pictures, one and two
//! threads; forward, backward and both; the reference beside it where it does not take too long. And the mask of the
//! dynamic Gaussians, as every frame renders it.
//!
//! `cargo bench --bench raster -- "fast/.*/640x480"` runs a part.

use std::hint::black_box;
use std::time::Duration;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use garad_core::{Camera, GaussianMap, Image, KeyframeId, Label, NewGaussian, Par, Real, Rng, Se3};
use garad_raster::{
    Gradients, RasterError, RenderOptions, Rendered, Upstream, backward, fast, render,
};

/// TUM freiburg3 at 640x480; other sizes have the same field of view.
fn camera(width: usize, height: usize) -> Camera {
    let scale = width as f64 / 640.0;
    let k = [535.4, 539.2, 320.1, 247.6].map(|v| v * scale);
    Camera::pinhole((width, height), k).expect("freiburg3")
}

/// A room as mapping leaves it: centres spread over the picture and a little beyond, at 1 to 4 m;
/// half-axes about 6 mm, 0.8 to 3 px at 640x480, with a spread of e^0.5 each, turned at random;
/// opacities 0.1 to 0.95.
///
/// At 640x480 a splat's footprint covers 3.6 tiles, and a pixel blends 3.5, 17 and 62 of 10 000,
/// 50 000 and 200 000 splats.
fn room(n: usize) -> GaussianMap<f32> {
    let camera = camera(640, 480);
    let mut rng = Rng::keyed(7, &[n as u64]);
    let mut map = GaussianMap::new(0);
    for _ in 0..n {
        let z = rng.range(1.0, 4.0);
        let u = rng.range(-20.0, 660.0);
        let v = rng.range(-20.0, 500.0);
        let mean = [
            (u - camera.cx) / camera.fx * z,
            (v - camera.cy) / camera.fy * z,
            z,
        ];
        let i = map.push(&NewGaussian {
            mean: mean.map(Real::to_f32),
            sigma_m: 0.006,
            opacity: rng.range(0.1, 0.95).to_f32(),
            color: [0; 3].map(|_| rng.uniform().to_f32()),
            landmark: None,
            born: KeyframeId(0),
        });
        for k in 0..3 {
            map.log_scales[i][k] += (0.5 * rng.normal()).to_f32();
        }
        map.quaternions[i] = [0; 4].map(|_| rng.normal().to_f32());
    }
    map
}

type Draw =
    fn(&GaussianMap<f32>, &Camera, &Se3, &RenderOptions, Par) -> Result<Rendered<f32>, RasterError>;
type Back = fn(
    &GaussianMap<f32>,
    &Camera,
    &Se3,
    &RenderOptions,
    &Rendered<f32>,
    &Upstream<f32>,
    Par,
) -> Result<Gradients<f32>, RasterError>;

const REFERENCE: (&str, Draw, Back) = ("reference", render, backward);
const FAST: (&str, Draw, Back) = ("fast", fast::render, fast::backward);

/// One implementation on one map and size, all ways.
fn ways(
    criterion: &mut Criterion,
    (name, draw, back): (&str, Draw, Back),
    map: &GaussianMap<f32>,
    camera: &Camera,
    threads: usize,
) {
    let (width, height) = (camera.width, camera.height);
    let (pose, options, par) = (Se3::default(), RenderOptions::default(), Par::new(threads));
    let mut rng = Rng::new(3);
    let upstream = Upstream {
        color: Image::from_fn(width, height, |_, _| [0; 3].map(|_| rng.normal().to_f32())),
        depth: Some(Image::from_fn(width, height, |_, _| rng.normal().to_f32())),
        opacity: None,
    };
    let picture = || draw(black_box(map), camera, &pose, &options, par).expect("a picture");
    let gradients = |picture: &Rendered<f32>| {
        back(map, camera, &pose, &options, picture, &upstream, par).expect("gradients")
    };
    let mut group = criterion.benchmark_group(format!("raster/{name}"));
    group.sample_size(10);
    group.warm_up_time(Duration::from_millis(300));
    group.measurement_time(Duration::from_secs(1));
    let id = |way: &str| {
        let n = map.len();
        BenchmarkId::new(
            way,
            format!("{width}x{height}/{n}_gaussians/{threads}_threads"),
        )
    };
    group.bench_function(id("forward"), |bencher| bencher.iter(picture));
    let drawn = picture();
    group.bench_function(id("backward"), |bencher| {
        bencher.iter(|| gradients(black_box(&drawn)));
    });
    group.bench_function(id("forward_backward"), |bencher| {
        bencher.iter(|| gradients(&picture()));
    });
    group.finish();
}

fn raster(criterion: &mut Criterion) {
    for n in [10_000, 50_000, 200_000] {
        let map = room(n);
        for (width, height) in [(320, 240), (640, 480), (1280, 960)] {
            let camera = camera(width, height);
            for threads in [1, 2] {
                ways(criterion, FAST, &map, &camera, threads);
            }
            if n <= 50_000 && width <= 640 {
                ways(criterion, REFERENCE, &map, &camera, 1);
            }
        }
    }
}

/// The Gaussian mask of a frame of 640x480: of 50 000 Gaussians the 3 000 in the middle of the picture, a person, are
/// dynamic. They are taken out of the map once per keyframe, and rendered alone at three levels in every frame.
fn gaussian_mask(criterion: &mut Criterion) {
    let mut map = room(50_000);
    let camera = camera(640, 480);
    let off = |mean: &[f32; 3]| {
        let [x, y] = [mean[0] / mean[2], mean[1] / mean[2]];
        x.abs().max(0.6 * y.abs())
    };
    let mut by_distance: Vec<usize> = (0..map.len()).collect();
    by_distance.sort_by(|a, b| off(&map.means[*a]).total_cmp(&off(&map.means[*b])));
    for row in &by_distance[..3000] {
        map.label[*row] = Label::Dynamic;
    }
    let select = || {
        let mut dynamic = black_box(&map).clone();
        dynamic.retain(|row| map.label[row] == Label::Dynamic);
        dynamic
    };
    let dynamic = select();
    let pose = Se3::default();
    let draw = |map: &GaussianMap<f32>, level: usize| {
        let camera = camera.level(level);
        fast::coverage(black_box(map), &camera, &pose, Par::Seq).expect("a picture")
    };
    let (level, empty) = (|level| draw(&dynamic, level), GaussianMap::new(0));
    let mut group = criterion.benchmark_group("raster/mask");
    group.sample_size(20);
    group.warm_up_time(Duration::from_millis(300));
    group.measurement_time(Duration::from_secs(2));
    group.bench_function("select", |bencher| bencher.iter(select));
    for l in 0..3 {
        let name = format!("level_{l}");
        group.bench_function(name, |bencher| bencher.iter(|| level(l)));
    }
    group.bench_function("level_0_empty", |bencher| bencher.iter(|| draw(&empty, 0)));
    group.bench_function("levels_0_to_2", |bencher| {
        bencher.iter(|| [0, 1, 2].map(level));
    });
    group.finish();
}

criterion_group!(benches, raster, gaussian_mask);
criterion_main!(benches);
