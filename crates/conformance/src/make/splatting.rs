//! Cases of the rasterizer, forwards and backwards, of one scene.

use garad_core::{Par, Rng};
use garad_golden::{Dtype, Tensor};
use garad_raster::{GradientScales, Projected, gradient_scales};
use garad_slam::mapping::iteration::Engine;

use super::masks::{self, Depths};
use super::scene::{Scene, SceneOptions};
use super::{Made, Output, bytes, f32_of, shaped};
use crate::outputs::Error;
use crate::raster;

/// The stages of [`splatting`].
pub const SPLATTING: [&str; 2] = ["raster", "raster_backward"];
/// Side of the tiles of `tile_ranges`, `tile_entries`, `tile_keys`, and of what `last` counts in.
pub const TILE_PX: usize = 16;

#[rustfmt::skip]
const FORWARD: &[Output] = &[
    ("color", Dtype::F64, "1", "raster.color"),
    ("depth", Dtype::F64, "m", "raster.depth"),
    ("transmittance", Dtype::F64, "1", "raster.transmittance"),
    ("contributors", Dtype::I32, "1", "exact"),
    ("last", Dtype::I32, "1", "exact"),
    ("radii", Dtype::I32, "px", "exact"),
    ("order", Dtype::I32, "1", "exact"),
    ("mean_px", Dtype::F64, "px", "raster.mean_px"),
    ("depth_m", Dtype::F64, "m", "raster.depth_m"),
    ("conic", Dtype::F64, "px^-2", "raster.conic"),
    ("splat_color", Dtype::F64, "1", "raster.color"),
];

const ROWS: &str = "raster_backward.rows";

#[rustfmt::skip]
const BACKWARD: &[Output] = &[
    ("d_means", Dtype::F64, "m^-1", ROWS),
    ("d_log_scales", Dtype::F64, "1", ROWS),
    ("d_quaternions", Dtype::F64, "1", ROWS),
    ("d_opacity_logits", Dtype::F64, "1", ROWS),
    ("d_sh", Dtype::F64, "1", ROWS),
    ("d_pose", Dtype::F64, "m^-1, rad^-1", ROWS),
    ("d_means2d", Dtype::F64, "px^-1", ROWS),
    ("d_conics", Dtype::F64, "px^2", ROWS),
    ("d_opacities", Dtype::F64, "1", ROWS),
    ("d_colors", Dtype::F64, "1", ROWS),
    ("d_depths", Dtype::F64, "m^-1", ROWS),
];

/// A case of `raster` and one of `raster_backward`; the same for any number of threads.
///
/// # Errors
/// For a scene that cannot be made, see [`SceneOptions`].
pub fn splatting(options: &SceneOptions, par: Par) -> Result<[Made; 2], Error> {
    let scene = Scene::new(options, par)?;
    let why = "what goes wrong only at size: batches, long lists, big sorts, crowded tiles";
    let mut forward = Made::new("raster", options.name(), options.seed, why.to_owned());
    put_scene(&mut forward, &scene);
    let given = raster::Scene::<f64>::new(&forward.question(), par)?;
    let image = given.draw(Engine::REFERENCE)?;
    let splats = &image.projected;
    let tiles = Lists::new(splats, options.size);
    tiles.put(&mut forward, splats);
    let depths = Depths::new(&scene, splats)?;
    let [width, height] = options.size;
    let robust = par.map(height, |y| {
        let clear = |x| masks::pixel(&scene, &depths, splats, tiles.of(x, y), [x, y]);
        (0..width).map(|x| u8::from(clear(x))).collect::<Vec<u8>>()
    });
    let mask = |values, shape: &[usize]| bytes(values, shape, Dtype::Bool);
    let unit = "away from alpha = 1/255 and T = 1e-4, and in an order certain in f32";
    forward.input("robust", mask(robust.concat(), &[height, width]), unit);
    let n = options.gaussians;
    let radii = masks::radii(n, splats);
    forward.input(
        "robust_radii",
        mask(radii, &[n]),
        "away from the next whole number",
    );
    let order = depths.order(&scene, splats);
    for name in ["order", "mean_px", "depth_m", "conic", "splat_color"] {
        let mask = mask(order.clone(), &[splats.len()]);
        forward.input(&format!("robust_{name}"), mask, "depth certain in f32");
    }
    forward.expect(&raster::images(&image), FORWARD)?;

    let mut backward = Made::new(
        "raster_backward",
        options.name(),
        options.seed,
        why.to_owned(),
    );
    put_scene(&mut backward, &scene);
    backward.param("clamp_gradient", "true");
    let rng = &mut Rng::keyed(options.seed, &[u64::MAX]);
    for (name, axes, unit) in [
        ("upstream_color", &[height, width, 3][..], "1"),
        ("upstream_depth", &[height, width], "m^-1"),
        ("upstream_opacity", &[height, width], "1"),
    ] {
        let values = (0..axes.iter().product::<usize>()).map(|_| f32_of(rng.normal()));
        backward.input(name, shaped(values.collect(), axes, Dtype::F32), unit);
    }
    let question = backward.question();
    let given = raster::Scene::<f64>::new(&question, par)?;
    let upstream = raster::upstream(&question)?;
    let found = raster::gradients(&given, &image, &upstream, Engine::REFERENCE)?;
    let (map, camera, pose) = (&given.map, &given.camera, &given.pose);
    let scales = gradient_scales(map, camera, pose, &given.options, &image, &upstream, par)?;
    put_scales(&mut backward, scales);
    backward.expect(&found, BACKWARD)?;
    Ok([forward, backward])
}

pub(super) fn put_scene(made: &mut Made, scene: &Scene) {
    let (map, camera) = (&scene.map, &scene.camera);
    let n = map.len();
    made.param("width", camera.width);
    made.param("height", camera.height);
    made.param("sh_degree", map.sh_degree());
    let k = [camera.fx, camera.fy, camera.cx, camera.cy];
    let list = |values: &[f64]| Tensor::from(values.to_vec());
    made.input("intrinsics", list(&k), "px: fx fy cx cy");
    made.input("camera_from_world_q", list(&scene.q), "w x y z");
    made.input("camera_from_world_t", list(&scene.t), "m");
    made.input("background", list(&scene.background), "1");
    let flat = |rows: &[[f64; 3]]| rows.concat();
    let quaternions = map.quaternions.concat();
    let single = |values, axes: &[usize]| shaped(values, axes, Dtype::F32);
    made.input("means", single(flat(&map.means), &[n, 3]), "m");
    made.input("quaternions", single(quaternions, &[n, 4]), "w x y z");
    made.input("log_scales", single(flat(&map.log_scales), &[n, 3]), "ln m");
    made.input(
        "opacity_logits",
        single(map.opacity_logits.clone(), &[n]),
        "1",
    );
    let axes = [n, map.coefficients(), 3];
    made.input("sh", single(flat(&map.sh), &axes), "1");
}

fn put_scales(made: &mut Made, scales: GradientScales) {
    let GradientScales {
        means,
        log_scales,
        quaternions,
        opacity_logits,
        sh,
        pose,
        means2d,
        conics,
        opacities,
        colors,
        depths,
    } = scales;
    for (name, values) in [
        ("d_means", means),
        ("d_log_scales", log_scales),
        ("d_quaternions", quaternions),
        ("d_opacity_logits", opacity_logits),
        ("d_sh", sh),
        ("d_pose", pose.to_vec()),
        ("d_means2d", means2d),
        ("d_conics", conics),
        ("d_opacities", opacities),
        ("d_colors", colors),
        ("d_depths", depths),
    ] {
        let unit = "what each row is a sum of, without signs, times its condition";
        made.input(&format!("scale_{name}"), Tensor::from(values), unit);
    }
}

/// The splats of each tile, front to back, as positions in the order of depth.
struct Lists {
    columns: usize,
    lists: Vec<Vec<u32>>,
}

impl Lists {
    fn new(splats: &[Projected<f64>], size: [usize; 2]) -> Self {
        let [columns, rows] = size.map(|n| n.div_ceil(TILE_PX));
        let mut lists = vec![Vec::new(); columns * rows];
        for (splat, position) in splats.iter().zip(0u32..) {
            let f = &splat.footprint;
            for row in f.y0 / TILE_PX..f.y1.div_ceil(TILE_PX) {
                for column in f.x0 / TILE_PX..f.x1.div_ceil(TILE_PX) {
                    lists[row * columns + column].push(position);
                }
            }
        }
        Self { columns, lists }
    }

    fn of(&self, x: usize, y: usize) -> &[u32] {
        &self.lists[y / TILE_PX * self.columns + x / TILE_PX]
    }

    /// What a port may look at: tile t has the entries from `tile_ranges[t, 0]` up to `tile_ranges[t, 1]`, each a row of the
    /// map, and the keys by which they are sorted.
    #[allow(
        clippy::cast_possible_truncation,
        reason = "the key has the bits of an f32"
    )]
    fn put(&self, made: &mut Made, splats: &[Projected<f64>]) {
        made.param("tile_px", TILE_PX);
        let (mut ranges, mut entries, mut keys) = (Vec::new(), Vec::new(), Vec::new());
        for (tile, list) in (0i64..).zip(&self.lists) {
            ranges.push(entries.len() as f64);
            for &position in list {
                let splat = &splats[position as usize];
                entries.push(f64::from(splat.index));
                keys.push(tile << 32 | i64::from((splat.depth_m as f32).to_bits()));
            }
            ranges.push(entries.len() as f64);
        }
        let (tiles, n) = (self.lists.len(), entries.len());
        made.input(
            "tile_ranges",
            shaped(ranges, &[tiles, 2], Dtype::I32),
            "tiles of 16 px, row by row: first entry, one behind the last",
        );
        // Longer ones, of some million, would not fit into a case.
        if n <= 7_000_000 {
            made.input(
                "tile_entries",
                shaped(entries, &[n], Dtype::I32),
                "rows of the map, by tile of 16 px, then front to back",
            );
            let keys = keys.iter().flat_map(|k| k.to_le_bytes()).collect();
            made.input(
                "tile_keys",
                bytes(keys, &[n], Dtype::I64),
                "tile of 16 px times 2^32 plus the bits of the depth in f32",
            );
        }
    }
}
