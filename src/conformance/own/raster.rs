//! What is drawn, and its gradients.

use garad_core::{Camera, GaussianMap, Image, KeyframeId, Label, Par, Real, Se3, So3, sh};
use garad_raster::{
    ClampGradient, Gradients, Projected, RasterError, RenderOptions, Rendered, Upstream, fast,
};
use nalgebra::Matrix3;

use super::fields::Fields;
use super::{Outputs, OwnError};

type Draw<T> =
    fn(&GaussianMap<T>, &Camera, &Se3, &RenderOptions, Par) -> Result<Rendered<T>, RasterError>;
type Back<T> = fn(
    &GaussianMap<T>,
    &Camera,
    &Se3,
    &RenderOptions,
    &Rendered<T>,
    &Upstream<T>,
    Par,
) -> Result<Gradients<T>, RasterError>;

/// Both passes of one implementation.
#[derive(Debug, Clone, Copy)]
pub(super) struct Engine<T> {
    pub(super) draw: Draw<T>,
    pub(super) back: Back<T>,
}

/// The plain loops, in f64.
pub(super) const REFERENCE: Engine<f64> = Engine {
    draw: garad_raster::render,
    back: garad_raster::backward,
};

/// What the mapper trains with.
pub(super) const FAST: Engine<f32> = Engine {
    draw: fast::render,
    back: fast::backward,
};

fn column<T: Real>(values: Vec<f64>) -> Vec<T> {
    values.into_iter().map(T::from_f64).collect()
}

fn rows<T: Real, const N: usize>(rows: Vec<[f64; N]>) -> Vec<[T; N]> {
    rows.into_iter().map(|row| row.map(T::from_f64)).collect()
}

/// The Gaussians of a case, all static. Without opacities and colours they are grey and half clear.
pub(super) fn map<T: Real>(fields: Fields<'_>) -> Result<GaussianMap<T>, OwnError> {
    let means = fields.rows::<3>("means")?;
    let n = means.len();
    let colored = fields.0.try_input("sh").is_some();
    let degree = if colored {
        fields.count("sh_degree")?
    } else {
        0
    };
    let mut map = GaussianMap::new(degree.min(sh::MAX_DEGREE));
    map.means = rows(means);
    map.log_scales = rows(fields.rows("log_scales")?);
    map.quaternions = rows(fields.rows("quaternions")?);
    map.opacity_logits = match fields.0.try_input("opacity_logits") {
        Some(tensor) => column(tensor.f64()),
        None => vec![T::ZERO; n],
    };
    map.sh = match colored {
        true => rows(fields.rows("sh")?),
        false => vec![[T::ZERO; 3]; n],
    };
    map.landmark = vec![None; n];
    map.parent = vec![None; n];
    map.born = vec![KeyframeId(0); n];
    map.label = vec![Label::Static; n];
    map.validate().map_err(|error| fields.wrong(error))?;
    Ok(map)
}

fn options(fields: Fields<'_>) -> Result<RenderOptions, OwnError> {
    let clamp_gradient = match fields.0.param("clamp_gradient") {
        None => ClampGradient::True,
        Some(_) => match fields.word("clamp_gradient")? {
            "true" => ClampGradient::True,
            "pass_through" => ClampGradient::PassThrough,
            other => return Err(fields.wrong(format!("clamp_gradient '{other}'"))),
        },
    };
    let mut options = RenderOptions {
        clamp_gradient,
        ..RenderOptions::default()
    };
    if fields.0.try_input("background").is_some() {
        options.background = fields.row("background")?;
    }
    Ok(options)
}

struct Scene<T> {
    map: GaussianMap<T>,
    camera: Camera,
    pose: Se3,
    options: RenderOptions,
}

fn scene<T: Real>(fields: Fields<'_>) -> Result<Scene<T>, OwnError> {
    Ok(Scene {
        map: map(fields)?,
        camera: fields.camera()?,
        pose: fields.pose("")?,
        options: options(fields)?,
    })
}

impl<T: Real> Scene<T> {
    fn draw(&self, fields: Fields<'_>, engine: Engine<T>) -> Result<Rendered<T>, OwnError> {
        let Self {
            map,
            camera,
            pose,
            options,
        } = self;
        (engine.draw)(map, camera, pose, options, Par::Seq).map_err(|error| fields.wrong(error))
    }
}

pub(super) fn forward<T: Real>(fields: Fields<'_>, engine: Engine<T>) -> Result<Outputs, OwnError> {
    let picture = scene::<T>(fields)?.draw(fields, engine)?;
    let mut out = Outputs::default();
    out.put("color", picture.color.data().as_flattened().iter().copied());
    out.put("depth", picture.depth.data().iter().copied());
    out.put(
        "transmittance",
        picture.transmittance.data().iter().copied(),
    );
    out.put_whole("contributors", picture.contributors.data().iter().copied());
    out.put_whole("last", picture.last.data().iter().copied());
    out.put_whole("radii", picture.radii.iter().copied());
    let splats = &picture.projected;
    out.put_whole("order", splats.iter().map(|s| s.index));
    out.put("splat_color", splats.iter().flat_map(|s| s.color));
    put_geometry(&mut out, splats.iter());
    Ok(out)
}

fn put_geometry<'a, T: Real>(
    out: &mut Outputs,
    splats: impl Iterator<Item = &'a Projected<T>> + Clone,
) {
    out.put("mean_px", splats.clone().flat_map(|s| s.mean_px));
    out.put("depth_m", splats.clone().map(|s| s.depth_m));
    out.put("conic", splats.flat_map(|s| s.conic));
}

/// The splats in the order of the map.
pub(super) fn projection<T: Real>(
    fields: Fields<'_>,
    engine: Engine<T>,
) -> Result<Outputs, OwnError> {
    let scene = scene::<T>(fields)?;
    let mut splats = scene.draw(fields, engine)?.projected;
    splats.sort_by_key(|s| s.index);
    let mut out = Outputs::default();
    let (turn, shift) = (scene.pose.rotation.matrix(), scene.pose.translation);
    let [turn, shift] = [turn.transpose().as_slice(), shift.as_slice()]
        .map(|v| v.iter().map(|&v| T::from_f64(v)).collect::<Vec<T>>());
    let p_cam = scene.map.means.iter().flat_map(|m| {
        [0, 1, 2].map(|k| {
            turn[3 * k] * m[0] + turn[3 * k + 1] * m[1] + turn[3 * k + 2] * m[2] + shift[k]
        })
    });
    out.put("p_cam", p_cam);
    let rotations = scene.map.quaternions.iter().map(|q| {
        let [w, x, y, z] = q.map(T::to_f64);
        let rotation = So3::from_quaternion(w, x, y, z);
        rotation.map_or(Matrix3::repeat(f64::NAN), |r| r.matrix())
    });
    out.put(
        "rotation",
        rotations.flat_map(|r| r.transpose().as_slice().to_vec()),
    );
    put_geometry(&mut out, splats.iter());
    out.put_whole("radius", splats.iter().map(|s| s.radius_px));
    let pixel = |v: usize| i32::try_from(v).unwrap_or(i32::MAX);
    let edges = splats.iter().map(|s| s.footprint);
    let edges = edges.flat_map(|f| [f.x0, f.y0, f.x1, f.y1].map(pixel));
    out.put_whole("footprint", edges);
    Ok(out)
}

/// d minus its part along the unit vector u.
fn across<T: Real>(d: [T; 3], u: [T; 3]) -> [T; 3] {
    let along = d[0] * u[0] + d[1] * u[1] + d[2] * u[2];
    [0, 1, 2].map(|k| d[k] - along * u[k])
}

pub(super) fn harmonics<T: Real>(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let degree = fields.count("degree")?.min(sh::MAX_DEGREE);
    let n = sh::coefficients(degree);
    let directions = rows::<T, 3>(fields.rows("direction")?);
    let triples = rows::<T, 3>(fields.rows("sh")?);
    if triples.len() != n * directions.len() {
        return Err(fields.wrong("'sh' does not have the triples of its degree"));
    }
    let (mut basis, mut slope, mut color) = (Vec::new(), Vec::new(), Vec::new());
    for (d, f) in directions.iter().zip(triples.chunks_exact(n)) {
        let norm = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        let unit = d.map(|v| v / norm);
        basis.extend_from_slice(&sh::basis(degree, unit)[..n]);
        let gradient = &sh::basis_gradient(degree, unit)[..n];
        slope.extend(gradient.iter().flat_map(|g| across(*g, unit)));
        color.extend((0..=degree).flat_map(|l| sh::color(l, &f[..sh::coefficients(l)], unit)));
    }
    let mut out = Outputs::default();
    out.put("basis", basis);
    out.put("tangent_gradient", slope);
    out.put("color", color);
    Ok(out)
}

pub(super) fn backward<T: Real>(
    fields: Fields<'_>,
    engine: Engine<T>,
) -> Result<Outputs, OwnError> {
    let scene = scene::<T>(fields)?;
    let picture = scene.draw(fields, engine)?;
    let upstream = Upstream {
        color: fields.picture("upstream_color")?,
        depth: Some(fields.plane::<T>("upstream_depth")?),
        opacity: Some(fields.plane::<T>("upstream_opacity")?),
    };
    let found = (engine.back)(
        &scene.map,
        &scene.camera,
        &scene.pose,
        &scene.options,
        &picture,
        &upstream,
        Par::Seq,
    )
    .map_err(|error| fields.wrong(error))?;
    let mut out = Outputs::default();
    put_gradients(&mut out, &found, "");
    out.put("d_pose", found.pose);
    out.put("d_means2d", found.means2d.into_iter().flatten());
    out.put("d_conics", found.conics.into_iter().flatten());
    out.put("d_opacities", found.opacities);
    out.put("d_colors", found.colors.into_iter().flatten());
    out.put("d_depths", found.depths);
    Ok(out)
}

/// The gradients by the parameters of the map, with a suffix to their names.
pub(super) fn put_gradients<T: Real>(out: &mut Outputs, found: &Gradients<T>, suffix: &str) {
    let flat = [
        ("means", found.means.as_flattened()),
        ("log_scales", found.log_scales.as_flattened()),
        ("quaternions", found.quaternions.as_flattened()),
        ("opacity_logits", &found.opacity_logits),
        ("sh", found.sh.as_flattened()),
    ];
    for (name, values) in flat {
        out.put(&format!("d_{name}{suffix}"), values.iter().copied());
    }
}

/// A picture times a number.
pub(super) fn scaled<T: Real>(image: &Image<T>, weight: T) -> Image<T> {
    image.map(|v| *v * weight)
}
