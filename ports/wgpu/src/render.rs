//! The rasterizer: one map, one view, images and their gradients.

use crate::Error;
use crate::case::Case;
use crate::gpu::{self, Buffer, Gpu};
use crate::sums;

/// Numbers of a Gaussian in front of its harmonics: mean, log-scales, quaternion, opacity logit.
pub const BEFORE_HARMONICS: usize = 11;
/// Parameters: name, first column, columns.
const GROUPS: [(&str, usize, usize); 4] = [
    ("means", 0, 3),
    ("log_scales", 3, 3),
    ("quaternions", 6, 4),
    ("opacity_logits", 10, 1),
];

/// A map as the kernels want it: one row per Gaussian.
pub struct Map {
    pub gaussians: usize,
    pub coefficients: usize,
    pub rows: Vec<f32>,
}

impl Map {
    pub fn columns(&self) -> usize {
        BEFORE_HARMONICS + 3 * self.coefficients
    }

    /// From the inputs of a case; what it does not have is 0.
    pub fn of_case(case: &Case) -> Result<Self, Error> {
        let gaussians = case.array("means")?.shape[0];
        let coefficients = match case.has("sh") {
            true => case.array("sh")?.shape[1],
            false => 0,
        };
        let mut map = Self {
            gaussians,
            coefficients,
            rows: Vec::new(),
        };
        map.rows.resize(gaussians * map.columns(), 0.0);
        for (name, first, count) in map.groups() {
            if case.has(name) {
                let values = case.singles(name)?;
                let columns = map.columns();
                for (i, value) in values.into_iter().enumerate() {
                    map.rows[i / count * columns + first + i % count] = value;
                }
            }
        }
        Ok(map)
    }

    /// Name, first column and number of columns of each parameter.
    pub fn groups(&self) -> Vec<(&'static str, usize, usize)> {
        let mut groups = GROUPS.to_vec();
        if self.coefficients > 0 {
            groups.push(("sh", BEFORE_HARMONICS, 3 * self.coefficients));
        }
        groups
    }

    /// The shape of a parameter as an output.
    pub fn shape(&self, name: &str) -> Vec<usize> {
        match name {
            "opacity_logits" => vec![self.gaussians],
            "sh" => vec![self.gaussians, self.coefficients, 3],
            "quaternions" => vec![self.gaussians, 4],
            _ => vec![self.gaussians, 3],
        }
    }
}

/// Some columns of a table.
pub fn columns_of(rows: &[f32], width: usize, first: usize, count: usize) -> Vec<f32> {
    let cut = |row: &[f32]| row[first..first + count].to_vec();
    rows.chunks_exact(width).flat_map(cut).collect()
}

/// A camera at a pose.
pub struct View {
    pub width: usize,
    pub height: usize,
    pub coefficients: usize,
    buffer: Buffer,
}

impl View {
    pub fn new(
        gpu: &Gpu,
        map: &Map,
        [width, height]: [usize; 2],
        intrinsics: &[f64],
        quaternion: &[f64],
        translation: &[f64],
        background: &[f64],
        pass_through: bool,
    ) -> Self {
        let length = quaternion.iter().map(|v| v * v).sum::<f64>().sqrt();
        let [w, x, y, z] = [0, 1, 2, 3].map(|k| quaternion[k] / length);
        let rows = [
            [
                1.0 - 2.0 * (y * y + z * z),
                2.0 * (x * y - w * z),
                2.0 * (x * z + w * y),
            ],
            [
                2.0 * (x * y + w * z),
                1.0 - 2.0 * (x * x + z * z),
                2.0 * (y * z - w * x),
            ],
            [
                2.0 * (x * z - w * y),
                2.0 * (y * z + w * x),
                1.0 - 2.0 * (x * x + y * y),
            ],
        ];
        let mut words = Vec::new();
        for (row, t) in rows.iter().zip(translation) {
            words.extend(row.iter().chain([t]).map(|&v| (v as f32).to_bits()));
        }
        words.extend(intrinsics.iter().map(|&v| (v as f32).to_bits()));
        words.extend([0, 1, 2].map(|c| background.get(c).map_or(0, |&v| (v as f32).to_bits())));
        words.push(0);
        let counts = [width, height, width.div_ceil(16), height.div_ceil(16)];
        words.extend(counts.map(|v| v as u32));
        let counts = [
            map.gaussians,
            map.coefficients,
            usize::from(pass_through),
            0,
        ];
        words.extend(counts.map(|v| v as u32));
        Self {
            width,
            height,
            coefficients: map.coefficients,
            buffer: gpu.upload(&words),
        }
    }

    pub fn of_case(gpu: &Gpu, case: &Case, map: &Map, suffix: &str) -> Result<Self, Error> {
        let pose = |name| case.array(&format!("camera_from_world_{name}{suffix}"));
        let background = match case.has("background") {
            true => case.array("background")?.data,
            false => Vec::new(),
        };
        let pass_through =
            case.has_param("clamp_gradient") && case.word("clamp_gradient")? == "pass_through";
        Ok(Self::new(
            gpu,
            map,
            [
                case.whole("width")? as usize,
                case.whole("height")? as usize,
            ],
            &case.array("intrinsics")?.data,
            &pose("q")?.data,
            &pose("t")?.data,
            &background,
            pass_through,
        ))
    }

    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    fn tiles(&self) -> [usize; 2] {
        [self.width.div_ceil(16), self.height.div_ceil(16)]
    }
}

/// Splats of a view: 16 words each, as `Splat` of the shaders.
pub struct Splats {
    pub gaussians: usize,
    pub splats: Buffer,
    pub radii: Buffer,
    covered: Buffer,
    depth_keys: Buffer,
}

/// The splats by tile, and the images.
pub struct Rendered {
    /// Gaussians front to back; those that are not visible come last.
    pub order: Buffer,
    pub entry_count: usize,
    entries: Buffer,
    owners: Buffer,
    /// First entry and number of entries of each Gaussian.
    rows: Buffer,
    ranges: Buffer,
    /// Eight words per pixel: r g b T, depth contributors last 0.
    pub image: Buffer,
}

/// Gradients, by row of the map.
pub struct Gradients {
    pub map: Buffer,
    /// Centre 2, conic 3, opacity, colour 3, depth.
    pub splats: Buffer,
    pub pose: Buffer,
}

pub fn project(gpu: &Gpu, view: &View, map: &Buffer, hidden: &Buffer, gaussians: usize) -> Splats {
    let found = Splats {
        gaussians,
        splats: gpu.zeros(16 * gaussians),
        radii: gpu.zeros(gaussians),
        covered: gpu.zeros(gaussians),
        depth_keys: gpu.zeros(gaussians),
    };
    gpu.run_over(
        "project/project",
        &[
            &view.buffer,
            map,
            hidden,
            &found.splats,
            &found.radii,
            &found.covered,
            &found.depth_keys,
        ],
        gaussians,
    );
    found
}

/// Position in the camera [N, 3] and rotation [N, 3, 3].
pub fn describe(gpu: &Gpu, view: &View, map: &Buffer, gaussians: usize) -> [Buffer; 2] {
    let out = [gpu.zeros(3 * gaussians), gpu.zeros(9 * gaussians)];
    gpu.run_over(
        "project/describe",
        &[&view.buffer, map, &out[0], &out[1]],
        gaussians,
    );
    out
}

/// Sorts the pairs (tile, depth) and blends.
///
/// The sort is a radix sort from the lowest digit on, of which the digits of the depth come before there
/// are pairs: Gaussians are sorted by depth, then make one entry per tile, and the entries are sorted by tile.
pub fn blend(gpu: &Gpu, view: &View, splats: &Splats) -> Result<Rendered, Error> {
    let n = splats.gaussians;
    let [tiles_x, tiles_y] = view.tiles();
    let sizes = gpu.upload(&[n as u32, tiles_x as u32]);
    let numbers = gpu.zeros(n);
    gpu.run_over("binning/enumerate", &[&numbers], n);
    let [_, order] = sums::sort(gpu, [splats.depth_keys.clone(), numbers], n, 32);
    let first = gpu.zeros(n);
    gpu.run_over(
        "binning/gather",
        &[&sizes, &order, &splats.covered, &first],
        n,
    );
    let entry_count = match n {
        0 => 0,
        _ => gpu.read::<u32>(&sums::exclusive(gpu, &first, n), 1)?[0] as usize,
    };
    // Ten numbers per entry in the backward pass.
    let most = (gpu.largest_binding / 40).min(gpu::MOST_THREADS);
    if entry_count as u64 > most {
        return Err(format!(
            "{entry_count} pairs of tile and splat are more than {most}, which {} can do",
            gpu.name
        ));
    }
    let [tiles, owners, rows] = [entry_count, entry_count, 2 * n].map(|words| gpu.zeros(words));
    gpu.run_over(
        "binning/emit",
        &[
            &sizes,
            &order,
            &splats.splats,
            &first,
            &tiles,
            &owners,
            &rows,
        ],
        n,
    );
    let numbers = gpu.zeros(entry_count);
    gpu.run_over("binning/enumerate", &[&numbers], entry_count);
    let bits = (tiles_x * tiles_y).next_power_of_two().ilog2();
    let [sorted_tiles, entries] = sums::sort(gpu, [tiles, numbers], entry_count, bits);
    let ranges = gpu.zeros(2 * tiles_x * tiles_y);
    gpu.run_over("binning/bounds", &[&sorted_tiles, &ranges], entry_count);
    let image = gpu.zeros(8 * view.pixels());
    gpu.run(
        "blend/forward",
        &[
            &view.buffer,
            &splats.splats,
            &entries,
            &owners,
            &ranges,
            &image,
        ],
        [tiles_x, tiles_y],
    );
    Ok(Rendered {
        order,
        entry_count,
        entries,
        owners,
        rows,
        ranges,
        image,
    })
}

/// From `upstream`, five numbers per pixel (by r g b, depth, opacity), to gradients.
pub fn backward(
    gpu: &Gpu,
    view: &View,
    map: &Buffer,
    splats: &Splats,
    rendered: &Rendered,
    upstream: &Buffer,
) -> Gradients {
    let n = splats.gaussians;
    let slots = gpu.zeros(10 * rendered.entry_count);
    gpu.run(
        "blend/backward",
        &[
            &view.buffer,
            &splats.splats,
            &rendered.entries,
            &rendered.owners,
            &rendered.ranges,
            &rendered.image,
            upstream,
            &slots,
        ],
        view.tiles(),
    );
    let width = BEFORE_HARMONICS + 3 * view.coefficients;
    let [by_map, by_splat, by_pose] = [width * n, 10 * n, 6 * n].map(|words| gpu.zeros(words));
    gpu.run_over(
        "project/project_backward",
        &[
            &view.buffer,
            map,
            &splats.splats,
            &slots,
            &rendered.rows,
            &by_map,
            &by_splat,
            &by_pose,
        ],
        n,
    );
    Gradients {
        map: by_map,
        splats: by_splat,
        pose: sums::columns(gpu, &by_pose, n, 6),
    }
}
