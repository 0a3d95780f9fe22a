"""SO(3) and SE(3): exp, log, Jacobians and adjoint for angles from 0 to pi.

Every value is a matrix power series summed with 400 digits and rounded once; none of the closed forms of
the code under test is used:

    exp(K)  = sum K^n / n!                 J = sum K^n / (n+1)!
    J6      = sum ad^n / (n+1)!, ad = [K P; 0 K];   Q is its upper right block.

    Needs: numpy 2.4.6, mpmath 1.3.0.
"""

import mpmath as mp
import numpy as np

from case import write_case

mp.mp.dps = 400  # angles of 1e-160: their squares must not vanish beside 1


def hat(v):
    return mp.matrix([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


def series(a, shift):
    """sum over n of a^n / (n + shift)!"""
    size = a.rows
    term, total, n = mp.eye(size), mp.zeros(size), 0
    factorial = mp.factorial(shift)
    while True:
        total += term / factorial
        n += 1
        term = term * a
        factorial *= n + shift
        if n > 8 and mp.mnorm(term, mp.inf) < mp.mpf(10) ** -395 * factorial:
            return total


def block(a, b, c, d):
    m = mp.zeros(6)
    for i in range(3):
        for j in range(3):
            m[i, j], m[i, j + 3], m[i + 3, j], m[i + 3, j + 3] = a[i, j], b[i, j], c[i, j], d[i, j]
    return m


def upper_right(m):
    return mp.matrix([[m[i, j + 3] for j in range(3)] for i in range(3)])


def to_numpy(m):
    return np.array([[float(m[i, j]) for j in range(m.cols)] for i in range(m.rows)])


def directions(rng, n):
    """Coordinate axes and diagonals (ties in Shepperd's choice of a component), then random ones."""
    fixed = [[1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [1, 1, 1], [-1, 1, 0]]
    drawn = rng.standard_normal((n - len(fixed), 3))
    d = np.concatenate([fixed, drawn])
    return d / np.linalg.norm(d, axis=1, keepdims=True)


def write(name, why, angles, seed, near_pi=False, flags=()):
    rng = np.random.default_rng(seed)
    phi = directions(rng, max(len(angles), 7))[: len(angles)] * np.array(angles)[:, None]
    # log of what exp gives is phi only up to pi; rounding three components must not pass it.
    assert all(mp.norm(mp.matrix(list(map(mp.mpf, map(float, p))))) < mp.pi for p in phi)
    rho = rng.standard_normal((len(angles), 3)) * np.array([1.0, 3.0, 0.01])[rng.integers(0, 3, len(angles))][:, None]
    out = {k: [] for k in "rotation quaternion jacobian jacobian_inverse translation q adjoint log_rotation log_translation".split()}
    for p, r in zip(phi, rho):
        k, p_hat = hat([mp.mpf(float(v)) for v in p]), hat([mp.mpf(float(v)) for v in r])
        rotation, jacobian = series(k, 0), series(k, 1)
        rho_mp = mp.matrix([mp.mpf(float(v)) for v in r])
        translation = jacobian * rho_mp
        six = series(block(k, p_hat, mp.zeros(3), k), 1)
        theta = mp.norm(mp.matrix([mp.mpf(float(v)) for v in p]))
        half = mp.sin(theta / 2) / theta if theta else mp.mpf(1) / 2
        inverse = jacobian ** -1
        out["rotation"].append(to_numpy(rotation))
        out["quaternion"].append([float(mp.cos(theta / 2))] + [float(half * mp.mpf(float(v))) for v in p])
        out["jacobian"].append(to_numpy(jacobian))
        out["jacobian_inverse"].append(to_numpy(inverse))
        out["translation"].append(to_numpy(translation)[:, 0])
        out["q"].append(to_numpy(upper_right(six)))
        out["adjoint"].append(to_numpy(block(rotation, hat(list(translation)) * rotation, mp.zeros(3), rotation)))
        # log of the pose whose rotation vector is phi and whose translation is rho
        out["log_rotation"].append([float(v) for v in p])
        out["log_translation"].append(to_numpy(inverse * rho_mp)[:, 0])
    inverse_tol = "se3.jacobian_inverse_near_pi" if near_pi else "se3.jacobian_inverse"
    log_tol = "se3.log_near_pi" if near_pi else "se3.log"
    units = {"translation": ("m", "se3.translation"), "q": ("m", "se3.q"), "adjoint": ("1", "se3.adjoint"),
             "jacobian_inverse": ("1", inverse_tol), "log_rotation": ("rad", log_tol),
             "log_translation": ("m", "se3.translation_log")}
    write_case(
        "se3", name, basis="mpmath-400", why=why, script="gen/se3.py", seed=seed, flags=flags,
        equations=["E1", "E2", "E3", "E4", "E5", "E6", "E7", "E8"],
        inputs={"phi": (phi, "rad"), "rho": (rho, "m")},
        outputs={name: (np.array(v), *units.get(name, ("1", "se3.rotation"))) for name, v in out.items()},
    )


if __name__ == "__main__":
    switches = [0.25, 0.5, 1.0]
    write("small", "angles whose squares or fourth powers vanish beside 1",
          [0.0, 1e-160, 1e-80, 1e-40, 1e-20, 1e-12, 1e-9, 1e-8, 3e-8, 1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2], 1)
    write("medium", "every angle a camera turns by",
          list(np.geomspace(0.02, 2.99, 30)), 2)
    write("switches", "both sides of every place where an implementation may change from series to closed form",
          [s * (1 + d) for s in switches for d in (-1e-3, -1e-15, 0, 1e-15, 1e-3)], 3)
    write("near_pi", "where log and the inverse Jacobian lose their digits",
          [3.0, 3.1, 3.14] + [np.pi - 10.0 ** -k for k in range(3, 8)], 4, near_pi=True)
    write("at_pi", "half turns: the sign of log is free, the matrix is not",
          [np.pi - 1e-9, np.pi - 1e-12, np.pi - 1e-14, np.pi - 1e-15], 5, near_pi=True, flags=["log_sign_free"])
