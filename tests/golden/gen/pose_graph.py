"""Optima of small pose graphs: scipy's matrix logarithm and exponential, scipy's least squares.

The residual is the twist of logm(inv(Z) @ T_a @ inv(T_b)) as 4x4 matrices, whitened by a Cholesky factor of the
information; poses move on the left, expm(xi^) @ T. scipy.optimize.least_squares comes within 1e-9 of the optimum;
Gauss-Newton with differences of fourth order then goes on until the step is below 1e-13.

    Needs: numpy 2.4.6, scipy 1.17.1.
"""

import numpy as np
from scipy.linalg import expm, logm
from scipy.optimize import least_squares

from case import write_case


def hat6(xi):
    x, y, z = xi[3:]
    return np.array([[0, -z, y, xi[0]], [z, 0, -x, xi[1]], [-y, x, 0, xi[2]], [0, 0, 0, 0]])


def exp(xi):
    return expm(hat6(xi))


def log(t):
    m = np.real(logm(t))
    return np.array([m[0, 3], m[1, 3], m[2, 3], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]]) * [1, 1, 1, .5, .5, .5]


def inv(t):
    r = t[:3, :3].T
    return np.block([[r, -(r @ t[:3, 3:])], [np.zeros((1, 3)), np.ones((1, 1))]])


def graph(seed, n, closures, noise):
    """A walk with noisy odometry, and closures; information matrices are full and of unequal size."""
    rng = np.random.default_rng(seed)
    step = exp(np.array([0.05, -0.02, -0.4, 0.03, 2 * np.pi / n, 0.01]))
    truth = [exp(rng.normal(size=6) * 0.3)]
    for _ in range(1, n):
        truth.append(exp(rng.normal(size=6) * 0.05) @ step @ truth[-1])
    edges = [(k, k - 1) for k in range(1, n)] + closures
    z, information = [], []
    for a, b in edges:
        z.append(truth[a] @ inv(truth[b]) @ exp(noise * rng.normal(size=6)))
        j = rng.normal(size=(8, 6))
        information.append((j.T @ j + np.diag([1, 1, 1, 4, 4, 4])) * rng.uniform(10, 100))
    start = [truth[0]]
    for k in range(1, n):
        start.append(z[k - 1] @ start[-1])
    return np.array(edges), np.array(z), np.array(information), np.array(start)


def orthonormal(t):
    """The nearest rotation, so that what is written is a pose to the last digit."""
    u, _, vt = np.linalg.svd(t[:3, :3])
    out = t.copy()
    out[:3, :3] = u @ vt
    return out


def solve(edges, z, information, start):
    n = len(start)
    roots = [np.linalg.cholesky(w).T for w in information]
    z_inv = [inv(t) for t in z]

    def residual(poses):
        inverses = [inv(t) for t in poses]
        return np.concatenate([r @ log(zi @ poses[a] @ inverses[b]) for (a, b), zi, r in zip(edges, z_inv, roots)])

    def moved(poses, x):
        return [poses[0]] + [exp(x[6 * k - 6:6 * k]) @ poses[k] for k in range(1, n)]

    def jacobian(poses, h=1e-3):
        columns = []
        for i in range(6 * (n - 1)):
            d = np.zeros(6 * (n - 1))
            d[i] = h
            f = [residual(moved(poses, s * d)) for s in (1, -1, 2, -2)]
            columns.append((8 * (f[0] - f[1]) - (f[2] - f[3])) / (12 * h))
        return np.stack(columns, 1)

    found = least_squares(lambda x: residual(moved(start, x)), np.zeros(6 * n - 6), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    poses = [orthonormal(t) for t in moved(start, found.x)]
    for _ in range(12):
        j, r = jacobian(poses), residual(poses)
        x = np.linalg.lstsq(j, -r, rcond=None)[0]
        poses = [orthonormal(t) for t in moved(poses, x)]
        if np.abs(x).max() < 1e-13:
            break
    assert np.abs(x).max() < 1e-9, np.abs(x).max()
    cost = lambda p: 0.5 * float(residual(p) @ residual(p))
    assert cost(poses) <= found.cost * (1 + 1e-12)
    return np.array(poses), cost(start), cost(poses), np.abs(x).max()


def main():
    cases = [
        ("loop", 3, 12, [(11, 0)], 0.03, "one closure spreads the drift of eleven steps"),
        ("figure_eight", 5, 14, [(6, 0), (13, 0), (13, 6), (3, 9)], 0.08, "closures cross and disagree: residuals up to 0.2 rad"),
    ]
    for name, seed, n, closures, noise, why in cases:
        edges, z, information, start = graph(seed, n, closures, noise)
        start = np.array([orthonormal(t) for t in start])
        z = np.array([orthonormal(t) for t in z])
        poses, cost0, cost, last = solve(edges, z, information, start)
        print(name, cost0, cost, last)
        write_case(
            "pose_graph", name, basis="scipy", why=why, script="gen/pose_graph.py", seed=seed,
            inputs={
                "edges": (edges.astype(np.int32), "1"),
                "edge_rotation": (z[:, :3, :3], "1"), "edge_translation": (z[:, :3, 3], "m"),
                "information": (information, "1/m^2, 1/rad^2"),
                "rotation_initial": (start[:, :3, :3], "1"), "translation_initial": (start[:, :3, 3], "m"),
            },
            outputs={
                "cost_initial": (np.array(cost0), "1", "pose_graph.cost_initial"),
                "cost": (np.array(cost), "1", "pose_graph.cost"),
                "rotation": (poses[:, :3, :3], "1", "pose_graph.pose"),
                "translation": (poses[:, :3, 3], "m", "pose_graph.pose"),
            },
        )


if __name__ == "__main__":
    main()
