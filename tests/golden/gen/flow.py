"""The check of flow: mean, covariance, squared Mahalanobis distances and verdicts.

    pip install numpy==2.4.6 scipy==1.17.1 mpmath==1.3.0
    python3 tests/golden/gen/flow.py

Moments and distances in 50 digits (and by numpy.cov and numpy.linalg.inv, which must agree),
medians and quantiles from scipy.stats. No suspect lies within 1e-6 of the threshold.
"""

import mpmath as mp
import numpy as np
from scipy import stats

from case import write_case

mp.mp.dps = 50
FIELD_CHI2 = 5.991
CUT = stats.chi2.ppf(0.95, 2)


def moments(v):
    """Mean and covariance, as matrices of 50 digits."""
    n, m = len(v), mp.matrix(v.tolist())
    mean = mp.matrix([mp.fsum(m[:, k]) / n for k in range(2)])
    d = mp.matrix(n, 2)
    for i in range(n):
        d[i, :] = m[i, :] - mean.T
    covariance = d.T * d / (n - 1)
    assert np.allclose(array(covariance), np.cov(v.T, ddof=1), rtol=1e-12, atol=0)
    return mean, covariance, n


def median_mad(v):
    deviation = stats.median_abs_deviation(v, scale="normal")
    return mp.matrix(np.median(v, axis=0).tolist()), mp.diag([mp.mpf(s) ** 2 for s in deviation.tolist()]), len(v)


def trimmed(v, floor):
    """Those within 95 % of median_mad; what a cut Gaussian loses is put back."""
    centre, covariance, _ = median_mad(v)
    distance2 = mahalanobis2(v, centre, covariance + floor * mp.eye(2))
    assert np.abs(distance2 - CUT).min() > 1e-6
    mean, covariance, support = moments(v[distance2 <= CUT])
    return mean, covariance * (0.95 / mp.mpf(stats.chi2.cdf(CUT, 4))), support


def mahalanobis2(v, mean, covariance):
    inverse = mp.inverse(covariance)
    deviations = [mp.matrix(row) - mean for row in v.tolist()]
    return np.array([float((d.T * inverse * d)[0]) for d in deviations])


def array(matrix):
    return np.array(matrix.tolist(), dtype=float)


def make(name, why, seed, static, suspects, estimator="moments", form="raw", floor=0.0, predicted=None,
         tolerance="flow.distance2"):
    """`predicted` is a pair of arrays: for the static points and for the suspects."""
    used, judged = (static, suspects) if form == "raw" else (static - predicted[0], suspects - predicted[1])
    fit = {"moments": moments, "median_mad": median_mad, "trimmed": lambda v: trimmed(v, floor)}[estimator]
    mean, covariance, support = fit(used)
    covariance = covariance + floor * mp.eye(2)
    distance2 = mahalanobis2(judged, mean, covariance)
    inside = distance2 <= FIELD_CHI2
    assert np.abs(distance2 - FIELD_CHI2).min() > 1e-6 and inside.any() and not inside.all(), name
    assert np.array_equal(inside, distance2 <= CUT), name
    levels = np.array([0.5, 0.9, 0.95, 0.99, 0.999])
    inputs = {"static_flow": (static, "px"), "suspect_flow": (suspects, "px"), "levels": (levels, "1")}
    if predicted is not None:
        inputs |= {"static_predicted": (predicted[0], "px"), "suspect_predicted": (predicted[1], "px")}
    write_case(
        "flow", name, basis="mpmath", why=why, script="gen/flow.py", seed=seed, equations=["paper:9", "paper:10"],
        params={"estimator": estimator, "form": form, "covariance_floor_px2": floor, "chi2": FIELD_CHI2},
        inputs=inputs,
        outputs={
            "mean": (array(mean).ravel(), "px", "flow.mean"),
            "covariance": (array(covariance), "px2", "flow.covariance"),
            "support": (np.array([support]), "1", "exact"),
            "distance2": (distance2, "1", tolerance),
            "inside": (inside, "1", "exact"),
            "quantiles": (stats.chi2.ppf(levels, 2), "1", "flow.quantile"),
        },
    )


def gaussian(rng, n, mean, covariance):
    return rng.multivariate_normal(mean, covariance, n)


rng = np.random.default_rng(91)
make("by_eye", "few numbers, to be checked by a reader", 91,
     np.array([[1.0, 0.0], [3.0, 0.0], [2.0, 1.0], [2.0, -1.0]]), np.array([[2.0, 1.5], [5.0, 0.0], [3.5, -1.0], [2.0, -2.5]]))

rng = np.random.default_rng(92)
SLANTED = [[0.7, 0.25], [0.25, 0.4]]
make("slanted", "correlated flow, the paper's equations to the letter", 92, gaussian(rng, 120, [3.2, -1.1], SLANTED),
     np.vstack([gaussian(rng, 40, [3.2, -1.1], SLANTED), rng.uniform(-8, 8, (40, 2))]))

rng = np.random.default_rng(93)
needle = gaussian(rng, 100, [12.0, 9.0], np.array([[1.0, 0.9999], [0.9999, 1.0]]) * 4.0)
make("needle", "correlation 0.9999: a determinant loses four digits", 93, needle,
     np.vstack([needle[:20] + [0.02, -0.02], needle[:20] + [0.2, -0.2]]), tolerance="flow.distance2_needle")

rng = np.random.default_rng(94)
make("at_rest", "a camera at rest: only the floor keeps half a pixel of noise inside", 94, rng.normal(0, 0.02, (60, 2)),
     np.vstack([rng.normal(0, 0.5, (40, 2)), rng.normal(0, 3, (20, 2))]), floor=0.25)

rng = np.random.default_rng(95)
at = [rng.uniform([-320, -240], [320, 240], (n, 2)) for n in (150, 60)]
roll = [np.column_stack([-0.03 * a[:, 1], 0.03 * a[:, 0]]) for a in at]
flow = [roll[0] + rng.normal(0, 0.2, roll[0].shape), roll[1] + rng.normal(0, 0.2, roll[1].shape)]
flow[1][30:] += [3.0, 0.5]
for form in ("raw", "residual"):
    make(f"rolling_{form}", "a rolling camera and a walker: raw flow hides him, residual flow does not", 95,
         flow[0], flow[1] if form == "residual" else np.vstack([flow[1], [[40.0, 0.0]]]), form=form, floor=0.25,
         predicted=(roll[0], roll[1] if form == "residual" else np.vstack([roll[1], [[0.0, 0.0]]])))

rng = np.random.default_rng(96)
mixed = np.vstack([gaussian(rng, 140, [2.0, 1.0], SLANTED), gaussian(rng, 45, [-7.0, 3.0], np.eye(2))])
suspects = np.vstack([gaussian(rng, 40, [2.0, 1.0], SLANTED), rng.uniform(-10, 10, (40, 2))])
for estimator in ("moments", "median_mad", "trimmed"):
    make(f"contaminated_{estimator}", "a quarter of the static points walks", 96, mixed, suspects, estimator=estimator)
