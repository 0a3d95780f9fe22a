//! What is drawn, and its gradients.

use garad_core::{Camera, GaussianMap, KeyframeId, Label, Par, Real, Se3, So3, sh};
use garad_golden::Inputs;
use garad_raster::{
    ClampGradient, Gradients, Projected, RasterError, RenderOptions, Rendered, Upstream,
};
use garad_slam::mapping::iteration::Engine;
use nalgebra::{Matrix3, Vector3};

use crate::convert::{channels, has, matrix, plane, reals, rotation, rows};
use crate::outputs::{Answer, Element, Error, Outputs};

/// The Gaussians of a case, all static. Without opacities and colours they are grey and half clear.
pub(crate) fn map<T: Real>(inputs: &Inputs) -> Result<GaussianMap<T>, Error> {
    let means = rows(inputs, "means")?;
    let n = means.len();
    let colored = has(inputs, "sh");
    let degree = if colored {
        inputs.count("sh_degree")?
    } else {
        0
    };
    let mut map = GaussianMap::new(degree.min(sh::MAX_DEGREE));
    map.means = means;
    map.log_scales = rows(inputs, "log_scales")?;
    map.quaternions = rows(inputs, "quaternions")?;
    map.opacity_logits = match has(inputs, "opacity_logits") {
        true => reals(inputs, "opacity_logits")?,
        false => vec![T::ZERO; n],
    };
    map.sh = match colored {
        true => rows(inputs, "sh")?,
        false => vec![[T::ZERO; 3]; n],
    };
    map.landmark = vec![None; n];
    map.parent = vec![None; n];
    map.born = vec![KeyframeId(0); n];
    map.label = vec![Label::Static; n];
    map.validate()?;
    Ok(map)
}

/// `intrinsics` and the size in `width`, `height`.
pub(crate) fn camera(inputs: &Inputs) -> Result<Camera, Error> {
    let size = (inputs.count("width")?, inputs.count("height")?);
    Ok(Camera::pinhole(size, inputs.row("intrinsics")?)?)
}

/// `camera_from_world_q` and `_t`, with a suffix.
pub(crate) fn pose(inputs: &Inputs, suffix: &str) -> Result<Se3, Error> {
    let q = inputs.row(&format!("camera_from_world_q{suffix}"))?;
    let t = inputs.row::<3>(&format!("camera_from_world_t{suffix}"))?;
    Ok(Se3::new(rotation(q)?, Vector3::from(t)))
}

fn options(inputs: &Inputs) -> Result<RenderOptions, Error> {
    let mut options = RenderOptions::default();
    if inputs.params().contains_key("clamp_gradient") {
        let known = [
            ("true", ClampGradient::True),
            ("pass_through", ClampGradient::PassThrough),
        ];
        options.clamp_gradient = inputs.choice("clamp_gradient", &known)?;
    }
    if has(inputs, "background") {
        options.background = inputs.row("background")?;
    }
    Ok(options)
}

pub(crate) struct Scene<T> {
    pub(crate) map: GaussianMap<T>,
    pub(crate) camera: Camera,
    pub(crate) pose: Se3,
    pub(crate) options: RenderOptions,
    pub(crate) par: Par,
}

impl<T: Real> Scene<T> {
    pub(crate) fn new(inputs: &Inputs, par: Par) -> Result<Self, Error> {
        Ok(Self {
            map: map(inputs)?,
            camera: camera(inputs)?,
            pose: pose(inputs, "")?,
            options: options(inputs)?,
            par,
        })
    }

    pub(crate) fn draw(&self, engine: Engine<T>) -> Result<Rendered<T>, RasterError> {
        (engine.draw)(&self.map, &self.camera, &self.pose, &self.options, self.par)
    }
}

fn put_geometry<T: Real + Element>(out: &mut Outputs, splats: &[Projected<T>]) {
    out.put("mean_px", splats.iter().map(|s| s.mean_px));
    out.put("depth_m", splats.iter().map(|s| s.depth_m));
    out.put("conic", splats.iter().map(|s| s.conic));
}

pub(crate) fn forward<T: Real + Element>(inputs: &Inputs, par: Par, engine: Engine<T>) -> Answer {
    Ok(images(&Scene::new(inputs, par)?.draw(engine)?))
}

/// The outputs of a rendered image.
pub(crate) fn images<T: Real + Element>(image: &Rendered<T>) -> Outputs {
    let mut out = Outputs::default();
    out.image("color", &image.color);
    out.image("depth", &image.depth);
    out.image("transmittance", &image.transmittance);
    out.image("contributors", &image.contributors);
    out.image("last", &image.last);
    out.put("radii", image.radii.iter().copied());
    out.put("order", image.projected.iter().map(|s| s.index));
    out.put("splat_color", image.projected.iter().map(|s| s.color));
    put_geometry(&mut out, &image.projected);
    out
}

/// The splats in the order of the map.
pub(crate) fn projection<T: Real + Element>(
    inputs: &Inputs,
    par: Par,
    engine: Engine<T>,
) -> Answer {
    let scene = Scene::<T>::new(inputs, par)?;
    let mut splats = scene.draw(engine)?.projected;
    splats.sort_by_key(|s| s.index);
    let turn = matrix(&scene.pose.rotation.matrix()).map(|row| row.map(T::from_f64));
    let shift = <[f64; 3]>::from(scene.pose.translation).map(T::from_f64);
    let p_cam = |m: &[T; 3]| {
        [0, 1, 2].map(|k| turn[k][0] * m[0] + turn[k][1] * m[1] + turn[k][2] * m[2] + shift[k])
    };
    let rotation = |q: &[T; 4]| {
        let [w, x, y, z] = q.map(T::to_f64);
        let rotation = So3::from_quaternion(w, x, y, z);
        matrix(&rotation.map_or(Matrix3::repeat(f64::NAN), |r| r.matrix()))
    };
    let mut out = Outputs::default();
    out.put("p_cam", scene.map.means.iter().map(p_cam));
    out.put("rotation", scene.map.quaternions.iter().map(rotation));
    put_geometry(&mut out, &splats);
    out.put("radius", splats.iter().map(|s| s.radius_px));
    let edges = splats.iter().map(|s| s.footprint);
    out.put("footprint", edges.map(|f| [f.x0, f.y0, f.x1, f.y1]));
    Ok(out)
}

/// d minus its part along the unit vector u.
fn across<T: Real>(d: [T; 3], u: [T; 3]) -> [T; 3] {
    let along = d[0] * u[0] + d[1] * u[1] + d[2] * u[2];
    [0, 1, 2].map(|k| d[k] - along * u[k])
}

pub(crate) fn harmonics<T: Real + Element>(inputs: &Inputs) -> Answer {
    let degree = inputs.count("degree")?.min(sh::MAX_DEGREE);
    let n = sh::coefficients(degree);
    let directions = rows::<T, 3>(inputs, "direction")?;
    let triples = rows::<T, 3>(inputs, "sh")?;
    if triples.len() != n * directions.len() {
        return Err("'sh' does not have the triples of its degree".into());
    }
    let (mut basis, mut slope, mut color) = (Vec::new(), Vec::new(), Vec::new());
    for (d, f) in directions.iter().zip(triples.chunks_exact(n)) {
        let norm = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
        let unit = d.map(|v| v / norm);
        basis.extend_from_slice(&sh::basis(degree, unit)[..n]);
        let gradient = &sh::basis_gradient(degree, unit)[..n];
        slope.extend(gradient.iter().map(|g| across(*g, unit)));
        color.extend((0..=degree).map(|l| sh::color(l, &f[..sh::coefficients(l)], unit)));
    }
    let count = directions.len();
    let mut out = Outputs::default();
    out.shaped("basis", &[count, n], basis)?;
    out.shaped("tangent_gradient", &[count, n], slope)?;
    out.shaped("color", &[count, degree + 1], color)?;
    Ok(out)
}

pub(crate) fn backward<T: Real + Element>(inputs: &Inputs, par: Par, engine: Engine<T>) -> Answer {
    let scene = Scene::<T>::new(inputs, par)?;
    let image = scene.draw(engine)?;
    gradients(&scene, &image, &upstream(inputs)?, engine)
}

pub(crate) fn upstream<T: Real>(inputs: &Inputs) -> Result<Upstream<T>, Error> {
    Ok(Upstream {
        color: channels(inputs, "upstream_color")?,
        depth: Some(plane(inputs, "upstream_depth")?),
        opacity: Some(plane(inputs, "upstream_opacity")?),
    })
}

/// The outputs of the backward pass of an image.
pub(crate) fn gradients<T: Real + Element>(
    scene: &Scene<T>,
    image: &Rendered<T>,
    upstream: &Upstream<T>,
    engine: Engine<T>,
) -> Answer {
    let Scene {
        map,
        camera,
        pose,
        options,
        par,
    } = scene;
    let found = (engine.back)(map, camera, pose, options, image, upstream, *par)?;
    let mut out = Outputs::default();
    put_gradients(&mut out, &found, map.coefficients(), "")?;
    out.one("d_pose", found.pose);
    out.put("d_means2d", found.means2d);
    out.put("d_conics", found.conics);
    out.put("d_opacities", found.opacities);
    out.put("d_colors", found.colors);
    out.put("d_depths", found.depths);
    Ok(out)
}

/// The gradients by the parameters of the map, with a suffix to their names.
pub(crate) fn put_gradients<T: Real + Element>(
    out: &mut Outputs,
    found: &Gradients<T>,
    coefficients: usize,
    suffix: &str,
) -> Result<(), Error> {
    let named = |name: &str| format!("d_{name}{suffix}");
    out.put(&named("means"), found.means.iter().copied());
    out.put(&named("log_scales"), found.log_scales.iter().copied());
    out.put(&named("quaternions"), found.quaternions.iter().copied());
    out.put(
        &named("opacity_logits"),
        found.opacity_logits.iter().copied(),
    );
    let axes = [found.means.len(), coefficients];
    out.shaped(&named("sh"), &axes, found.sh.iter().copied())
}
