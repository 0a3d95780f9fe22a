"""Both pyramids, the 7x7 blur and the Scharr derivatives by OpenCV.

    pip install numpy==2.4.6 opencv-python-headless==5.0.0.93
    python3 tests/golden/gen/pyramid.py
"""

import cv2
import numpy as np

import pictures
from case import write_case


def orb_levels(image, factor=1.2, count=8):
    """Scales and sizes in ORB-SLAM's float32; each level INTER_LINEAR of the level before."""
    scales = [np.float32(1)]
    for _ in range(count - 1):
        scales.append(np.float32(np.float64(scales[-1]) * np.float64(np.float32(factor))))
    levels = [image]
    for scale in scales[1:]:
        inverse = np.float32(1) / scale
        size = [int(np.rint(np.float32(n) * inverse)) for n in image.shape[::-1]]
        levels.append(cv2.resize(levels[-1], size, interpolation=cv2.INTER_LINEAR))
    return np.array(scales), levels


PICTURES = {
    "noise": (pictures.noise(131, 97, 17), 17, "every weight matters, odd sizes"),
    "texture": (pictures.texture(160, 120, 5), 5, "even sizes"),
    "slim": (pictures.noise(7, 64, 2), 2, "levels narrower than the blur: reflection reaches the other side"),
}

if __name__ == "__main__":
    for name, (image, seed, why) in PICTURES.items():
        scales, levels = orb_levels(image)
        outputs = {"scales": (scales, "1", "exact")}
        outputs |= {f"orb_{l}": (level, "1", "exact") for l, level in enumerate(levels) if l > 0}
        half = image
        for l in (1, 2, 3):
            half = cv2.pyrDown(half)
            outputs[f"half_{l}"] = (half, "1", "exact")
        outputs["gauss7"] = (cv2.GaussianBlur(image, (7, 7), 2, borderType=cv2.BORDER_REFLECT_101), "1", "exact")
        for axis, dx in (("x", 1), ("y", 0)):
            scharr = cv2.Scharr(image, cv2.CV_16S, dx, 1 - dx, borderType=cv2.BORDER_REFLECT_101)
            outputs[f"scharr_{axis}"] = (scharr, "1", "exact")
        write_case("pyramid", name, basis="opencv", why=why, script="gen/pyramid.py", seed=seed,
                   equations=["paper:16"], inputs={"image": (image, "1")}, outputs=outputs)
