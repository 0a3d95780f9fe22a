//! Single stages of the mapper against closed forms.

use garad_core::{GaussianMap, KeyframeId, NewGaussian, Se3, So3};
use garad_slam::mapping::loop_correction::apply_loop_correction;
use nalgebra::Vector3;
use std::f64::consts::FRAC_PI_2;

/// A Gaussian turned a quarter about x, in a world that is turned a quarter about z: the turn of the
/// world comes after its own, Rz Rx. In the other order its axes would end elsewhere.
#[test]
fn a_gaussian_follows_its_keyframe_with_its_axes() {
    let quarter = |axis: Vector3<f64>| So3::exp(&(axis * FRAC_PI_2));
    let mut map = GaussianMap::<f32>::new(0);
    map.push(&NewGaussian {
        mean: [1.0, 0.0, 0.0],
        sigma_m: 0.1,
        opacity: 0.5,
        color: [0.5; 3],
        landmark: None,
        born: KeyframeId(0),
    });
    map.quaternions[0] = quarter(Vector3::x())
        .quaternion()
        .map(|c| garad_core::Real::from_f64(2.0 * c));
    let motion = Se3::new(quarter(Vector3::z()), Vector3::new(0.0, 0.0, 3.0));
    apply_loop_correction(&mut map, &[motion]);

    let mean = Vector3::from(map.means[0].map(f64::from));
    assert!(
        (mean - Vector3::new(0.0, 1.0, 3.0)).norm() < 1e-6,
        "x goes to y: {mean}"
    );
    let [w, x, y, z] = map.quaternions[0].map(f64::from);
    let length = (w * w + x * x + y * y + z * z).sqrt();
    assert!((length - 2.0).abs() < 1e-6, "the length stays: {length}");
    // Its own third axis: Rx takes z to -y, Rz takes -y to x.
    let axis = So3::from_quaternion(w, x, y, z).expect("a rotation") * Vector3::z();
    assert!((axis - Vector3::x()).norm() < 1e-6, "{axis}");
}
