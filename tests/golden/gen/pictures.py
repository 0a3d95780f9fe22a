"""Test pictures made from nothing but a seed: no third party's photograph is in this repository.

    Needs: numpy (2.4.6), opencv-python-headless (5.0.0).
"""

import cv2
import numpy as np


def noise(width, height, seed):
    """Independent pixels, uniform in 0..255."""
    return np.random.default_rng(seed).integers(0, 256, (height, width), dtype=np.uint8)


def texture(width, height, seed, octaves=(1, 2, 4, 8, 16)):
    """Smooth structure of several sizes, contrast stretched to 8..247, as in a cluttered room."""
    rng = np.random.default_rng(seed)
    total = np.zeros((height, width))
    for size in octaves:
        grain = rng.standard_normal((height + 8 * size, width + 8 * size))
        smooth = cv2.GaussianBlur(grain, (0, 0), size)[4 * size:4 * size + height, 4 * size:4 * size + width]
        total += size ** 0.5 * smooth / smooth.std()
    low, high = np.percentile(total, [1, 99])
    return np.clip(8 + 239 * (total - low) / (high - low), 0, 255).astype(np.uint8)


def boxes(width, height, seed, grain=6):
    """Boxes of random place, size and shade with a little noise; grain 0 leaves clean steps,
    on which neighbouring corner scores are equal."""
    rng = np.random.default_rng(seed)
    image = np.full((height, width), 90, np.int32)
    for _ in range(width * height // 300):
        x, y = rng.integers(0, width), rng.integers(0, height)
        w, h = rng.integers(4, 28, 2)
        image[y:y + h, x:x + w] = rng.integers(0, 250)
    if grain:
        image += rng.integers(0, grain, image.shape)
    return image.clip(0, 255).astype(np.uint8)
