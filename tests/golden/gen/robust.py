"""Robust kernels: rho(s) and its slope, from 0 to far outside, and both sides of each knee.

Formulas evaluated with 50 digits; the slope is mpmath's derivative of rho. Huber and Cauchy must agree with
scipy's own loss functions to 1e-13.

    Needs: numpy 2.4.6, scipy 1.17.1, mpmath 1.3.0.
"""

import mpmath as mp
import numpy as np
from scipy.optimize import least_squares

from case import write_case

mp.mp.dps = 50


def huber(s, d):
    return s if s <= d * d else 2 * d * mp.sqrt(s) - d * d


def cauchy(s, c):
    return c * c * mp.log(1 + s / (c * c))


def geman_mcclure(s, c):
    return s / (1 + s / (c * c))


def tukey(s, c):
    return c * c / 3 * (1 - (1 - s / (c * c)) ** 3) if s <= c * c else c * c / 3


def by_scipy(loss, s, scale):
    """Twice the cost that least_squares reports for one residual sqrt(s) at the starting point."""
    f = lambda x: np.array([np.sqrt(s)]) + 0 * x
    return 2 * least_squares(f, [0.0], loss=loss, f_scale=scale, max_nfev=1).cost


if __name__ == "__main__":
    for name, rho in [("huber", huber), ("cauchy", cauchy), ("geman_mcclure", geman_mcclure), ("tukey", tukey)]:
        for scale in (0.5, 2.447651936039926):
            knee = scale * scale
            s = np.concatenate([[0.0], np.geomspace(1e-12, 1e6, 37), knee * np.array([0.9, 1 - 1e-9, 1 + 1e-9, 1.1])])
            values = [float(rho(mp.mpf(float(v)), mp.mpf(scale))) for v in s]
            # one-sided at 0, where s cannot be negative
            slopes = [float(mp.diff(lambda v: rho(v, mp.mpf(scale)), mp.mpf(float(v)), direction=1 if v == 0 else 0,
                                    h=mp.mpf(10) ** -25 * max(v, 1e-12))) for v in s]
            in_scipy = name in ("huber", "cauchy")
            if in_scipy:
                assert all(abs(by_scipy(name, v, scale) - r) <= 1e-13 * (1 + r) for v, r in zip(s, values))
            write_case(
                "robust", f"{name}_{scale:.1f}", basis="mpmath-50" + (" + scipy" if in_scipy else ""),
                why="value and weight from the centre to far outside, and around the knee", script="gen/robust.py",
                params={"kernel": name, "scale": scale}, inputs={"s": (s, "1")},
                outputs={"rho": (np.array(values), "1", "robust.rho"), "weight": (np.array(slopes), "1", "robust.weight")},
            )
