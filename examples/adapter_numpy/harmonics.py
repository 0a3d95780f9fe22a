"""Colour by spherical harmonics (the book: splatting.md, backward.md). Each function is a polynomial, a list of
(coefficient, power of x, of y, of z); its gradient follows from that."""

import numpy as np

C = [0.28209479177387814, 0.4886025119029199, 1.0925484305920792, 0.31539156525252005, 0.5462742152960396,
     0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277]
BASIS = [
    [(C[0], 0, 0, 0)],
    [(-C[1], 0, 1, 0)], [(C[1], 0, 0, 1)], [(-C[1], 1, 0, 0)],
    [(C[2], 1, 1, 0)], [(-C[2], 0, 1, 1)], [(2 * C[3], 0, 0, 2), (-C[3], 2, 0, 0), (-C[3], 0, 2, 0)],
    [(-C[2], 1, 0, 1)], [(C[4], 2, 0, 0), (-C[4], 0, 2, 0)],
    [(-3 * C[5], 2, 1, 0), (C[5], 0, 3, 0)], [(C[6], 1, 1, 1)],
    [(-4 * C[7], 0, 1, 2), (C[7], 2, 1, 0), (C[7], 0, 3, 0)],
    [(2 * C[8], 0, 0, 3), (-3 * C[8], 2, 0, 1), (-3 * C[8], 0, 2, 1)],
    [(-4 * C[7], 1, 0, 2), (C[7], 3, 0, 0), (C[7], 1, 2, 0)],
    [(C[9], 2, 0, 1), (-C[9], 0, 2, 1)], [(-C[5], 3, 0, 0), (3 * C[5], 1, 2, 0)],
]


def value(polynomial, d):
    out = np.zeros(len(d), d.dtype)
    for c, i, j, k in polynomial:
        out += d.dtype.type(c) * d[:, 0] ** i * d[:, 1] ** j * d[:, 2] ** k
    return out


def slope(polynomial, axis):
    """The derivative by x, y or z, as a polynomial."""
    terms = []
    for c, *powers in polynomial:
        if powers[axis]:
            lower = list(powers)
            lower[axis] -= 1
            terms.append((c * powers[axis], *lower))
    return terms


def basis(directions, count):
    """[N, count]."""
    return np.stack([value(p, directions) for p in BASIS[:count]], 1)


def tangent_gradient(directions, count):
    """[N, count, 3], what is left of the gradient on the unit sphere."""
    g = np.stack([np.stack([value(slope(p, axis), directions) for axis in range(3)], 1) for p in BASIS[:count]], 1)
    return g - (g * directions[:, None]).sum(2, keepdims=True) * directions[:, None]


def unit(v):
    return v / np.sqrt((v * v).sum(1, keepdims=True))


def stage(case):
    d, sh = unit(case["direction"]), case["sh"]
    y = basis(d, sh.shape[1])
    color = np.stack([np.maximum(np.float32(0.5) + np.einsum("nk,nkc->nc", y[:, :n], sh[:, :n]), 0) for n in (1, 4, 9, 16)], 1)
    return {"basis": y, "tangent_gradient": tangent_gradient(d, sh.shape[1]), "color": color}
