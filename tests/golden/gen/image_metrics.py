"""PSNR, SSIM and depth error.

    pip install numpy==2.4.6 scipy==1.17.1 opencv-python-headless==5.0.0
    python3 tests/golden/gen/image_metrics.py

PSNR by cv2.PSNR on bytes, SSIM from its definition on scipy.ndimage's separable filter in f64.
"""

import cv2
import numpy as np
from scipy import ndimage

from case import write_case

SCRIPT = "gen/image_metrics.py"
SEED = 81


def ssim_map(x, y):
    """Mean over channels; 11 taps of sigma 1.5, zeros outside; x, y [H, W, C] in [0, 1]."""
    taps = np.exp(-np.arange(-5, 6) ** 2 / (2 * 1.5**2))
    taps /= taps.sum()
    blur = lambda a: ndimage.correlate1d(ndimage.correlate1d(a, taps, 0, mode="constant"), taps, 1,
                                         mode="constant")
    mx, my = blur(x), blur(y)
    vx, vy, cov = blur(x * x) - mx * mx, blur(y * y) - my * my, blur(x * y) - mx * my
    c1, c2 = 1e-4, 9e-4
    return ((2 * mx * my + c1) * (2 * cov + c2) / ((mx * mx + my * my + c1) * (vx + vy + c2))).mean(axis=2)


def scene(height, width):
    """Edges, a gradient and texture, as bytes [H, W, 3]."""
    v, u = np.mgrid[0:height, 0:width].astype(np.float64)
    red = 40 + 170 * (u / width)
    green = 128 + 90 * np.sin(0.7 * u) * np.cos(0.5 * v)
    blue = np.where((u // 9 + v // 7) % 2 == 0, 30, 210)
    return np.clip(np.stack([red, green, blue], axis=2), 0, 255).astype(np.uint8)


def noisy(rng, picture, sigma):
    return np.clip(np.rint(picture + rng.normal(0, sigma, picture.shape)), 0, 255).astype(np.uint8)


def write_pictures(name, why, render, truth, mask=None):
    """render, truth u8 [H, W, C]."""
    x, y = render / 255.0, truth / 255.0
    outputs = {"ssim_map": (ssim_map(x, y), "1", "image_metrics.ssim_map"),
               "ssim": (ssim_map(x, y).mean(), "1", "image_metrics.ssim"),
               "psnr_db": (np.float64(cv2.PSNR(render, truth, 255.0)), "dB", "image_metrics.psnr")}
    inputs = {"render": (render, "1/255"), "truth": (truth, "1/255")}
    if mask is not None:
        judged = mask == 0
        covered = np.where(judged[:, :, None], x, y)
        # A picture of the judged pixels alone, for cv2.
        outputs["psnr_db_masked"] = (np.float64(cv2.PSNR(render[judged][None], truth[judged][None], 255.0)),
                                     "dB", "image_metrics.psnr")
        outputs["ssim_masked"] = (ssim_map(covered, y)[judged].mean(), "1", "image_metrics.ssim")
        inputs["mask"] = (mask, "1")
    write_case("image_metrics", name, basis="opencv-5.0.0, scipy-1.17.1", why=why, script=SCRIPT, seed=SEED,
               params={"kind": "picture"}, inputs=inputs, outputs=outputs)


def main():
    rng = np.random.default_rng(SEED)
    picture = scene(48, 64)
    write_pictures("noise", "noise of 8 grey levels on edges and texture", noisy(rng, picture, 8.0), picture)
    blurred = cv2.GaussianBlur(picture, (0, 0), 2.0)
    mask = np.zeros((48, 64), np.uint8)
    mask[10:40, 20:38] = 255
    mask[10:40, 38:40] = 128
    write_pictures("blurred_masked", "blur, a moving block and a strip of unknown pixels", blurred, picture, mask)
    write_pictures("tiny", "smaller than the window in both directions",
                   noisy(rng, picture[:7, :9], 20.0), picture[:7, :9])
    flat = np.full((12, 20, 3), 200, np.uint8)
    write_pictures("flat", "no texture: variances are rounding noise, C2 carries", flat - np.uint8(5), flat)
    write_pictures("grey", "one channel", noisy(rng, picture[:, :, :1], 15.0), picture[:, :, :1].copy())

    truth = np.float32(rng.uniform(0.5, 4.0, (9, 13)))
    render = (truth + rng.normal(0, 0.05, truth.shape)).astype(np.float32)
    truth[2, 3:7] = 0.0
    truth[4, 4] = np.nan
    render[5, :4] = 0.0
    render[6, 6] = np.nan
    mask = np.zeros(truth.shape, np.uint8)
    mask[7:, 5:9] = 255
    with np.errstate(invalid="ignore"):
        judged = (truth > 0) & (mask == 0)
        both = judged & (render > 0)
    error = np.abs(render[both].astype(np.float64) - truth[both].astype(np.float64))
    write_case("image_metrics", "depth", basis="closed-form", why="missing depth on either side, and a mask",
               script=SCRIPT, seed=SEED, params={"kind": "depth"},
               inputs={"render": (render, "m"), "truth": (truth, "m"), "mask": (mask, "1")},
               outputs={"mean": (error.mean(), "m", "image_metrics.depth"),
                        "pixels": (np.int64(both.sum()), "1", "exact"),
                        "coverage": (np.float64(both.sum() / judged.sum()), "1", "image_metrics.depth")})


if __name__ == "__main__":
    main()
