//! Poses and cameras against values from mpmath and OpenCV.

use garad_core::{Camera, Distortion, Se3, So3};
use garad_golden::Case;
use nalgebra::{Matrix3, Vector2, Vector3, Vector4, Vector6};

fn vector3(values: &[f64], i: usize) -> Vector3<f64> {
    Vector3::from_column_slice(&values[3 * i..3 * i + 3])
}

fn xi(rho: &Vector3<f64>, phi: &Vector3<f64>) -> Vector6<f64> {
    Vector6::new(rho.x, rho.y, rho.z, phi.x, phi.y, phi.z)
}

/// The answers to a case, one list per output, filled row by row.
#[derive(Default)]
struct Answers(std::collections::BTreeMap<&'static str, Vec<f64>>);

impl Answers {
    /// A scalar, a vector or a matrix (row by row).
    fn push<const R: usize, const C: usize>(
        &mut self,
        name: &'static str,
        value: &nalgebra::SMatrix<f64, R, C>,
    ) {
        let rows = value.transpose();
        self.0.entry(name).or_default().extend(rows.iter());
    }

    fn problems(&self, case: &Case) -> Vec<String> {
        let missing = case
            .output_names()
            .filter(|name| !self.0.contains_key(name))
            .map(|name| format!("{}: '{name}' has no answer", case.name()));
        let wrong = self
            .0
            .iter()
            .filter_map(|(name, got)| case.check(name, got).err());
        missing.chain(wrong).collect()
    }
}

/// A rotation vector near a half turn, with the sign that is nearer to the expected one.
fn nearer_sign(log: Vector3<f64>, expected: &Vector3<f64>, free: bool) -> Vector3<f64> {
    if free && log.dot(expected) < 0.0 {
        -log
    } else {
        log
    }
}

#[test]
fn se3() {
    let mut problems = Vec::new();
    for case in Case::load_all("se3") {
        let (phis, rhos) = (case.input("phi").f64(), case.input("rho").f64());
        let matrices = case.output("rotation").f64();
        let free = case.has_flag("log_sign_free");
        let mut answers = Answers::default();
        for i in 0..phis.len() / 3 {
            let (phi, rho) = (vector3(&phis, i), vector3(&rhos, i));
            let rotation = So3::exp(&phi);
            answers.push("rotation", &rotation.matrix());
            answers.push("quaternion", &Vector4::from(rotation.quaternion()));
            answers.push("jacobian", &So3::left_jacobian(&phi));
            answers.push("jacobian_inverse", &So3::left_jacobian_inverse(&phi));
            let pose = Se3::exp(&xi(&rho, &phi));
            answers.push("translation", &pose.translation);
            answers.push("q", &Se3::left_jacobian_q(&rho, &phi));
            answers.push("adjoint", &pose.adjoint());
            // The logarithm sees a matrix of f64 numbers, not the rotation it came from.
            let matrix = Matrix3::from_row_slice(&matrices[9 * i..9 * i + 9]);
            let log = Se3::new(So3::from_matrix(&matrix), rho).log();
            let rotation_part = Vector3::new(log[3], log[4], log[5]);
            let sign = nearer_sign(rotation_part, &phi, free);
            answers.push("log_rotation", &sign);
            answers.push("log_translation", &Vector3::new(log[0], log[1], log[2]));
        }
        problems.extend(answers.problems(&case));
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

fn calibration(case: &Case) -> Camera {
    let p = |name: &str| case.param_f64(name);
    let camera = Camera {
        width: case.param_usize("width"),
        height: case.param_usize("height"),
        fx: p("fx"),
        fy: p("fy"),
        cx: p("cx"),
        cy: p("cy"),
        distortion: Distortion {
            k1: p("k1"),
            k2: p("k2"),
            p1: p("p1"),
            p2: p("p2"),
            k3: p("k3"),
        },
    };
    camera.validate().expect("a real calibration");
    camera
}

#[test]
fn camera() {
    let mut problems = Vec::new();
    for case in Case::load_all("camera") {
        let camera = calibration(&case);
        let mut answers = Answers::default();
        for pixel in case.input("pixels").f64().chunks_exact(2) {
            let pixel = Vector2::from_column_slice(pixel);
            let ideal = camera.undistort_pixel(&pixel).expect("has an inverse");
            answers.push("distorted", &camera.distort_pixel(&pixel));
            answers.push("undistorted", &ideal);
        }
        for point in case.input("points").f64().chunks_exact(3) {
            let point = Vector3::from_column_slice(point);
            let pixel = camera.project(&point).expect("in front of the camera");
            answers.push("projected", &pixel);
            answers.push("jacobian", &camera.project_jacobian(&point));
        }
        problems.extend(answers.problems(&case));
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}
