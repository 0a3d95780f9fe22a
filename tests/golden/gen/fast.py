"""FAST-9/16 corners and scores by OpenCV.

    pip install numpy==2.4.6 opencv-python-headless==5.0.0.93
    python3 tests/golden/gen/fast.py
"""

import cv2
import numpy as np

import pictures
from case import write_case


def corners(image, threshold, suppress):
    detector = cv2.FastFeatureDetector_create(threshold, suppress, cv2.FAST_FEATURE_DETECTOR_TYPE_9_16)
    found = sorted((int(k.pt[1]), int(k.pt[0]), int(k.response)) for k in detector.detect(image))
    rows = np.array(found, np.int32).reshape(-1, 3)
    return rows[:, [1, 0]], rows[:, 2]


PICTURES = {
    "noise": (pictures.noise(131, 97, 17), 17, "corners everywhere, odd size, a last block of less than 16 pixels"),
    "texture": (pictures.texture(160, 120, 5), 5, "smooth structure: most pixels fail the first test"),
    "steps": (pictures.boxes(120, 90, 3, grain=0), 3, "equal neighbouring scores remove each other"),
    "flat": (np.full((20, 33), 77, np.uint8), None, "no corner at all"),
    "extremes": (np.where(pictures.noise(60, 40, 9) > 128, 255, 0).astype(np.uint8), 9, "0 and 255: sums that would wrap"),
}

for name, (image, seed, why) in PICTURES.items():
    for threshold in (20, 7):
        xy, score = corners(image, threshold, True)
        all_xy, _ = corners(image, threshold, False)
        write_case(
            "fast", f"{name}_{threshold}", basis="opencv", why=why, script="gen/fast.py", seed=seed,
            params={"threshold": threshold},
            inputs={"image": (image, "1")},
            outputs={
                "xy": (xy, "px", "exact"),
                "score": (score, "1", "exact"),
                "count_without_nms": (np.array(len(all_xy)), "1", "exact"),
            },
        )
