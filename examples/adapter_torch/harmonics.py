"""Colour by real spherical harmonics to degree 3 (the book, chapter 9; docs/math.md R7)."""

import torch

C = [0.28209479177387814, 0.4886025119029199, 1.0925484305920792, 0.31539156525252005, 0.5462742152960396,
     0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277]


def basis(direction, count):
    """[N, count]: Y_k of unit directions [N, 3]."""
    x, y, z = direction.unbind(1)
    xx, yy, zz = x * x, y * y, z * z
    terms = [
        C[0] * torch.ones_like(x),
        -C[1] * y, C[1] * z, -C[1] * x,
        C[2] * x * y, -C[2] * y * z, C[3] * (2 * zz - xx - yy), -C[2] * x * z, C[4] * (xx - yy),
        -C[5] * y * (3 * xx - yy), C[6] * x * y * z, -C[7] * y * (4 * zz - xx - yy),
        C[8] * z * (2 * zz - 3 * xx - 3 * yy), -C[7] * x * (4 * zz - xx - yy), C[9] * z * (xx - yy),
        -C[5] * x * (xx - 3 * yy),
    ]
    return torch.stack(terms[:count], 1)


def color(direction, sh):
    """[N, 3]: max(0, 1/2 + sum of Y_k f_k); relu passes nothing back where it is 0."""
    return torch.relu(0.5 + torch.einsum("nk,nkc->nc", basis(direction, sh.shape[1]), sh))


def stage(case):
    d, sh = case["direction"], case["sh"]
    d = (d / d.norm(dim=1, keepdim=True)).requires_grad_()
    y = basis(d, sh.shape[1])
    slopes = torch.stack([torch.autograd.grad(y[:, k].sum(), d, retain_graph=True, allow_unused=True)[0]
                          if k else torch.zeros_like(d) for k in range(sh.shape[1])], 1)
    # What is left of the gradient on the unit sphere.
    tangent = slopes - (slopes * d[:, None]).sum(2, keepdim=True) * d[:, None]
    degrees = torch.stack([color(d, sh[:, :n]) for n in (1, 4, 9, 16)], 1)
    return {"basis": y, "tangent_gradient": tangent, "color": degrees}
