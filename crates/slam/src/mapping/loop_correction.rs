//! Loop correction: Gaussians move with the keyframe that made them when a loop is closed.

use garad_core::sh_rotation::ShRotation;
use garad_core::{GaussianMap, Se3, So3};
use nalgebra::Vector3;

/// Moves every Gaussian as its keyframe was moved: for C = `moved[born]`, after_from_before in the
/// world,
///
/// μ ← C μ,   q ← C.R q,   sh ← M(C.R) sh (E21)
///
/// Shapes and opacities stay, and each Gaussian has the same colours as before for the moved camera.
///
/// # Numerics
/// f64, rounded to f32 at the end. Gaussians of keyframes that are not in the list stay.
pub fn apply_loop_correction(map: &mut GaussianMap, moved: &[Se3]) {
    if moved.is_empty() {
        return;
    }
    let n = map.coefficients();
    let turns: Vec<_> = (moved.iter().map(|m| ShRotation::new(&m.rotation))).collect();
    for i in 0..map.len() {
        let Some(motion) = moved.get(map.born[i].index()) else {
            continue;
        };
        if n > 1 {
            turns[map.born[i].index()].turn(&mut map.sh[i * n..(i + 1) * n]);
        }
        let mean = *motion * Vector3::from(map.means[i].map(f64::from));
        map.means[i] = to_f32([mean.x, mean.y, mean.z]);
        let q = map.quaternions[i].map(f64::from);
        let length = q.iter().fold(0.0, |sum, c| sum + c * c).sqrt();
        // Training leaves quaternions at any length but 0, and the gradient depends on it.
        if let Some(own) = So3::from_quaternion(q[0], q[1], q[2], q[3]) {
            let turned = (motion.rotation * own).quaternion();
            map.quaternions[i] = to_f32(turned.map(|c| c * length));
        }
    }
}

#[allow(clippy::cast_possible_truncation, reason = "the map is in f32")]
fn to_f32<const N: usize>(v: [f64; N]) -> [f32; N] {
    v.map(|c| c as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::{KeyframeId, NewGaussian};

    fn gaussian(born: u32) -> NewGaussian {
        NewGaussian {
            mean: [1.0, 2.0, 3.0],
            sigma_m: 0.1,
            opacity: 0.5,
            color: [0.5; 3],
            landmark: None,
            born: KeyframeId(born),
        }
    }

    #[test]
    fn each_gaussian_moves_with_its_own_keyframe() {
        let mut map = GaussianMap::new(0);
        for born in 0..3 {
            map.push(&gaussian(born));
        }
        map.quaternions[1] = [0.0, 0.0, 0.0, 2.0]; // half a turn about z, length 2
        map.raise_sh_degree(1);
        for (k, sh) in map.sh.iter_mut().enumerate() {
            *sh = [1.0, 10.0, 100.0].map(|c| c * [0.5, 0.25, -0.75, 0.125][k % 4]);
        }
        let quarter = So3::exp(&Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2));
        let moved = [
            Se3::identity(),
            Se3::new(quarter, Vector3::new(0.0, 0.0, 1.0)),
        ];
        let before = map.clone();
        apply_loop_correction(&mut map, &moved);
        let near = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
        let start = [1.0, 2.0, 3.0];
        assert!(near(&map.means[0], &start), "its keyframe stays");
        assert!(near(&map.means[2], &start), "its keyframe is not listed");
        assert!(near(&map.means[1], &[-2.0, 1.0, 4.0]), "{:?}", map.means[1]);
        // 180° + 90° about z: cos 135° and sin 135°, times the length, up to the common sign.
        let half = 2.0f32.sqrt();
        let q = map.quaternions[1];
        assert!(
            near(&q, &[-half, 0.0, 0.0, half]) || near(&q, &[half, 0.0, 0.0, -half]),
            "{q:?}"
        );
        assert!(
            near(&map.log_scales[1], &before.log_scales[1]),
            "shapes stay"
        );
        // The basis of degree 1 is -y, z, -x: a lobe along x is one along y now, and one along y one along -x.
        for (k, (of, sign)) in [(0, 1.0), (3, 1.0), (2, 1.0), (1, -1.0)]
            .into_iter()
            .enumerate()
        {
            let expected = before.sh[4 + of].map(|c| c * sign);
            let off = map.sh[4 + k]
                .iter()
                .zip(expected)
                .map(|(a, b)| (a - b).abs());
            assert!(
                off.fold(0.0, f32::max) < 1e-4,
                "coefficient {k}: {:?}",
                map.sh[4 + k]
            );
        }
        let others = |map: &GaussianMap| [map.sh[..4].to_vec(), map.sh[8..].to_vec()];
        assert_eq!(others(&map), others(&before), "colours of those that stay");
        let moved = map.clone();
        apply_loop_correction(&mut map, &[]);
        assert_eq!(map, moved, "no loop, nothing moves");
    }

    /// A Gaussian and the camera before it, turned together: the same image.
    #[test]
    fn a_turned_gaussian_looks_the_same_to_a_turned_camera() {
        use garad_core::{Camera, Par};
        use garad_raster::{RenderOptions, render};
        use nalgebra::Vector6;

        let mut map = GaussianMap::new(0);
        map.push(&gaussian(0));
        map.raise_sh_degree(3);
        for (k, sh) in map.sh.iter_mut().enumerate().skip(1) {
            *sh = [0.05, -0.04, 0.03].map(|c| if k % 3 == 0 { -c } else { c });
        }
        let camera = Camera::pinhole((32, 24), [30.0, 30.0, 15.5, 11.5]).expect("valid");
        let camera_from_world = Se3::new(So3::identity(), Vector3::new(-1.1, -1.9, -2.0));
        let draw = |map: &GaussianMap, pose: &Se3| {
            let options = RenderOptions::default();
            let rendered = render(&map.cast::<f64>(), &camera, pose, &options, Par::Seq);
            rendered.expect("rendered").color
        };
        let before = draw(&map, &camera_from_world);
        let motion = Se3::exp(&Vector6::new(0.4, -0.2, 0.3, 0.5, -0.8, 1.1));
        let unturned = map.sh.clone();
        apply_loop_correction(&mut map, &[motion]);
        let pose = camera_from_world * motion.inverse();
        let apart = |map: &GaussianMap| {
            let after = draw(map, &pose);
            let pairs = before.data().as_flattened().iter();
            let all = pairs.zip(after.data().as_flattened());
            all.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
        };
        let off = apart(&map);
        assert!(off < 1e-5, "f32 parameters: {off}");
        map.sh = unturned;
        let off = apart(&map);
        assert!(off > 1e-2, "colours left behind would show: {off}");
    }
}
