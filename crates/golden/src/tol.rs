//! The one place with tolerances. `case.json` names an entry; the number lives here, with its
//! reason.
//!
//! To add one, add a line to its stage's block. A tolerance says how far a *correct* implementation may
//! be from the expected value; it is derived from conditioning or measured and then rounded up
//! by less than 4, never widened to make a case pass.

/// How two values are compared. Two NaNs are equal, and so are two infinities of one sign;
/// against anything else they are infinitely far away.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Class {
    /// The same number: ids, orders, labels, integers, bits (0.0 and -0.0 are the same).
    Exact,
    /// At most this many representable numbers apart, in the type of the expected tensor.
    Ulp(u64),
    /// |got - expected| ≤ abs + rel |expected|, per element.
    AbsRel {
        /// In the tensor's unit.
        abs: f64,
        /// Relative to the element.
        rel: f64,
    },
    /// |got - expected| ≤ abs + rel max |expected|: elements that cancel are judged by the
    /// largest of the tensor.
    Vector {
        /// In the tensor's unit.
        abs: f64,
        /// Relative to the largest element.
        rel: f64,
    },
    /// For values behind a threshold: all within `hard`, and at most `share` of them beyond
    /// `tight`.
    Banded {
        /// Away from the threshold.
        tight: f64,
        /// Share of elements in the band, in [0, 1].
        share: f64,
        /// Anywhere.
        hard: f64,
    },
    /// For gradients, each Gaussian judged by itself: a row is everything behind the first index, and its size the
    /// largest of its |expected|. |got - expected| ≤ rel size + floor scale for all but `share` of the rows, and
    /// at most `hard` times that in any.
    ///
    /// The scale of row i of output X is number i of the input `scale_X`: what the row is a sum of, without
    /// signs. In a case without it, it is for all rows the lower median of the sizes that are not zero.
    Rows {
        /// Relative to the size of the row.
        rel: f64,
        /// Relative to its scale: a row that cancels is less precise than its size says.
        floor: f64,
        /// Share of rows that may be beyond the bound, in [0, 1].
        share: f64,
        /// How many times the bound no row may exceed.
        hard: f64,
    },
}

/// An entry of the table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerance {
    /// `STAGE.QUANTITY`, as `case.json` says it.
    pub name: &'static str,
    /// Comparison and its numbers.
    pub class: Class,
    /// Why these numbers.
    pub reason: &'static str,
}

const fn abs_rel(name: &'static str, abs: f64, rel: f64, reason: &'static str) -> Tolerance {
    Tolerance {
        name,
        class: Class::AbsRel { abs, rel },
        reason,
    }
}

const fn vector(name: &'static str, abs: f64, rel: f64, reason: &'static str) -> Tolerance {
    Tolerance {
        name,
        class: Class::Vector { abs, rel },
        reason,
    }
}

const fn by_row(
    name: &'static str,
    [rel, floor, share, hard]: [f64; 4],
    reason: &'static str,
) -> Tolerance {
    Tolerance {
        name,
        class: Class::Rows {
            rel,
            floor,
            share,
            hard,
        },
        reason,
    }
}

/// Every tolerance.
#[rustfmt::skip]
pub const TABLE: &[Tolerance] = &[
    // any stage
    Tolerance { name: "exact", class: Class::Exact, reason: "ids, orders, labels, bits" },
    Tolerance { name: "ulp1", class: Class::Ulp(1), reason: "one rounding, by another route" },
    // se3
    abs_rel("se3.rotation", 1e-15, 0.0, "entries of R, J, q in [-1, 1]: a few roundings of 1.1e-16"),
    vector("se3.translation", 2e-15, 2e-15, "J rho: three products and the error of J"),
    abs_rel("se3.jacobian_inverse", 4e-15, 0.0, "theta < 3: entries up to 3, cot(theta/2) form"),
    vector("se3.jacobian_inverse_near_pi", 0.0, 1e-14, "theta to pi: relative to the largest entry"),
    vector("se3.translation_log", 0.0, 1e-14, "J^-1 rho"),
    vector("se3.q", 0.0, 4e-15, "sum of four terms of size |rho|"),
    vector("se3.adjoint", 1e-15, 4e-15, "R beside t^ R"),
    abs_rel("se3.log", 1e-15, 1e-15, "components of a rotation vector, theta < 3"),
    abs_rel("se3.log_near_pi", 2e-15, 0.0, "theta to pi - 1e-7: |phi| = pi has a spacing of 4.4e-16"),
    // camera
    abs_rel("camera.jacobian", 1e-13, 1e-15, "a few products and one division"),
    abs_rel("camera.pixel", 2e-13, 1e-15, "a pixel is a difference of numbers of size 500, spacing 1.1e-13"),
    abs_rel("camera.undistorted", 1e-12, 0.0, "as pixels, through a Newton step"),
    // undistort and image_pyramid: bytes over 255, in f32 by definition
    abs_rel("undistort.color", 3e-7, 0.0, "measured 1.2e-7: two weights and three interpolations in f32, of numbers up to 1: five roundings of 6e-8"),
    abs_rel("image_pyramid.color", 3e-7, 0.0, "measured 1.2e-7: as undistort.color, then two halvings, each sums of positive numbers"),
    // projection_covariance: the rest is raster's
    vector("projection.p_cam", 0.0, 2e-15, "three products and their sum"),
    // sh: the basis of degree 3 has terms of size 3 that cancel
    abs_rel("sh.basis", 1e-15, 0.0, "measured 2.2e-16: three products and a sum, coefficients up to 3"),
    abs_rel("sh.gradient", 2e-15, 0.0, "measured 3.3e-16: derivatives up to 5, projected onto the tangent plane"),
    abs_rel("sh.color", 1.5e-15, 0.0, "measured 3.3e-16: a sum of 16 products of size 0.5"),
    // knn_scale
    abs_rel("knn_scale.scale", 0.0, 1e-15, "measured 2.9e-16: squares of differences, a sum of positive terms, a root"),
    // train_step: gradients through the losses, then Adam
    abs_rel("train_step.loss", 0.0, 4e-15, "measured 1e-15: sums over a thousand pixels"),
    vector("train_step.gradient", 0.0, 1.5e-14, "measured 3.3e-15: losses.gradient on an image with texture, through the backward pass"),
    by_row("train_step.rows", [1e-9, 1e-9, 1e-2, 1e3], "f64, at size: losses.gradient through the backward pass, by rows; the scale is the median row"),
    by_row("train_step.f32.rows", [1e-3, 1e-3, 2e-2, 3e2], "as raster_backward.f32.rows, without its error analysis; signs of an L1 loss near 0 are other gradients"),
    abs_rel("train_step.parameter", 1e-14, 0.0, "measured 2e-15: a step of at most 0.25 whose size is the quotient of two gradients"),
    // train_run: Adam in f32 over sixty iterations, against f64
    abs_rel("train_run.rate", 0.0, 1e-15, "measured 4.4e-16: a product or a quotient; the extent is a distance"),
    abs_rel("train_run.parameter", 6e-6, 0.0, "measured 1.9e-6, in f32: a rounding of 1.2e-7 of numbers of size 3 in each of sixty steps"),
    vector("train_run.moment", 0.0, 1e-6, "measured 4.5e-7, in f32: running means, each a few roundings of the largest gradient"),
    abs_rel("train_run.sum", 0.0, 6e-7, "measured 1.9e-7, in f32: a sum of up to 25 positive numbers"),
    // raster, forward in f64
    abs_rel("raster.color", 1e-13, 1e-13, "measured 1e-14: alpha is conditioned like its power, |power| < 6, and power like the mean over the thinnest sigma"),
    vector("raster.depth", 0.0, 1e-13, "as colour, in metres"),
    abs_rel("raster.transmittance", 1e-13, 1e-13, "as colour; a product, so relative errors add up"),
    abs_rel("raster.mean_px", 1e-13, 1e-14, "two products and a division, measured 4e-14 px"),
    abs_rel("raster.depth_m", 0.0, 4e-15, "three products and their sum"),
    vector("raster.conic", 0.0, 4e-15, "measured 1e-15; a plain determinant loses 1e-11 on half-axes 1:1000"),
    // raster, forward in f32 against f64: 8 times what a rewrite of the formulas in f32 was measured to lose
    vector("raster.f32.color", 0.0, 2.3e-5, "8 x 2.8e-6, away from the cuts"),
    vector("raster.f32.color_needles", 0.0, 9.6e-5, "2 x 4.8e-5, with the exponent a dx^2 + 2 b dx dy + c dy^2 that CUDA rasterizers have: its terms cancel along a needle"),
    vector("raster.f32.transmittance", 0.0, 5.6e-5, "8 x 7.0e-6, away from the cuts"),
    vector("raster.f32.depth", 0.0, 5.3e-5, "8 x 6.6e-6, away from the cuts"),
    vector("raster.f32.mean_px", 0.0, 2.1e-6, "8 x 2.6e-7"),
    vector("raster.f32.depth_m", 0.0, 1.1e-6, "8 x 1.3e-7"),
    vector("raster.f32.conic", 0.0, 4.6e-6, "8 x 5.7e-7"),
    Tolerance { name: "raster.f32.flips", class: Class::Banded { tight: 1e-4, share: 2e-2, hard: 1e-2 }, reason: "a splat that crosses 1/255 moves a channel by up to 1/255 and what lies behind it" },
    // raster, forward in f32 of cases made at size: coordinates are ten times those of the committed ones
    vector("raster.f32.color_made", 0.0, 1e-3, "1.2e-4 px of 640 on a slope of 5 per px, away from the cuts"),
    vector("raster.f32.transmittance_made", 0.0, 1e-3, "as colour"),
    vector("raster.f32.depth_made", 0.0, 1e-3, "as colour"),
    vector("raster.f32.conic_made", 0.0, 4.6e-6, "as raster.f32.conic"),
    Tolerance { name: "raster.f32.flips_made", class: Class::Banded { tight: 1e-3, share: 2e-2, hard: 4.0 }, reason: "where two opaque splats of equal depth change places, a pixel has the other colour" },
    // raster_backward, in f64
    vector("raster_backward.gradient", 0.0, 4e-14, "measured 1.3e-14: sums over pixels of the forward's roundings, which cancel"),
    // raster_backward, in f32: 8 times what a rewrite of the formulas in f32 was measured to lose
    vector("raster_backward.f32.d_means", 0.0, 7.4e-5, "8 x 9.2e-6"),
    vector("raster_backward.f32.d_log_scales", 0.0, 5.0e-5, "8 x 6.2e-6"),
    vector("raster_backward.f32.d_quaternions", 0.0, 6.0e-5, "8 x 7.5e-6"),
    vector("raster_backward.f32.d_opacity_logits", 0.0, 5.7e-5, "8 x 7.1e-6"),
    vector("raster_backward.f32.d_sh", 0.0, 6.5e-5, "8 x 8.1e-6"),
    vector("raster_backward.f32.d_pose", 0.0, 1.6e-4, "8 x 2.0e-5"),
    vector("raster_backward.f32.d_means2d", 0.0, 6.6e-5, "8 x 8.3e-6"),
    vector("raster_backward.f32.d_conics", 0.0, 6.7e-5, "8 x 8.4e-6"),
    vector("raster_backward.f32.d_opacities", 0.0, 5.7e-5, "as the logits"),
    vector("raster_backward.f32.d_colors", 0.0, 6.5e-5, "as the coefficients"),
    vector("raster_backward.f32.d_depths", 0.0, 6.5e-5, "as the colours: a sum of the same weights"),
    // raster_backward by rows, for cases made at size (`garad golden make`): f64, then f32 by the flag `made`
    by_row("raster_backward.rows", [1e-10, 1e-12, 1e-3, 1e3], "f64: the forward's roundings, 1e-13 of each term, amplified by thin splats seen 640 px from the origin"),
    by_row("raster_backward.f32.rows", [1e-6, 6e-8, 2e-2, 1e2], "measured on scenes of 3000: 0.12 roundings of 6e-8 of the scale at 99 % of the rows, 14 at the worst, which a pixel near a cut has moved"),
    // losses, in f64
    abs_rel("losses.value", 0.0, 3e-14, "measured 1e-14 on flat images, whose variances are differences of 1e-16 over C2 = 9e-4; else 2e-15"),
    vector("losses.gradient", 0.0, 1.5e-13, "measured 5e-14 on flat images, 3e-14 on a photograph"),
    abs_rel("losses.logit_gradient", 0.0, 1e-15, "a product of two sigmoids, each to its last digit at both ends"),
    // losses, in f32
    abs_rel("losses.f32.value", 2e-6, 0.0, "means of errors of either sign"),
    abs_rel("losses.f32.value_flat", 2e-5, 0.0, "measured 5e-6: every pixel errs alike, by 6e-8 over C2 = 9e-4 per rounding"),
    vector("losses.f32.gradient", 0.0, 2e-4, "as the value"),
    // adam
    abs_rel("adam.path", 1e-15, 1e-15, "measured 5e-16: forty steps of 1e-2, each rounded when subtracted"),
    // densify: in f32 by definition
    abs_rel("densify.gradient", 0.0, 3e-7, "measured 9.5e-8: a sum of up to ten lengths in f32"),
    abs_rel("densify.means", 5e-7, 0.0, "m: measured 1.6e-7, exp in f32 of a deviation up to 1.5 m, and a sum of size 4"),
    abs_rel("densify.log_scales", 7e-8, 0.0, "measured 2e-8: one difference in f32 of numbers up to 1"),
    // sgd
    abs_rel("sgd.path", 3e-15, 0.0, "measured 1e-15: forty steps of numbers up to 8, each rounded when subtracted"),
    // lk: positions in f32 from sums of integers
    abs_rel("lk.xy", 1e-4, 0.0, "an ulp of a coordinate is 3e-5 px; steps end at 1e-2 px in the same order of operations"),
    Tolerance { name: "lk.xy_opencv", class: Class::Banded { tight: 5e-4, share: 1e-2, hard: 1e-2 }, reason: "OpenCV adds its sums in f32 and lane by lane; a step of 0.01 px more or less" },
    abs_rel("lk.residual", 1e-4, 0.0, "grey levels; follows the position"),
    Tolerance { name: "lk.residual_opencv", class: Class::Banded { tight: 1e-3, share: 0.5, hard: 3e-2 }, reason: "grey levels; follows the position" },
    Tolerance { name: "lk.flow_truth", class: Class::Banded { tight: 0.1, share: 0.05, hard: 0.2 }, reason: "the true motion: OpenCV has 3 % of the corners beyond 0.1 px, the worst 0.145" },
    // epipolar: products of a few matrices in f64
    vector("epipolar.fundamental", 0.0, 1e-12, "three products of 3x3 matrices, scaled and signed alike"),
    abs_rel("epipolar.distance", 1e-10, 1e-10, "a quotient whose numerator cancels near the line, f = 500 px"),
    // flow: moments of some hundred vectors in f64
    vector("flow.mean", 0.0, 2e-15, "a sum of some hundred terms of one size"),
    vector("flow.covariance", 0.0, 4e-15, "as the mean, squared"),
    abs_rel("flow.distance2", 2e-15, 1e-14, "relative to the mean's rounding over the distance from it, near the mean"),
    abs_rel("flow.distance2_needle", 0.0, 5e-12, "measured 2.4e-12: correlation 0.9999 turns the 5e-16 of a sum of 100 products into 5000 times as much"),
    abs_rel("flow.quantile", 0.0, 1e-15, "one logarithm"),
    // trajectory
    abs_rel("trajectory.rotation", 2e-15, 0.0, "entries of R; eigenvectors of a 4x4 matrix"),
    abs_rel("trajectory.rotation_narrow", 1e-10, 0.0, "1e-16 over the ratio 1e-6 of the variances across and along the line"),
    vector("trajectory.translation", 0.0, 1e-14, "R times a mean of size 1, difference of two such"),
    abs_rel("trajectory.scale", 0.0, 2e-15, "quotient of two sums of squares"),
    abs_rel("trajectory.rotation_evo", 4e-15, 0.0, "as rotation; evo's own rounding on top"),
    vector("trajectory.translation_evo", 0.0, 5e-15, "as translation; evo's own rounding on top"),
    abs_rel("trajectory.scale_evo", 0.0, 5e-15, "as scale; evo's own rounding on top"),
    abs_rel("trajectory.stats", 3e-14, 1e-14, "m and degrees: smallest errors are differences of numbers of size 1 to 60"),
    abs_rel("trajectory.errors", 6e-15, 0.0, "differences of positions of size 1 to 4 m"),
    // image_metrics
    abs_rel("image_metrics.ssim_map", 4e-13, 0.0, "variances are differences of size 1e-16, divided by C2 = 9e-4 and more"),
    abs_rel("image_metrics.ssim", 2e-14, 0.0, "mean over the map"),
    abs_rel("image_metrics.psnr", 2e-13, 0.0, "4.3 dB times the relative rounding of a mean of 1e4 squares; cv2 adds 2.2e-16 to the RMS"),
    abs_rel("image_metrics.depth", 0.0, 1e-15, "mean of 100 numbers"),
    // robust
    abs_rel("robust.rho", 0.0, 2e-15, "Huber's 2 delta sqrt(s) - delta^2 is at least half of its first term; log1p"),
    abs_rel("robust.weight", 1e-16, 1e-15, "Tukey's 1 - s/c^2 loses digits towards c"),
    // reprojection
    vector("reprojection.residual", 0.0, 1e-14, "differences of pixels over sigma"),
    vector("reprojection.jacobian", 0.0, 1e-14, "a few products of the point in the camera, which is itself a rotation's rounding away"),
    // pose_lm
    abs_rel("pose.cost_initial", 0.0, 1e-14, "a sum of squares; no optimisation in it"),
    abs_rel("pose.cost", 0.0, 2e-12, "flat at the optimum; residuals of 1e-3 are differences of pixels of size 500"),
    abs_rel("pose.pose", 1e-8, 0.0, "rad, m: 1e-6 standard deviations, where a cost of 5000 is flat to its last digit"),
    // bundle
    abs_rel("bundle.cost", 0.0, 1e-11, "flat at the optimum; 300 parameters at 1e-6 standard deviations"),
    abs_rel("bundle.points", 1e-7, 0.0, "m: points are ten times less certain than poses, above all along the ray"),
    // pose_graph
    abs_rel("pose_graph.cost_initial", 0.0, 1e-12, "no optimisation in it; scipy's matrix logarithm is good to some 1e-15 of residuals of 0.03 and more"),
    abs_rel("pose_graph.cost", 0.0, 1e-11, "flat at the optimum, and as the cost at the start"),
    abs_rel("pose_graph.pose", 5e-9, 0.0, "rad, m: measured 1.4e-9; the reference stops at steps of 1e-13, we where a cost of 40 is flat to its last digit"),
    // pnp
    abs_rel("pnp.exact", 1e-9, 0.0, "rad, m: pixels have a spacing of 1e-13 of 500, and triples lose up to 1/conditioning = 300 of that, twice"),
    abs_rel("pnp.pose", 1e-8, 0.0, "as pose.pose: where the cost is flat to its last digit"),
    // place
    abs_rel("place.score", 2e-15, 0.0, "a sum of up to 160 positive terms that is at most 1, and one less half a sum that is at most 2"),
    // dataset
    abs_rel("dataset.rotation", 1e-15, 0.0, "entries of R, three products of unit quaternions against three of matrices"),
    abs_rel("dataset.translation", 2e-15, 0.0, "m: positions of size 3, spacing 4.4e-16, and a lever of 2 cm"),
    // free_space and cues
    abs_rel("free_space.sigmas", 5e-14, 1e-14, "measured 2e-14: a depth, good to 4e-16 m, over a sigma of 0.012 m and more"),
    abs_rel("cues.reprojection", 1.5e-14, 0.0, "px: measured 4e-15, a mean of differences of pixels, as camera.pixel"),
    abs_rel("cues.depth", 2e-14, 1e-14, "measured 5e-15: as free_space.sigmas; the spread is a difference of such numbers"),
    abs_rel("cues.epipolar", 2e-14, 0.0, "px: measured 6e-15, a mean of distances, as epipolar.distance"),
    // unary, kernel, mean_field, label_window
    abs_rel("crf.unary", 0.0, 4e-15, "measured 1.6e-15: mean of four exponentials, each a few roundings of its exponent away"),
    abs_rel("crf.log_odds", 1e-13, 1e-14, "ln(1 - P) where 1 - P is 1e-3: a rounding of P counts a thousandfold"),
    abs_rel("crf.kernel", 1e-15, 0.0, "measured 5e-16: k times a few roundings of its exponent, which is largest at k = 1/e"),
    abs_rel("crf.q", 1e-13, 0.0, "a sum over 64 nodes may lose 7e-15; undecided nodes pass on a little more than they hear"),
    abs_rel("crf.f32.q", 2e-4, 0.0, "as crf.q: kernels in f32 lose 1e-6 per sum and pass it on"),
    abs_rel("crf.energy", 1e-14, 1e-15, "measured 4e-15: a sum of up to 2016 couplings"),
    // trace: numbers that stand behind poses good to 1e-8 and places good to 1e-4 px
    abs_rel("trace.residual", 1e-3, 1e-5, "1e-4 px and 1e-7 m over sigmas of 0.5 px and 3 mm"),
    abs_rel("trace.belief", 1e-3, 0.0, "log-odds of such precision through ten iterations"),
    vector("trace.flow", 1e-4, 1e-3, "as lk.xy; a covariance of some px, squared distances over it"),
    abs_rel("trace.loop", 1e-5, 0.0, "rad, m: measured 2.7e-6 against scipy, where a step promises 1e-6 of the cost"),
    abs_rel("trace.cost", 0.0, 1e-3, "a sum of squares of residuals of 1e-4 px more or less"),
    Tolerance { name: "trace.means", class: Class::Banded { tight: 1e-4, share: 2e-2, hard: 3.2e-3 }, reason: "Adam's step is +-rate wherever a gradient is rounding alone: ten rates, five steps apart" },
    Tolerance { name: "trace.log_scales", class: Class::Banded { tight: 1e-4, share: 2e-2, hard: 5e-2 }, reason: "as trace.means" },
    Tolerance { name: "trace.quaternions", class: Class::Banded { tight: 1e-4, share: 2e-2, hard: 1e-2 }, reason: "as trace.means" },
    Tolerance { name: "trace.opacity_logits", class: Class::Banded { tight: 1e-4, share: 2e-2, hard: 0.5 }, reason: "as trace.means" },
    Tolerance { name: "trace.sh", class: Class::Banded { tight: 1e-4, share: 2e-2, hard: 2.5e-2 }, reason: "as trace.means" },
    Tolerance { name: "trace.image", class: Class::Banded { tight: 1e-3, share: 2e-2, hard: 0.05 }, reason: "as raster.f32.flips, of a map of which one number in fifty is a step off" },
    abs_rel("trace.loss", 1e-4, 1e-3, "a mean over such an image"),
    abs_rel("crf.score", 1e-15, 0.0, "a quotient of small whole numbers"),
];

/// Unit roundoff of f32 over that of f64, 2^29.
pub const F32_OVER_F64: f64 = 536_870_912.0;

/// Up to here a tolerance is rounding and grows with the unit roundoff.
pub(crate) const LARGEST_ROUNDING: f64 = 1e-12;

/// What an answer in f32 is held to where the expected value is one of f64.
///
/// The first of these that exists: the stage's own entry `STAGE.f32.OUTPUT_FLAG` for a flag of
/// the case, `STAGE.f32.OUTPUT`, the entry of the same name with `f32` in the middle. Else, where the
/// tolerance counts roundings (at most 1e-12), 2²⁹ times that; else the tolerance as it is, which
/// few answers in f32 will meet. An entry by rows has one by rows in f32: that of the same name with `f32` in the middle.
#[must_use]
pub fn for_f32(stage: &str, output: &str, flags: &[String], wide: &Tolerance) -> Tolerance {
    let flagged = flags
        .iter()
        .map(|flag| format!("{stage}.f32.{output}_{flag}"));
    let own = format!("{stage}.f32.{output}");
    let renamed = wide.name.replacen('.', ".f32.", 1);
    if let (Class::Rows { .. }, Some(rows)) = (wide.class, find(&renamed)) {
        return *rows;
    }
    let mut names = flagged.chain([own, renamed]);
    if let Some(tolerance) = names.find_map(|name| find(&name)) {
        return *tolerance;
    }
    let rounding = |abs: f64, rel: f64| abs.max(rel) <= LARGEST_ROUNDING;
    let (abs_rel, abs, rel) = match wide.class {
        Class::AbsRel { abs, rel } if rounding(abs, rel) => (true, abs, rel),
        Class::Vector { abs, rel } if rounding(abs, rel) => (false, abs, rel),
        _ => return *wide,
    };
    let [abs, rel] = [abs, rel].map(|v| v * F32_OVER_F64);
    Tolerance {
        class: if abs_rel {
            Class::AbsRel { abs, rel }
        } else {
            Class::Vector { abs, rel }
        },
        ..*wide
    }
}

/// The budget for pixels near a cut of answers in f32.
#[must_use]
pub fn flips(stage: &str, flags: &[String]) -> Option<&'static Tolerance> {
    let budget = format!("{stage}.f32.flips");
    let flagged = flags
        .iter()
        .find_map(|flag| find(&format!("{budget}_{flag}")));
    flagged.or_else(|| find(&budget))
}

/// The entry of this name.
#[must_use]
pub fn find(name: &str) -> Option<&'static Tolerance> {
    TABLE.iter().find(|t| t.name == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_entry_has_its_own_name_and_a_reason() {
        for (i, entry) in TABLE.iter().enumerate() {
            assert!(
                TABLE[..i].iter().all(|other| other.name != entry.name),
                "{} stands twice",
                entry.name
            );
            assert!(entry.reason.len() > 5, "{}: why?", entry.name);
        }
    }

    #[test]
    fn answers_in_f32_have_their_own_numbers() {
        let flags = ["flat".to_owned()];
        let of = |stage, output, name: &str, flags: &[String]| {
            for_f32(stage, output, flags, find(name).unwrap())
        };
        let named = |stage, output, name| of(stage, output, name, &[]).name;
        let value = of("losses", "value", "losses.value", &flags).name;
        assert_eq!(value, "losses.f32.value_flat", "by the flag");
        let value = named("losses", "value", "losses.value");
        assert_eq!(value, "losses.f32.value", "by the output");
        let color = named("raster", "splat_color", "raster.color");
        assert_eq!(color, "raster.f32.color", "by the name");
        assert_eq!(
            named("raster", "order", "exact"),
            "exact",
            "orders have no width"
        );
        let Class::AbsRel { abs, .. } = of("se3", "rotation", "se3.rotation", &[]).class else {
            panic!("the same class");
        };
        assert!((abs - 5.4e-7).abs() < 1e-8, "1e-15 x 2^29 is {abs:e}");
        let rows = named("raster_backward", "d_means", "raster_backward.rows");
        assert_eq!(rows, "raster_backward.f32.rows", "rows stay rows");
        let flags = ["made".to_owned()];
        let color = of("raster", "color", "raster.color", &flags).name;
        assert_eq!(color, "raster.f32.color_made", "of made cases");
        let budget = |flags: &[String]| flips("raster", flags).unwrap().name;
        assert_eq!(budget(&flags), "raster.f32.flips_made", "by the flag");
        assert_eq!(budget(&[]), "raster.f32.flips", "without");
        assert_eq!(flips("sh", &flags), None, "no cuts");
        let kept = of("pose_lm", "rotation", "pose.pose", &[]);
        assert_eq!(kept, *find("pose.pose").unwrap(), "1e-8 is no rounding");
    }
}
