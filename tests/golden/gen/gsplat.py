"""Golden cases by somebody else's rasterizer: gsplat's own torch reference (gsplat/cuda/_torch_impl.py, Apache-2.0) on a
CPU in float64, every gradient by torch's autograd. Called as they are: `_quat_to_rotmat`, `_quat_scale_to_covar_preci`,
`_world_to_cam`, `_fully_fused_projection`, `_isect_tiles`, `_isect_offset_encode`, `_rasterize_to_pixels` (with `accumulate`),
`_eval_sh_bases_fast`, `_spherical_harmonics`, and from gsplat/rendering.py the two lines for the colour,
clamp_min(SH(mean - camera) + 0.5, 0), camera = inverse(viewmat)[:3, 3].

Written here, because the originals are CUDA only:
  rasterize_to_indices_in_range   which pairs (Gaussian, pixel) are blended: gsplat's tile lists front to back, alpha < 1/255
                                  left out, the end before T (1 - alpha) <= 1e-4 (csrc/RasterizeToIndices3DGS.cu)
  nerfacc's render_weight_from_alpha, accumulate_along_rays
                                  w_i = alpha_i prod_{j<i} (1 - alpha_j) per pixel, and sums of w_i times values

Conventions that differ from docs/math.md, and how each is removed:
  pixel centres      gsplat's are at integers + 0.5: its cx, cy are ours + 0.5, its centres are reported minus 0.5
  slope clamp        gsplat: [-cx/fx - 0.3 t, (w - cx)/fx + 0.3 t], t = w/(2 fx), R3: +-1.3 t; the same for cx = w/2 in
                     gsplat's pixels. Scene sh0 has that and slopes beyond; in the others no slope is beyond either.
                     Both differentiate the clamped slope as a constant and x = s z by z: `clamp_gradient` is "true"
  near plane         near_plane = 0.2 (gsplat's own value is 0.01); both keep z > near. There is no far plane: far_plane = 1e10
  blur               eps2d = 0.3, no compensation of the opacity ("classic")
  largest alpha      0.999 in gsplat, 0.99 in R10: no alpha comes near 0.99 (opacities below 0.98)
  alpha, T cuts      1/255 and 1e-4 in both; gsplat ends at T (1 - alpha) <= 1e-4, R11 at < 1e-4: never equal here
  radius             gsplat: r = ceil(3.33 sigma) per axis, cells up to ceil((u + r)/16); R6, as 3DGS:
                     r = ceil(3 sqrt(largest eigenvalue)), a square, cells up to floor((u + r + 15)/16). Only Gaussians are
                     taken of which both footprints hold every pixel with alpha >= 1/255, and which both show or both do
                     not. radii, last, footprint are no outputs here
  depth              the sum of w_i z_i (gsplat's "D", not "ED"); z, not the range, in both; no background behind it
  view direction     not detached, here as there: the colour's gradient reaches mean and pose (R19, R20)
  quaternions        (w, x, y, z), brought to length 1, in both
  pose               a first-order left step (rho, phi) before the viewmat, differentiated at 0
  order              gsplat sorts by float32 depths: no two are equal
  channels, layout   RGB and (coefficient, channel) in both

Inputs are rounded to float32. `robust` as in raster.py.

    Needs: gsplat (1.5.3), torch (1.13.1, no GPU), numpy (1.26.4). Run: python3 gsplat.py
"""

import pathlib
import sys
import types

# This file is called as the package: the folder of the script must not come first while gsplat is imported.
HERE = str(pathlib.Path(__file__).resolve().parent)
sys.path = [p for p in sys.path if p != HERE]
import gsplat  # noqa: E402
import gsplat.cuda._torch_impl as reference  # noqa: E402
import gsplat.cuda._wrapper as wrapper  # noqa: E402
import numpy as np  # noqa: E402
import torch  # noqa: E402

sys.path.append(HERE)
from case import write_case  # noqa: E402
from raster import BLUR_PX2, CELL, CLAMP, MIN_ALPHA, MIN_T, NEAR_M, f32, random_scene, rotation, scene  # noqa: E402

torch.set_default_dtype(torch.float64)
BASIS = "gsplat-torch-f64"
VERSION = f"gsplat {gsplat.__version__}, torch {torch.__version__.split('+')[0]}"
SCRIPT = "gen/gsplat.py"
MOST_ALPHA = 0.985


@torch.no_grad()
def indices_in_range(start, _end, left, means2d, conics, opacities, width, height, tile, offsets, flat):
    """The pairs to be blended, sorted by pixel, front to back within one."""
    assert start == 0, "one batch is enough here"
    rows, columns = offsets.shape[-2:]
    ends = torch.cat([offsets.flatten()[1:], torch.tensor([len(flat)])])
    ids, pixels = [], []
    for cell in range(rows * columns):
        top, side = cell // columns * tile, cell % columns * tile
        y, x = torch.meshgrid(torch.arange(top, min(top + tile, height)), torch.arange(side, min(side + tile, width)), indexing="ij")
        y, x = y.flatten(), x.flatten()
        clear, open_ = left[0, y, x].clone(), torch.ones(len(y), dtype=torch.bool)
        for g in flat[offsets.flatten()[cell]:ends[cell]].long():
            dx, dy, (a, b, c) = x + 0.5 - means2d[0, g, 0], y + 0.5 - means2d[0, g, 1], conics[0, g]
            sigma = 0.5 * (a * dx**2 + c * dy**2) + b * dx * dy
            alpha = torch.clamp_max(opacities[0, g] * torch.exp(-sigma), 0.999)
            behind = clear * (1 - alpha)
            thick = open_ & (sigma >= 0) & (alpha >= MIN_ALPHA)
            open_ &= ~(thick & (behind <= MIN_T))
            drawn = thick & open_
            clear = torch.where(drawn, behind, clear)
            ids.append(torch.full((int(drawn.sum()),), int(g)))
            pixels.append((y * width + x)[drawn])
    ids, pixels = torch.cat(ids), torch.cat(pixels)
    order = torch.sort(pixels, stable=True)[1]
    return ids[order], pixels[order], torch.zeros_like(ids)


def render_weight_from_alpha(alphas, ray_indices, n_rays):
    rank = torch.arange(len(alphas)) - torch.searchsorted(ray_indices, ray_indices)
    clear = torch.ones(n_rays, int(rank.max()) + 2).index_put((ray_indices, rank + 1), 1 - alphas)
    left = torch.cumprod(clear, 1)[ray_indices, rank]
    return alphas * left, left


def accumulate_along_rays(weights, values, ray_indices, n_rays):
    values = weights[:, None] * (1 if values is None else values)
    return torch.zeros(n_rays, values.shape[1]).index_add(0, ray_indices, values)


wrapper.rasterize_to_indices_in_range = indices_in_range
sys.modules["nerfacc"] = types.SimpleNamespace(render_weight_from_alpha=render_weight_from_alpha,
                                               accumulate_along_rays=accumulate_along_rays)


class Render:
    """A scene of raster.py by gsplat; every intermediate whose gradient is wanted is kept."""

    def __init__(self, s):
        (width, height), (fx, fy, cx, cy) = s["size"], s["intrinsics"]
        leaf = lambda a: torch.tensor(np.asarray(a, np.float64), requires_grad=True)
        kept = {name: leaf(s[name]) for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh")}
        kept["pose"] = leaf(np.zeros(6))
        rho, (a, b, c), zero = kept["pose"][:3], kept["pose"][3:], torch.tensor(0.0)
        turn = torch.stack([zero, -c, b, c, zero, -a, -b, a, zero]).reshape(3, 3)
        step = torch.eye(4) + torch.cat([torch.cat([turn, rho[:, None]], 1), torch.zeros(1, 4)])
        world = torch.eye(4)
        world[:3, :3] = torch.tensor(rotation(s["q"]).astype(np.float64))
        world[:3, 3] = torch.tensor(s["t"])
        self.view = (step @ world)[None]
        self.k = torch.tensor([[[fx, 0, cx + 0.5], [0, fy, cy + 0.5], [0, 0, 1]]])
        covars = reference._quat_scale_to_covar_preci(kept["quaternions"], torch.exp(kept["log_scales"]), compute_preci=False)[0]
        self.p_cam = reference._world_to_cam(kept["means"], covars, self.view)[0][0]
        self.radii, means2d, depths, conics, _ = reference._fully_fused_projection(
            kept["means"], covars, self.view, self.k, width, height, eps2d=BLUR_PX2, near_plane=NEAR_M)
        camera = torch.inverse(self.view)[:, :3, 3]
        degree = int(round(np.sqrt(s["sh"].shape[1]))) - 1
        colors = reference._spherical_harmonics(degree, kept["means"][None] - camera[:, None], kept["sh"][None])
        colors = torch.clamp_min(colors + 0.5, 0.0)
        opacities = torch.sigmoid(kept["opacity_logits"])[None]
        kept |= {"means2d": means2d, "conics": conics, "opacities": opacities, "colors": colors, "depths": depths * 1}
        for name in ("means2d", "conics", "opacities", "colors", "depths"):
            kept[name].retain_grad()
        self.kept, self.size, self.visible = kept, (width, height), (self.radii[0] > 0).all(-1).numpy()
        self.depth_order = depths

    def draw(self, background):
        width, height = self.size
        k, columns, rows = self.kept, -(-self.size[0] // CELL), -(-self.size[1] // CELL)
        _, ids, flat = reference._isect_tiles(k["means2d"], self.radii, self.depth_order, CELL, columns, rows)
        offsets = reference._isect_offset_encode(ids, 1, columns, rows)
        channels = torch.cat([k["colors"], k["depths"][..., None]], -1)
        image, alphas = reference._rasterize_to_pixels(
            k["means2d"], k["conics"], channels, k["opacities"], width, height, CELL, offsets, flat,
            backgrounds=torch.tensor([[*background, 0.0]]))
        return image[0, ..., :3], image[0, ..., 3], alphas[0, ..., 0]

    def plain(self, name):
        return self.kept[name].detach()[0].numpy()

    def alphas(self):
        """[N, height, width] before any cut; for the checks below, not for the case."""
        y, x = np.mgrid[0:self.size[1], 0:self.size[0]] + 0.5
        m, c, o = self.plain("means2d"), self.plain("conics"), self.plain("opacities")
        dx, dy = x - m[:, 0, None, None], y - m[:, 1, None, None]
        a, b, c = (c[:, k, None, None] for k in range(3))
        return o[:, None, None] * np.exp(-(a * dx**2 + 2 * b * dx * dy + c * dy**2) / 2)

    def agrees(self):
        """Which Gaussians both projects draw into the same pixels: the rules of radius and footprint do not matter."""
        width, height = self.size
        y, x = np.mgrid[0:height, 0:width]
        mean, conic, alpha = self.plain("means2d"), self.plain("conics"), self.alphas()
        z, slopes = self.p_cam.detach().numpy()[:, 2], self.p_cam.detach().numpy()
        found = []
        for i in range(len(mean)):
            covariance = np.linalg.inv([[conic[i, 0], conic[i, 1]], [conic[i, 1], conic[i, 2]]])
            ours = np.ceil(3 * np.sqrt(np.linalg.eigvalsh(covariance)[1])) * np.ones(2)
            needed = alpha[i] >= MIN_ALPHA * (1 - 1e-3)
            held, shown = [], []
            r6 = lambda cell: np.floor(cell + (CELL - 1) / CELL)
            for radius, centre, last in ((ours, mean[i] - 0.5, r6), (self.radii[0, i].numpy(), mean[i], np.ceil)):
                low = np.floor((centre - radius) / CELL).clip(0)
                high = last((centre + radius) / CELL).clip(0)
                inside = (x >= CELL * low[0]) & (x < CELL * high[0]) & (y >= CELL * low[1]) & (y < CELL * high[1])
                held.append(not (needed & ~inside).any())
                shown.append(bool(inside.any()) and z[i] > NEAR_M)
            k = self.k[0].numpy()
            limits = [(CLAMP * n / (2 * f), -c / f - 0.15 * n / f, (n - c) / f + 0.15 * n / f)
                      for n, f, c in ((width, k[0, 0], k[0, 2]), (height, k[1, 1], k[1, 2]))]
            clamps = all(np.clip(s, -own, own) == np.clip(s, low, high) or abs(own - high) < 1e-12
                         for s, (own, low, high) in zip(slopes[i, :2] / z[i], limits))
            both = not any(shown) or (all(held) and clamps and alpha[i].max() < MOST_ALPHA)
            found.append(both and shown[0] == shown[1] == bool(self.visible[i]))
        return np.array(found)


def select(s, n):
    """The first n Gaussians of a scene on which both agree."""
    keep = np.flatnonzero(Render(s).agrees())[:n]
    assert len(keep) == n, f"{len(keep)} of {n}"
    return s | {name: s[name][keep] for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh")}


def inputs_of(s):
    return {
        "intrinsics": (np.array(s["intrinsics"], np.float64), "px: fx fy cx cy"),
        "camera_from_world_q": (s["q"], "w x y z"), "camera_from_world_t": (s["t"], "m"),
        "background": (s["background"], "1"), "means": (s["means"], "m"), "quaternions": (s["quaternions"], "w x y z"),
        "log_scales": (s["log_scales"], "ln m"), "opacity_logits": (s["opacity_logits"], "1"), "sh": (s["sh"], "1"),
    }


def write(name, why, s, seed, flags):
    render = Render(s)
    assert render.agrees().all(), np.flatnonzero(~render.agrees())
    order = np.array(sorted(np.flatnonzero(render.visible), key=lambda i: render.p_cam[i, 2].item()))
    depths = render.plain("depths")[order].astype(np.float32)
    assert (np.diff(depths) > 0).all(), "no ties in float32"
    color, depth, opacity = render.draw(s["background"])
    head = {"basis": BASIS, "script": SCRIPT, "seed": seed, "version": VERSION, "flags": flags, "why": why}
    params = {"width": s["size"][0], "height": s["size"][1], "sh_degree": int(round(np.sqrt(s["sh"].shape[1]))) - 1}
    array = lambda t: t.detach().numpy()

    # Away from each cut by a thousandth, as in raster.py.
    robust, clear, closed = np.ones(opacity.shape, bool), np.ones(opacity.shape), np.zeros(opacity.shape, bool)
    alphas = render.alphas()
    for i in order:
        thick, behind = ~closed & (alphas[i] >= MIN_ALPHA), clear * (1 - alphas[i])
        robust &= ~(~closed & (abs(alphas[i] / MIN_ALPHA - 1) < 1e-3)) & ~(thick & (abs(behind / MIN_T - 1) < 1e-3))
        closed |= thick & (behind <= MIN_T)
        clear = np.where(thick & ~closed, behind, clear)
    assert abs(clear - (1 - array(opacity))).max() < 1e-14
    write_case("raster", name, equations=["paper:15"], params=params, inputs=inputs_of(s) | {"robust": (robust, "away from every cut by 1e-3")},
               outputs={
                   "color": (array(color), "1", "raster.color"), "depth": (array(depth), "m", "raster.depth"),
                   "transmittance": (1 - array(opacity), "1", "raster.transmittance"), "order": (order.astype(np.int32), "1", "exact"),
                   "mean_px": (render.plain("means2d")[order] - 0.5, "px", "raster.mean_px"),
                   "depth_m": (render.plain("depths")[order], "m", "raster.depth_m"),
                   "conic": (render.plain("conics")[order], "px^-2", "raster.conic"),
                   "splat_color": (render.plain("colors")[order], "1", "raster.color")}, **head)

    rng = np.random.default_rng(seed)
    shape = tuple(opacity.shape)
    upstream = [f32(rng.normal(size=(*shape, 3))), f32(0.3 * rng.normal(size=shape)), f32(rng.normal(size=shape))]
    sum((torch.tensor(u) * image).sum() for u, image in zip(upstream, (color, depth, opacity))).backward()
    units = {"pose": "m^-1, rad^-1", "means": "m^-1", "means2d": "px^-1", "conics": "px^2", "depths": "m^-1"}
    gradient = lambda name: render.kept[name].grad.numpy().reshape(render.kept[name].shape[render.kept[name].shape[0] == 1:])
    names = ("pose", "means", "log_scales", "quaternions", "opacity_logits", "sh", "means2d", "conics", "opacities", "colors", "depths")
    write_case("raster_backward", name, equations=["paper:15"], params=params | {"clamp_gradient": "true"},
               inputs=inputs_of(s) | {"upstream_color": (upstream[0], "1"), "upstream_depth": (upstream[1], "m^-1"),
                                      "upstream_opacity": (upstream[2], "1")},
               outputs={"d_" + n: (gradient(n), units.get(n, "1"), "raster_backward.gradient") for n in names}, **head)
    print(f"{name}: {len(order)} of {len(s['means'])} visible, {int(closed.sum())} pixels closed, {robust.mean():.4f} robust, "
          f"largest alpha {alphas[order].max():.4f}")


def projection(name, why, s, seed, flags):
    """What is visible, in the order of the map."""
    keep = np.flatnonzero(Render(s).visible)
    s = s | {n: s[n][keep] for n in ("means", "log_scales", "quaternions", "opacity_logits", "sh")}
    render = Render(s)
    inputs = {n: v for n, v in inputs_of(s).items() if n not in ("background", "opacity_logits", "sh")}
    turns = reference._quat_to_rotmat(torch.tensor(s["quaternions"]))
    write_case("projection_covariance", name, basis=BASIS, script=SCRIPT, seed=seed, flags=flags, why=why, version=VERSION,
               equations=["R1", "R2", "R3", "R4", "R5"], params={"width": s["size"][0], "height": s["size"][1]}, inputs=inputs,
               outputs={"p_cam": (render.p_cam.detach().numpy(), "m", "projection.p_cam"), "rotation": (turns.numpy(), "1", "se3.rotation"),
                        "mean_px": (render.plain("means2d") - 0.5, "px", "raster.mean_px"),
                        "depth_m": (render.plain("depths"), "m", "raster.depth_m"), "conic": (render.plain("conics"), "px^-2", "raster.conic")})


def harmonics():
    rng = np.random.default_rng(71)
    directions = rng.normal(size=(16, 3))
    directions = f32(directions / np.linalg.norm(directions, axis=1, keepdims=True))
    sh = f32(rng.normal(0, 0.4, (16, 16, 3)))
    free = torch.nn.functional.normalize(torch.tensor(directions), dim=-1).requires_grad_()
    basis = reference._eval_sh_bases_fast(16, torch.nn.functional.normalize(free, dim=-1))
    slope = torch.stack([torch.autograd.grad(basis[:, k].sum(), free, retain_graph=True, allow_unused=True)[0]
                         if k else torch.zeros_like(free) for k in range(16)], 1)
    color = torch.stack([torch.clamp_min(reference._spherical_harmonics(d, free, torch.tensor(sh)) + 0.5, 0.0) for d in range(4)], 1)
    write_case("sh", "gsplat", basis=BASIS, script=SCRIPT, seed=71, equations=["R7", "R19"], flags=["gsplat", "convention"],
               version=VERSION, why="order, signs and constants of the harmonics in gsplat, gradient by autograd", params={"degree": 3},
               inputs={"direction": (directions, "1"), "sh": (sh, "1")},
               outputs={"basis": (basis.detach().numpy(), "1", "sh.basis"), "tangent_gradient": (slope.numpy(), "1", "sh.gradient"),
                        "color": (color.detach().numpy(), "1", "sh.color")})


def with_rows(s, rows):
    """Further Gaussians: (mean in the camera, sigmas, opacity); harmonics and turn as of the rows before."""
    r = rotation(s["q"]).astype(np.float64)
    means = np.array([(np.array(p) - s["t"]) @ r for p, _, _ in rows])
    logit = lambda o: np.log(o / (1 - o))
    more = {"means": f32(means), "log_scales": f32(np.log([v for _, v, _ in rows])), "opacity_logits": f32([logit(o) for _, _, o in rows]),
            "quaternions": s["quaternions"][:len(rows)][::-1], "sh": s["sh"][:len(rows)]}
    return s | {name: np.concatenate([s[name], tail]) for name, tail in more.items()}


def main():
    hidden = [((0.1, 0.05, -1.2), (0.2, 0.1, 0.15), 0.8), ((0.01, 0.0, 0.17), (0.02, 0.01, 0.01), 0.7), ((9.0, 0.3, 1.1), (0.1, 0.2, 0.1), 0.9)]
    centre = (24, 18), (25.0, 27.0, 11.5, 8.5)
    s = random_scene(101, 40, *centre, 0, 6.0, 0.04, (1, 0, 0, 0), (0, 0, 0))
    s = with_rows(select(s, 12), hidden + [((1.25, 0.1, 1.0), (0.7, 0.5, 0.6), 0.6), ((-0.1, -1.0, 1.2), (0.5, 0.8, 0.4), 0.7)])
    write("gsplat_sh0", "two slopes beyond the clamp, one Gaussian behind, one before the near plane, one far outside", s, 101,
          ["gsplat", "clamp"])
    projection("gsplat_clamp", "two slopes beyond the clamp, principal point in the middle", s, 101, ["gsplat", "clamp"])

    q, t = (0.45, -0.69, 0.28, 0.49), (1.0, -2.0, 0.7)
    s = random_scene(103, 60, (26, 20), (27.0, 29.0, 10.7, 11.2), 2, 8.0, 0.03, q, t)
    deep = [((0.05 * k, -0.04 * k, 1.3 + 0.1 * k), (0.4, 0.3, 0.35), 0.97) for k in range(4)]
    s = with_rows(select(s, 18), hidden + deep)
    write("gsplat_sh2", "degree 2 under a general pose, four nearly opaque in a row: T < 1e-4, and what lies behind", s, 103, ["gsplat", "closed"])

    s = select(random_scene(107, 90, (37, 29), (42.0, 44.0, 14.6, 17.1), 3, 8.0, 0.03, q, t), 30)
    write("gsplat_sh3", "degree 3 under a general pose, axes to 1:8, principal point off the middle", s, 107, ["gsplat"])
    projection("gsplat_general", "general pose, axes to 1:8, principal point off the middle", s, 107, ["gsplat"])
    harmonics()


if __name__ == "__main__":
    main()
