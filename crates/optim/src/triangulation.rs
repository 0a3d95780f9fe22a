//! Triangulation: a point from the pixels at which several cameras with known poses see it (E25).
//!
//! F(p) = ½ Σ ‖(π(R_k p + t_k) - u_k) / σ_k‖²
//!
//! The start is the point nearest to all rays, c_k + λ d_k with unit directions d_k, which is linear:
//!
//! Σ (I - d_k d_kᵀ)(p - c_k) = 0
//!
//! H = Σ JᵀJ at the minimum is the inverse covariance of the point. With nearly parallel rays it is small along
//! them: the depth is hardly known. The standard deviation of the inverse depth ρ = 1/z in camera k tells how
//! much, and unlike that of z it does not depend on how far away the point is.

use garad_core::{Camera, Se3};
use nalgebra::{Matrix3, SVector, Vector2, Vector3};

use crate::dense::{Dense, NormalEquations, Problem, Visitor};
use crate::error::{OptimError, positive};
use crate::lm::{LmConfig, minimise};
use crate::reprojection::{Intrinsics, MIN_DEPTH_M, Reprojection};
use crate::robust::RobustKernel;
use crate::solve::{ldlt_inverse, ldlt_solve};

/// A point as one camera sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointView {
    /// Pose of the camera.
    pub camera_from_world: Se3,
    /// Ideal pixel.
    pub uv_px: Vector2<f64>,
    /// Standard deviation of each coordinate, px.
    pub sigma_px: f64,
}

/// A point and what is known of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TriangulatedPoint {
    /// Position, metres.
    pub p_world: Vector3<f64>,
    /// H⁻¹, m².
    pub covariance: Matrix3<f64>,
    /// ‖r‖² of each view with the largest: χ² with 2 degrees of freedom.
    pub largest_chi2: f64,
}

impl TriangulatedPoint {
    /// What views say of a point at a given position; `None` if one has it behind the camera or together
    /// they do not determine it.
    #[must_use]
    pub fn at(p_world: Vector3<f64>, camera: &Camera, views: &[PointView]) -> Option<Self> {
        let problem = PointProblem::new(camera, views);
        if !problem.sees(&p_world) {
            return None;
        }
        let mut equations = NormalEquations::default();
        problem.blocks(&p_world, &mut equations);
        let chi2 = views.iter().map(|view| problem.chi2(view, &p_world));
        Some(Self {
            p_world,
            covariance: ldlt_inverse(&equations.full_hessian()).ok()?,
            largest_chi2: chi2.fold(0.0, f64::max),
        })
    }

    /// Inverse depth in a camera and its standard deviation, 1/m: σ_ρ = σ_z / z².
    #[must_use]
    pub fn inverse_depth(&self, camera_from_world: &Se3) -> (f64, f64) {
        let z = (*camera_from_world * self.p_world).z;
        let axis = camera_from_world.rotation.matrix().row(2).transpose();
        let sigma_z = axis.dot(&(self.covariance * axis)).sqrt();
        (1.0 / z, sigma_z / (z * z))
    }
}

/// Steps of Levenberg-Marquardt: the start is near where the rays cross, and a quadratic is left.
const ITERATIONS: usize = 10;

/// The most likely point behind the pixels of at least two views; `None` if their rays do not meet in front of
/// all cameras.
///
/// # Errors
/// [`OptimError`] for fewer than two views, a number that is not finite, a σ that is not positive.
///
/// # Example
/// ```
/// use garad_core::{Camera, Se3, So3};
/// use garad_optim::{PointView, triangulate};
/// use nalgebra::Vector3;
/// let camera = Camera::pinhole((640, 480), [500.0, 500.0, 320.0, 240.0]).unwrap();
/// let point = Vector3::new(1.0, 0.5, 10.0);
/// let views = [0.0, -0.5].map(|x| {
///     let camera_from_world = Se3::new(So3::identity(), Vector3::new(x, 0.0, 0.0));
///     let uv_px = camera.project(&(camera_from_world * point)).unwrap();
///     PointView { camera_from_world, uv_px, sigma_px: 1.0 }
/// });
/// let found = triangulate(&camera, &views).unwrap().expect("the rays cross");
/// assert!((found.p_world - point).norm() < 1e-6);
/// // σ_ρ = √2 σ / (f b): two pixels, half a metre apart.
/// let (rho, sigma) = found.inverse_depth(&views[0].camera_from_world);
/// assert!((rho - 0.1).abs() < 1e-9 && (sigma - 2f64.sqrt() / 250.0).abs() < 1e-6);
/// ```
pub fn triangulate(
    camera: &Camera,
    views: &[PointView],
) -> Result<Option<TriangulatedPoint>, OptimError> {
    const NEEDED: usize = 2;
    let got = views.len();
    if got < NEEDED {
        let needed = NEEDED;
        return Err(OptimError::TooFewObservations { got, needed });
    }
    for (index, view) in views.iter().enumerate() {
        if !(view.uv_px.iter().all(|v| v.is_finite()) && view.camera_from_world.is_finite()) {
            let what = "view";
            return Err(OptimError::NotFinite { what, index });
        }
        positive("sigma_px of view", index, view.sigma_px)?;
    }
    let problem = PointProblem::new(camera, views);
    let Some(start) = nearest_to_rays(camera, views).filter(|p| problem.sees(p)) else {
        return Ok(None);
    };
    let config = LmConfig {
        iterations: ITERATIONS,
        ..LmConfig::default()
    };
    let (p_world, _) = minimise(&Dense(&problem), start, &config);
    Ok(TriangulatedPoint::at(p_world, camera, views))
}

/// The point with the least sum of squared distances to the views' rays; `None` if they are parallel.
fn nearest_to_rays(camera: &Camera, views: &[PointView]) -> Option<Vector3<f64>> {
    let mut a = Matrix3::zeros();
    let mut b = Vector3::zeros();
    for view in views {
        let world_from_camera = view.camera_from_world.inverse();
        let direction = world_from_camera.rotation * camera.unproject(&view.uv_px, 1.0);
        let d = direction / direction.norm();
        let across = Matrix3::identity() - d * d.transpose();
        a += across;
        b += across * world_from_camera.translation;
    }
    let p = ldlt_solve(&a, &b).ok()?;
    p.iter().all(|v| v.is_finite()).then_some(p)
}

struct PointProblem<'a> {
    intrinsics: Intrinsics,
    views: &'a [PointView],
}

impl<'a> PointProblem<'a> {
    fn new(camera: &Camera, views: &'a [PointView]) -> Self {
        let intrinsics = Intrinsics::new(camera, 0.0);
        Self { intrinsics, views }
    }

    fn sees(&self, p_world: &Vector3<f64>) -> bool {
        let mut views = self.views.iter();
        views.all(|view| (view.camera_from_world * *p_world).z >= MIN_DEPTH_M)
    }

    fn chi2(&self, view: &PointView, p_world: &Vector3<f64>) -> f64 {
        let p_cam = view.camera_from_world * *p_world;
        reprojection(view).chi2(&self.intrinsics, &p_cam)
    }
}

fn reprojection(view: &PointView) -> Reprojection {
    Reprojection {
        uv_px: view.uv_px,
        sigma_px: view.sigma_px,
        depth: None,
    }
}

impl Problem<3> for PointProblem<'_> {
    type State = Vector3<f64>;

    fn blocks(&self, p_world: &Vector3<f64>, visitor: &mut impl Visitor<3>) {
        for view in self.views {
            let p_cam = view.camera_from_world * *p_world;
            if p_cam.z < MIN_DEPTH_M {
                return visitor.forbid();
            }
            let seen = reprojection(view);
            let residual = seen.residual2(&self.intrinsics, &p_cam);
            let rotation = view.camera_from_world.rotation.matrix();
            visitor.block(RobustKernel::None, &residual, || {
                seen.point_jacobian2(&self.intrinsics, &p_cam) * rotation
            });
        }
    }

    fn step(&self, p_world: &Vector3<f64>, step: &SVector<f64, 3>) -> Vector3<f64> {
        p_world + step
    }
}

#[cfg(test)]
mod tests {
    use garad_core::{Rng, So3};
    use nalgebra::Vector6;

    use super::*;
    use crate::check::check_jacobian;

    fn camera() -> Camera {
        Camera::pinhole((640, 480), [500.0, 520.0, 320.0, 240.0]).expect("valid")
    }

    fn view(camera: &Camera, camera_from_world: Se3, p: &Vector3<f64>) -> PointView {
        PointView {
            camera_from_world,
            uv_px: camera.project(&(camera_from_world * *p)).expect("in front"),
            sigma_px: 0.5,
        }
    }

    fn three_views(camera: &Camera, p: &Vector3<f64>) -> Vec<PointView> {
        let poses = [
            Vector6::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            Vector6::new(-0.4, 0.1, 0.2, 0.05, -0.1, 0.02),
            Vector6::new(0.3, -0.2, 0.1, -0.02, 0.08, 0.1),
        ];
        poses.map(|xi| view(camera, Se3::exp(&xi), p)).to_vec()
    }

    #[test]
    fn exact_pixels_give_the_point() {
        let (camera, p) = (camera(), Vector3::new(-1.0, 0.7, 6.0));
        let found = triangulate(&camera, &three_views(&camera, &p));
        let found = found.expect("valid").expect("crossing rays");
        assert!((found.p_world - p).norm() < 1e-7, "{:?}", found.p_world);
        assert!(found.largest_chi2 < 1e-12);
    }

    #[test]
    fn jacobian_is_the_derivative() {
        let (camera, p) = (camera(), Vector3::new(-1.0, 0.7, 6.0));
        let views = three_views(&camera, &p);
        let problem = PointProblem::new(&camera, &views);
        let beside = p + Vector3::new(0.1, -0.2, 0.5);
        let check = check_jacobian(&problem, &beside, 3e-4).expect("all in front");
        assert!(check.elements == 18 && check.worst < 1e-8, "{check:?}");
    }

    /// The scatter of points from noisy pixels is the covariance they come with.
    #[test]
    fn covariance_is_the_scatter() {
        let (camera, p) = (camera(), Vector3::new(-1.0, 0.7, 6.0));
        let views = three_views(&camera, &p);
        let exact = triangulate(&camera, &views).expect("valid").expect("found");
        let mut rng = Rng::new(3);
        let (mut scatter, n) = (Matrix3::zeros(), 4000);
        for _ in 0..n {
            let mut noisy = views.clone();
            for view in &mut noisy {
                view.uv_px += view.sigma_px * Vector2::new(rng.normal(), rng.normal());
            }
            let found = triangulate(&camera, &noisy).expect("valid").expect("found");
            let off = found.p_world - p;
            scatter += off * off.transpose() / f64::from(n);
        }
        let relative = (scatter - exact.covariance).norm() / exact.covariance.norm();
        assert!(relative < 0.06, "{relative}: 4000 draws leave about 3 %");
    }

    #[test]
    fn rays_that_do_not_meet_in_front_give_nothing() {
        let camera = camera();
        let at = |x: f64| Se3::new(So3::identity(), Vector3::new(-x, 0.0, 0.0));
        let seen_at = |x: f64, u: f64| PointView {
            camera_from_world: at(x),
            uv_px: Vector2::new(u, 240.0),
            sigma_px: 1.0,
        };
        let cases = [
            ("parallel", [seen_at(0.0, 320.0), seen_at(0.5, 320.0)]),
            ("diverging", [seen_at(0.0, 320.0), seen_at(0.5, 330.0)]),
            ("one centre", [seen_at(0.0, 320.0), seen_at(0.0, 320.0)]),
        ];
        for (name, views) in cases {
            assert_eq!(triangulate(&camera, &views), Ok(None), "{name}");
        }
        let one = triangulate(&camera, &[seen_at(0.0, 1.0)]);
        assert!(matches!(one, Err(OptimError::TooFewObservations { .. })));
        let nan = [seen_at(0.0, f64::NAN), seen_at(0.5, 1.0)];
        assert!(matches!(
            triangulate(&camera, &nan),
            Err(OptimError::NotFinite { index: 0, .. })
        ));
    }

    /// A point 5 cm before the second camera is seen, one nearer is not; χ² is the largest of the views', each by
    /// its own σ: 3 px of σ = 1.5 px and 2 px of σ = 0.5 px.
    #[test]
    fn gates_and_chi2_by_hand() {
        let camera = camera();
        let seen = |z: f64, off_px: f64, sigma_px: f64| PointView {
            camera_from_world: Se3::new(So3::identity(), Vector3::new(0.0, 0.0, z)),
            uv_px: Vector2::new(320.0, 240.0 + off_px),
            sigma_px,
        };
        let p = Vector3::new(0.0, 0.0, 1.0);
        let beside = PointView {
            camera_from_world: Se3::new(So3::identity(), Vector3::new(-0.5, 0.0, 0.0)),
            uv_px: Vector2::new(70.0, 240.0),
            sigma_px: 1.0,
        };
        for (z, found) in [(-0.95, true), (-0.9501, false)] {
            let views = [seen(z, 0.0, 1.0), beside];
            let at = TriangulatedPoint::at(p, &camera, &views);
            assert_eq!(at.is_some(), found, "{} m before the second", 1.0 + z);
        }
        let views = [seen(0.0, 3.0, 1.5), seen(0.5, -2.0, 0.5), beside];
        let at = TriangulatedPoint::at(p, &camera, &views).expect("seen");
        assert!((at.largest_chi2 - 16.0).abs() < 1e-12, "{at:?}");
        let wrong = triangulate(
            &camera,
            &[
                beside,
                PointView {
                    sigma_px: 0.0,
                    ..beside
                },
            ],
        );
        assert!(
            matches!(wrong, Err(OptimError::NotPositive { index: 1, .. })),
            "{wrong:?}"
        );
    }

    /// One point straight ahead at z = 4, seen twice with σ = 2 px and once from the side with σ = 1 px: H has fx²/z²
    /// and fy²/z² over the variances, and (fx x/z²)² along z.
    #[test]
    fn covariance_by_hand() {
        let camera = camera();
        let p = Vector3::new(0.0, 0.0, 4.0);
        let ahead = PointView {
            sigma_px: 2.0,
            ..view(&camera, Se3::identity(), &p)
        };
        let aside = |x: f64| PointView {
            sigma_px: 1.0,
            ..view(
                &camera,
                Se3::new(So3::identity(), Vector3::new(x, 0.0, 0.0)),
                &p,
            )
        };
        // Two cameras at ± 1.6 m: the terms of x with z cancel.
        let views = [ahead, ahead, aside(1.6), aside(-1.6)];
        let at = TriangulatedPoint::at(p, &camera, &views).expect("seen");
        let h = [
            (2.0 / 4.0 + 2.0) * 125.0 * 125.0,
            (2.0 / 4.0 + 2.0) * 130.0 * 130.0,
            2.0 * 50.0 * 50.0,
        ];
        let expected = Matrix3::from_diagonal(&Vector3::from(h.map(|h| 1.0 / h)));
        assert!(
            (at.covariance - expected).amax() < 1e-15,
            "{}",
            at.covariance
        );
        // Turned by 0.3 about x, then by 0.5 about y: its axis is (-sin b, cos b sin a, cos b cos a).
        let rotation = So3::exp(&(Vector3::y() * 0.5)) * So3::exp(&(Vector3::x() * 0.3));
        let turned = Se3::new(rotation, Vector3::new(0.0, 0.0, 1.0));
        let (rho, sigma) = at.inverse_depth(&turned);
        let ((sa, ca), (sb, cb)) = (libm::sincos(0.3), libm::sincos(0.5));
        let z = 4.0 * cb * ca + 1.0;
        assert!((rho - 1.0 / z).abs() < 1e-12, "{rho}");
        let axis = [-sb, cb * sa, cb * ca];
        let variance = (0..3).fold(0.0, |sum, i| sum + axis[i] * axis[i] / h[i]);
        let expected = variance.sqrt() / (z * z);
        assert!((sigma - expected).abs() < 1e-12, "{sigma} {expected}");
    }
}
