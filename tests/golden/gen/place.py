"""Scores of pictures as bags of words, by numpy and scipy alone.

Forty descriptors far apart stand for forty words; pictures are draws from them. With sampled bits each table then
has the same forty words, and the score is that of the draws themselves: 1 - cityblock / 2 of the L1-normalised weights
n_i ln(1 + N / N_i). (Two of forty descriptors that share 16 sampled bits would spoil this: the seed of the case is one
without.) Sixteen keyframes: rarities are counted anew at powers of two.

    Needs: numpy 2.4.6, scipy 1.17.1.
"""

import numpy as np
from scipy.spatial.distance import cityblock

from case import write_case


def main(seed=21, keyframes=16, queries=5, words=40):
    rng = np.random.default_rng(seed)
    patterns = rng.integers(0, 256, (words, 32), dtype=np.uint8)
    # Some words are common and some rare.
    share = 1 / np.arange(1, words + 1)
    share /= share.sum()
    length = rng.integers(10, 40, keyframes + queries)
    pictures = [rng.choice(words, n, p=share) for n in length]
    counts = np.array([np.bincount(p, minlength=words) for p in pictures], float)
    known = counts[:keyframes]
    rarity = np.log1p(keyframes / np.maximum((known > 0).sum(0), 1))
    weights = counts * rarity
    weights /= weights.sum(1, keepdims=True)
    scores = np.array([[1 - cityblock(q, k) / 2 for k in weights[:keyframes]] for q in weights[keyframes:]])
    write_case(
        "place", "bags_16x5", basis="numpy + scipy", why="rare words count more, and the longer picture not more than the shorter",
        script="gen/place.py", seed=seed, params={"tables": 4, "bits": 16, "seed": 1},
        inputs={"descriptors": (patterns[np.concatenate(pictures)], "1"), "length": (length.astype(np.int32), "1")},
        outputs={"score": (scores, "1", "place.score"),
                 "order": (np.argsort(-scores, axis=1, kind="stable").astype(np.int32), "1", "exact")},
    )


if __name__ == "__main__":
    main()
