//! A renderer of its own in f32, forwards and backwards, with faults and ways to round that can be switched on. It
//! shares no code with garad: every pixel meets every splat.

use garad_conformance::Outputs;
use garad_golden::Tensor;

use super::answers::Given;
use super::blend::{Images, Up, blend, blend_backward, order};
use super::harmonics::{basis, tangent_gradient};
use super::number::N;
use super::rendering::{Density, Fault, How, Walk};
use super::splats::{ByPixel, Gaussians, Splat, View, project, project_backward, rotation};

/// Which processor, and how.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Renderer {
    pub(crate) fma: bool,
    pub(crate) ftz: bool,
    pub(crate) how: How,
}

pub(crate) const STAGES: [&str; 4] = ["sh", "projection_covariance", "raster", "raster_backward"];

impl Renderer {
    pub(crate) fn faulty(fault: Fault) -> Self {
        let how = How {
            fault: Some(fault),
            walk: Walk::Rows,
            density: Density::Slanted,
            exp_ulp: 0,
        };
        let (fma, ftz) = (false, false);
        Self { fma, ftz, how }
    }

    pub(crate) fn answer(&self, case: Given<'_>) -> Outputs {
        match (self.fma, self.ftz) {
            (false, false) => answer::<false, false>(case, &self.how),
            (true, false) => answer::<true, false>(case, &self.how),
            (false, true) => answer::<false, true>(case, &self.how),
            (true, true) => answer::<true, true>(case, &self.how),
        }
    }
}

fn answer<const M: bool, const Z: bool>(case: Given<'_>, how: &How) -> Outputs {
    match case.0.stage() {
        "sh" => harmonics::<M, Z>(case, how),
        "projection_covariance" => projection::<M, Z>(case, how),
        "raster" => forward::<M, Z>(case, how),
        _ => backward::<M, Z>(case, how),
    }
}

pub(crate) fn column<const M: bool, const Z: bool>(case: Given<'_>, name: &str) -> Vec<N<M, Z>> {
    let there = case.get(name).map(Tensor::f64);
    there.unwrap_or_default().into_iter().map(N::new).collect()
}

pub(crate) fn rows<const M: bool, const Z: bool, const K: usize>(
    case: Given<'_>,
    name: &str,
) -> Vec<[N<M, Z>; K]> {
    let all = column(case, name);
    all.as_chunks::<K>().0.to_vec()
}

fn flat<const M: bool, const Z: bool, const K: usize>(rows: &[[N<M, Z>; K]]) -> Vec<f32> {
    rows.iter().flatten().map(|v| v.0).collect()
}

fn single<const M: bool, const Z: bool>(values: &[N<M, Z>]) -> Vec<f32> {
    values.iter().map(|v| v.0).collect()
}

pub(crate) type Scene<const M: bool, const Z: bool> =
    (Gaussians<M, Z>, View<M, Z>, Vec<Splat<M, Z>>);

pub(crate) fn scene<const M: bool, const Z: bool>(case: Given<'_>, how: &How) -> Scene<M, Z> {
    let means = rows::<M, Z, 3>(case, "means");
    let triples = rows::<M, Z, 3>(case, "sh");
    let per = triples.len() / means.len().max(1);
    let gaussians = Gaussians {
        log_scales: rows(case, "log_scales"),
        quaternions: rows(case, "quaternions"),
        opacity_logits: column(case, "opacity_logits"),
        sh: triples.chunks(per.max(1)).map(<[_]>::to_vec).collect(),
        means,
    };
    let plain = How {
        fault: None,
        ..*how
    };
    let w = rotation(&rows(case, "camera_from_world_q")[0], &plain);
    let t = rows::<M, Z, 3>(case, "camera_from_world_t")[0];
    let (w, t) = match how.fault {
        Some(Fault::WorldForCamera) => {
            let back = super::number::transposed(&w);
            (back, super::number::apply(&back, &t).map(|v| -v))
        }
        _ => (w, t),
    };
    let size = ["width", "height"].map(|n| i64::try_from(case.count(n)).unwrap_or(0));
    let view = View {
        w,
        t,
        k: rows(case, "intrinsics")[0],
        size,
    };
    let splats = (0..gaussians.means.len())
        .map(|i| project(&gaussians, i, &view, how))
        .collect();
    (gaussians, view, splats)
}

fn harmonics<const M: bool, const Z: bool>(case: Given<'_>, how: &How) -> Outputs {
    let directions = rows::<M, Z, 3>(case, "direction");
    let triples = rows::<M, Z, 3>(case, "sh");
    let n = triples.len() / directions.len();
    let (mut values, mut slopes, mut colors) = (Vec::new(), Vec::new(), Vec::new());
    for (d, f) in directions.iter().zip(triples.chunks(n)) {
        let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        let unit = d.map(|v| v / length);
        let b = basis(&unit, n, how);
        slopes.extend(tangent_gradient(&unit, n, how));
        for count in [1, 4, 9, 16] {
            colors.push([0, 1, 2].map(|c| {
                let terms = b.iter().zip(f).take(count);
                terms
                    .fold(N::new(0.5), |sum, (b, f)| b.times_plus(f[c], sum))
                    .max(N::ZERO)
            }));
        }
        values.extend(b);
    }
    let mut out = Outputs::default();
    out.put("basis", single(&values));
    out.put("tangent_gradient", flat(&slopes));
    out.put("color", flat(&colors));
    out
}

fn geometry<const M: bool, const Z: bool>(out: &mut Outputs, splats: &[&Splat<M, Z>]) {
    let take = |f: &dyn Fn(&Splat<M, Z>) -> Vec<N<M, Z>>| -> Vec<f32> {
        splats.iter().flat_map(|s| f(s)).map(|v| v.0).collect()
    };
    out.put("mean_px", take(&|s| s.mean_px.to_vec()));
    out.put("depth_m", take(&|s| vec![s.depth_m]));
    out.put("conic", take(&|s| s.conic.to_vec()));
}

fn projection<const M: bool, const Z: bool>(case: Given<'_>, how: &How) -> Outputs {
    let (_, _, splats) = scene::<M, Z>(case, how);
    let mut out = Outputs::default();
    let p: Vec<[N<M, Z>; 3]> = splats.iter().map(|s| s.p).collect();
    let r: Vec<[N<M, Z>; 3]> = splats.iter().flat_map(|s| s.r).collect();
    out.put("p_cam", flat(&p));
    out.put("rotation", flat(&r));
    let visible: Vec<&Splat<M, Z>> = splats.iter().filter(|s| s.visible).collect();
    geometry(&mut out, &visible);
    out.put("radius", visible.iter().map(|s| s.radius));
    out.put("footprint", visible.iter().map(|s| s.footprint));
    out
}

fn forward<const M: bool, const Z: bool>(case: Given<'_>, how: &How) -> Outputs {
    let (_, view, splats) = scene::<M, Z>(case, how);
    let order = order(&splats, how);
    let background = rows(case, "background")[0];
    let images = blend(&splats, &order, view.size, &background, how);
    images_out(&splats, &order, images)
}

/// The outputs of the stage `raster`.
pub(crate) fn images_out<const M: bool, const Z: bool>(
    splats: &[Splat<M, Z>],
    order: &[usize],
    images: Images<M, Z>,
) -> Outputs {
    let mut out = Outputs::default();
    out.put("color", flat(&images.color));
    out.put("depth", single(&images.depth));
    out.put("transmittance", single(&images.left));
    out.put("contributors", images.count);
    out.put("last", images.last);
    out.put("radii", splats.iter().map(|s| s.radius));
    out.put("order", order.iter().copied());
    let sorted: Vec<&Splat<M, Z>> = order.iter().map(|&i| &splats[i]).collect();
    geometry(&mut out, &sorted);
    let colors: Vec<[N<M, Z>; 3]> = sorted.iter().map(|s| s.color).collect();
    out.put("splat_color", flat(&colors));
    out
}

fn backward<const M: bool, const Z: bool>(case: Given<'_>, how: &How) -> Outputs {
    let (gaussians, view, splats) = scene::<M, Z>(case, how);
    let order = order(&splats, how);
    let background = rows(case, "background")[0];
    let pass_through = case.word("clamp_gradient") == "pass_through";
    let (color, depth, opacity) = (
        rows(case, "upstream_color"),
        column(case, "upstream_depth"),
        column(case, "upstream_opacity"),
    );
    let up = Up {
        color: &color,
        depth: &depth,
        opacity: &opacity,
    };
    let by_pixel = blend_backward(
        &splats,
        &order,
        view.size,
        &background,
        &up,
        pass_through,
        how,
    );
    gradients_out(&gaussians, &view, &splats, &by_pixel, pass_through, how)
}

/// The outputs of the stage `raster_backward`.
pub(crate) fn gradients_out<const M: bool, const Z: bool>(
    gaussians: &Gaussians<M, Z>,
    view: &View<M, Z>,
    splats: &[Splat<M, Z>],
    by_pixel: &[ByPixel<M, Z>],
    pass_through: bool,
    how: &How,
) -> Outputs {
    let found: Vec<_> = by_pixel
        .iter()
        .zip(splats)
        .enumerate()
        .map(|(i, (d, s))| project_backward(d, s, gaussians, i, view, pass_through, how))
        .collect();
    let mut pose = [N::<M, Z>::ZERO; 6];
    let mut parts: Vec<_> = found.iter().collect();
    if how.walk == Walk::Backwards {
        parts.reverse();
    }
    for part in parts {
        pose.iter_mut()
            .zip(part.pose)
            .for_each(|(sum, v)| *sum += v);
    }
    let take = |f: &dyn Fn(usize) -> Vec<N<M, Z>>| -> Vec<f32> {
        (0..found.len()).flat_map(f).map(|v| v.0).collect()
    };
    let mut out = Outputs::default();
    for (name, values) in [
        ("d_means", take(&|i| found[i].mean.to_vec())),
        ("d_log_scales", take(&|i| found[i].log_scale.to_vec())),
        ("d_quaternions", take(&|i| found[i].quaternion.to_vec())),
        ("d_opacity_logits", take(&|i| vec![found[i].opacity_logit])),
        ("d_sh", take(&|i| found[i].sh.concat())),
        ("d_pose", single(&pose)),
        ("d_means2d", take(&|i| by_pixel[i].mean_px.to_vec())),
        ("d_conics", take(&|i| by_pixel[i].conic.to_vec())),
        ("d_opacities", take(&|i| vec![by_pixel[i].opacity])),
        ("d_colors", take(&|i| by_pixel[i].color.to_vec())),
        ("d_depths", take(&|i| vec![by_pixel[i].depth])),
    ] {
        out.put(name, values);
    }
    if how.fault == Some(Fault::EmptyShape) && found.is_empty() {
        let none = out.shaped("d_sh", &[0, 0], std::iter::empty::<[f32; 3]>());
        none.expect("no elements");
    }
    out
}
