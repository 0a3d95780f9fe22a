//! Poses and cameras.

use garad_core::undistort::Undistortion;
use garad_core::{Camera, Distortion, Par, RgbImage, Se3, So3};
use garad_golden::{InputError, Inputs};
use nalgebra::{Vector2, Vector3, Vector6};

use crate::convert::{gray, matrix, of_size, plane, vectors};
use crate::outputs::{Answer, Error, Outputs};

pub(crate) fn se3(inputs: &Inputs) -> Answer {
    let (phis, rhos) = (vectors::<3>(inputs, "phi")?, vectors::<3>(inputs, "rho")?);
    if rhos.len() != phis.len() {
        return Err("phi and rho differ in number".into());
    }
    let rotations = || phis.iter().map(So3::exp);
    let pairs = || phis.iter().zip(&rhos);
    let poses = || {
        pairs().map(|(phi, rho)| Se3::exp(&Vector6::new(rho.x, rho.y, rho.z, phi.x, phi.y, phi.z)))
    };
    // The logarithm is taken of matrices of f64 numbers. Near a half turn the sign of the axis is free.
    let free = inputs.has_flag("log_sign_free");
    let logs = pairs().map(|(phi, rho)| {
        let log = Se3::new(So3::from_matrix(&So3::exp(phi).matrix()), *rho).log();
        let turn = Vector3::new(log[3], log[4], log[5]);
        let sign = if free && turn.dot(phi) < 0.0 {
            -1.0
        } else {
            1.0
        };
        (<[f64; 3]>::from(turn * sign), [log[0], log[1], log[2]])
    });
    let (log_rotations, log_translations): (Vec<[f64; 3]>, Vec<[f64; 3]>) = logs.unzip();
    let mut out = Outputs::default();
    out.put("rotation", rotations().map(|r| matrix(&r.matrix())));
    out.put("quaternion", rotations().map(|r| r.quaternion()));
    out.put(
        "jacobian",
        phis.iter().map(|phi| matrix(&So3::left_jacobian(phi))),
    );
    out.put(
        "jacobian_inverse",
        phis.iter()
            .map(|phi| matrix(&So3::left_jacobian_inverse(phi))),
    );
    out.put(
        "translation",
        poses().map(|p| <[f64; 3]>::from(p.translation)),
    );
    out.put(
        "q",
        pairs().map(|(phi, rho)| matrix(&Se3::left_jacobian_q(rho, phi))),
    );
    out.put("adjoint", poses().map(|p| matrix(&p.adjoint())));
    out.put("log_rotation", log_rotations);
    out.put("log_translation", log_translations);
    Ok(out)
}

pub(crate) fn calibration(inputs: &Inputs) -> Result<Camera, Error> {
    let n = |name| inputs.number(name);
    let camera = Camera {
        width: inputs.count("width")?,
        height: inputs.count("height")?,
        fx: n("fx")?,
        fy: n("fy")?,
        cx: n("cx")?,
        cy: n("cy")?,
        distortion: Distortion {
            k1: n("k1")?,
            k2: n("k2")?,
            p1: n("p1")?,
            p2: n("p2")?,
            k3: n("k3")?,
        },
    };
    camera.validate()?;
    Ok(camera)
}

pub(crate) fn camera(inputs: &Inputs) -> Answer {
    let camera = calibration(inputs)?;
    let pixel = |found: Option<Vector2<f64>>| found.map_or([f64::NAN; 2], <[f64; 2]>::from);
    let (pixels, points) = (
        vectors::<2>(inputs, "pixels")?,
        vectors::<3>(inputs, "points")?,
    );
    let mut out = Outputs::default();
    out.put(
        "distorted",
        pixels.iter().map(|p| pixel(Some(camera.distort_pixel(p)))),
    );
    out.put(
        "undistorted",
        pixels.iter().map(|p| pixel(camera.undistort_pixel(p))),
    );
    out.put("projected", points.iter().map(|p| pixel(camera.project(p))));
    out.put(
        "jacobian",
        points.iter().map(|p| matrix(&camera.project_jacobian(p))),
    );
    Ok(out)
}

/// The colours of an image of bytes, of this camera's size.
pub(crate) fn colors(inputs: &Inputs, camera: &Camera) -> Result<RgbImage, InputError> {
    let pixels = inputs.bytes("rgb")?.as_chunks::<3>().0.to_vec();
    let image = RgbImage::from_vec(camera.width, camera.height, pixels);
    image.ok_or_else(|| inputs.shape_is_not("rgb", "the camera's image in three channels"))
}

pub(crate) fn undistort(inputs: &Inputs, par: Par) -> Answer {
    let camera = calibration(inputs)?;
    let straight = Undistortion::new(&camera);
    let depth = of_size(inputs, "depth", plane::<f32>(inputs, "depth")?, &camera)?;
    let mask = of_size(inputs, "mask", gray(inputs, "mask")?, &camera)?;
    let mut out = Outputs::default();
    out.image("color", &straight.color(&colors(inputs, &camera)?, par));
    out.image("nearest_depth", &straight.nearest(&depth, 0.0));
    out.image("nearest_mask", &straight.nearest(&mask, 255));
    out.image("unseen", &straight.unseen());
    Ok(out)
}
