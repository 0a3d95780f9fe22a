"""Nearest neighbours in Hamming distance: brute force by numpy, mutual matches also by OpenCV.

    pip install numpy==2.4.6 opencv-python-headless==5.0.0.93
    python3 tests/golden/gen/matching.py
"""

import cv2
import numpy as np

from case import write_case


def descriptors(n, m, seed, common, flips):
    """`common` train descriptors are queries with up to `flips` bits turned over."""
    rng = np.random.default_rng(seed)
    query = rng.integers(0, 256, (n, 32), dtype=np.uint8)
    train = rng.integers(0, 256, (m, 32), dtype=np.uint8)
    for i, j in zip(rng.permutation(n)[:common], rng.permutation(m)[:common]):
        bits = np.unpackbits(query[i])
        bits[rng.integers(0, 256, rng.integers(0, flips + 1))] ^= 1
        train[j] = np.packbits(bits)
    return query, train


def coarse(n, m, seed):
    """Four bits that vary: ties everywhere."""
    rng = np.random.default_rng(seed)
    query, train = np.zeros((n, 32), np.uint8), np.zeros((m, 32), np.uint8)
    query[:, 3], train[:, 3] = rng.integers(0, 16, n), rng.integers(0, 16, m)
    return query, train


def answers(query, train):
    distance = np.unpackbits(query[:, None] ^ train[None], axis=2).sum(2).astype(np.int32)
    nearest = distance.argmin(1)  # the first of equals
    ordered = np.sort(distance, axis=1)
    back = distance.argmin(0)
    mutual = np.array([(q, t) for q, t in enumerate(nearest) if back[t] == q], np.int32)
    return distance, {
        "nearest": (nearest.astype(np.int32), "1", "exact"),
        "distance": (ordered[:, 0], "bits", "exact"),
        "second": (ordered[:, 1], "bits", "exact"),
        "mutual": (mutual, "1", "exact"),
    }


for name, (query, train), seed, why in [
    ("noisy_pairs", descriptors(300, 260, 21, 200, 60), 21, "200 true pairs with up to 60 bits off"),
    ("ties", coarse(60, 50, 22), 22, "equal distances: the lowest index wins"),
]:
    distance, outputs = answers(query, train)
    matched = cv2.BFMatcher(cv2.NORM_HAMMING).match(query, train)
    assert all(distance[m.queryIdx, m.trainIdx] == m.distance == outputs["distance"][0][m.queryIdx] for m in matched)
    write_case("matching", name, basis="opencv", why=why, script="gen/matching.py", seed=seed,
               inputs={"query": (query, "bits"), "train": (train, "bits")}, outputs=outputs)
