"""Labels of Gaussians from the definitions in numpy (f64) and mpmath, all labellings in plain Python.

    pip install numpy==2.4.6 mpmath==1.3.0
    python3 tests/golden/gen/crf.py

Stages unary (eq. 2, 3), kernel (eq. 5, 6), mean_field (eq. 1, 4) and label_window (eq. 7). NaN in an
input means that the node lacks the number. Every reading is named in `params`.
"""

import itertools
import math

import mpmath
import numpy as np

from case import write_case

SCRIPT = "gen/crf.py"
mpmath.mp.dps = 50
M = mpmath.mpf

# One number per cue: reprojection, depth, observations, epipolar.
TABLE = ["mean", "sigma", "weight"]
SIDES = {"above": lambda d: max(d, M(0)), "below": lambda d: min(d, M(0)), "both": lambda d: d}
DEFAULT_UNARY = dict(
    mean=[1.7, 1.0, 5.4, 0.3], sigma=[0.6, 1.0, 1.5, 0.2], side=["above", "above", "below", "above"],
    weight=[1.0, 1.0, 1.0, 1.0], height="unit", pooling="mean", clamp=1e-3, min_observations=2,
    score="soft", threshold=0.8, threshold_with_epipolar=1.0, confidence=0.7)


# --- unary ---------------------------------------------------------------------------------------

def likelihood(x, mean, sigma, side, height):
    d = SIDES[side](M(x) - M(mean)) / M(sigma)
    value = mpmath.exp(-d * d / 2)
    return value / (M(sigma) * mpmath.sqrt(2 * mpmath.pi)) if height == "density" else value


def unary(cues, o):
    """(mixture or None, P, u = ln((1 - P) / P)) of one node."""
    present = [k for k in range(4) if not math.isnan(cues[k]) and o["weight"][k] > 0]
    if not present:
        return None, M(1) / 2, M(0)
    total = sum(M(o["weight"][k]) for k in present)
    values = [(M(o["weight"][k]) / total, likelihood(cues[k], o["mean"][k], o["sigma"][k], o["side"][k], o["height"])) for k in present]
    if o["pooling"] == "mean":
        mixture = sum(w * v for w, v in values)
    else:
        mixture = mpmath.fprod(v ** w for w, v in values)
    if not math.isnan(cues[2]) and cues[2] < o["min_observations"]:
        return mixture, M(1) / 2, M(0)
    p = mixture
    if o["score"] != "soft":
        score = mixture * (total if o["score"] == "sum" else 1)
        limit = o["threshold"] if math.isnan(cues[3]) else o["threshold_with_epipolar"]
        p = M(o["confidence"]) if score >= M(limit) else 1 - M(o["confidence"])
    p = min(max(p, M(o["clamp"])), 1 - M(o["clamp"]))
    return mixture, p, mpmath.log((1 - p) / p)


def unary_case(case, why, cues, seed=None, **options):
    o = DEFAULT_UNARY | options
    answers = [unary(row, o) for row in cues]
    f = lambda column: np.array([math.nan if a[column] is None else float(a[column]) for a in answers])
    outputs = {"p_static": (f(1), "1", "crf.unary"), "log_odds": (f(2), "nat", "crf.log_odds")}
    if all(a[0] is not None for a in answers):
        outputs = {"mixture": (f(0), "1", "crf.unary")} | outputs
    write_case("unary", case, basis="mpmath-50", why=why, script=SCRIPT, equations=["paper:2", "paper:3"],
               params={k: v for k, v in o.items() if k not in TABLE} | {"side": " ".join(o["side"])},
               inputs={"cues": (np.array(cues, dtype=float), "px, sigma, 1, px")} | {k: (np.array(o[k], dtype=float), "per cue") for k in TABLE},
               outputs=outputs, seed=seed)


def unary_cases():
    nan = math.nan
    by_hand = [[1.7, 1.0, 6, 0.3], [2.3, nan, nan, nan], [2.9, nan, 7, nan], [nan, 3.0, nan, 0.5], [0.0, 0.0, 5, 0.0],
               [nan, nan, nan, nan], [9.0, 9.0, 1, 9.0], [9.0, 9.0, 2, 9.0]]
    unary_case("by_hand", "zero, one and two sigma on the bad side; missing cues; one observation has no say", by_hand)
    rng = np.random.default_rng(71)
    cues = np.column_stack([rng.gamma(2, 1.0, 120), np.abs(rng.normal(0, 2, 120)), rng.integers(0, 16, 120), rng.gamma(1, 0.4, 120)])
    cues[rng.random(cues.shape) < 0.2] = nan
    unary_case("noise_120", "a fifth of the numbers missing", cues.tolist(), seed=71)
    full = cues[~np.isnan(cues).any(axis=1)][:40].tolist()
    both = ["both"] * 4
    unary_case("literal_density", "eq. 2 to the letter: two-sided densities, whose mixture exceeds 1 and is clamped", full,
               side=both, height="density", weight=[0.4, 0.2, 0.2, 0.2])
    unary_case("two_sided", "two-sided, peaks of 1", full, side=both)
    unary_case("geometric", "weighted geometric mean", full, pooling="geometric", weight=[1.0, 2.0, 0.0, 0.5])
    for score in ("mean", "sum"):
        unary_case(f"hard_{score}", "label first, then its confidence; thresholds without and with an epipolar distance",
                   cues[:60].tolist(), side=both, score=score, min_observations=0,
                   threshold_with_epipolar=0.8 if score == "mean" else 1.0)


# --- kernels and mean field -----------------------------------------------------------------------

DEFAULT_FIELD = dict(
    feature_weight=1.0, sigma_reproj_px=0.6, sigma_observations=1.5, position_weight=3.0, sigma_m=0.5,
    sigma_px=18.0, distance="squared", terms="both", normalisation="rows", self_message=True, damping=0.0)


def kernels(nodes, o):
    """k1 and k2 of all pairs, j = i included."""
    alpha, gamma, p, uv = (np.asarray(nodes[k], dtype=float) for k in ("reproj_px", "observations", "p_world", "uv_px"))
    between = lambda x: x[:, None] - x[None, :]
    k1 = np.exp(-between(alpha) ** 2 / (2 * o["sigma_reproj_px"] ** 2) - between(gamma) ** 2 / (2 * o["sigma_observations"] ** 2))
    k1 = np.where(np.isnan(k1), 0.0, k1)
    space = (between(p) ** 2).sum(axis=2)
    pixel = (between(uv) ** 2).sum(axis=2)
    if o["terms"] == "both":
        pixel = np.where(np.isnan(pixel), 0.0, pixel)
    if o["terms"] == "space":
        pixel = np.zeros_like(space)
    if o["terms"] == "pixel":
        space = np.zeros_like(space)
    if o["distance"] == "linear":
        space, pixel = np.sqrt(space), np.sqrt(pixel)
    k2 = np.exp(-space / (2 * o["sigma_m"] ** 2) - pixel / (2 * o["sigma_px"] ** 2))
    return k1, np.where(np.isnan(k2), 0.0, k2)


def coupling(nodes, o):
    """The matrix A of q -> sigmoid(u + A (2 q - 1))."""
    total = 0.0
    for k, weight in zip(kernels(nodes, o), (o["feature_weight"], o["position_weight"])):
        if not o["self_message"]:
            k = k - np.diag(np.diag(k))
        r = k.sum(axis=1)
        inverse = np.divide(1.0, r, out=np.zeros_like(r), where=r > 0)
        if o["normalisation"] == "rows":
            k = k * inverse[:, None]
        if o["normalisation"] == "symmetric":
            k = k * np.sqrt(inverse[:, None] * inverse[None, :])
        total = total + weight * k
    return total


def sigmoid(x):
    e = np.exp(-np.abs(x))
    return np.where(x >= 0, 1.0, e) / (1.0 + e)


def beliefs(nodes, log_odds, o, counts):
    a, u = coupling(nodes, o), np.asarray(log_odds)
    q = sigmoid(u)
    answers = []
    for iteration in range(max(counts) + 1):
        if iteration in counts:
            answers.append(q)
        q = (1 - o["damping"]) * sigmoid(u + a @ (2 * q - 1)) + o["damping"] * q
    return np.array(answers)


def node_inputs(nodes):
    units = {"p_world": "m", "uv_px": "px", "reproj_px": "px", "observations": "1"}
    return {name: (np.asarray(nodes[name], dtype=float), unit) for name, unit in units.items()}


def field_case(case, why, nodes, log_odds, counts=(0, 1, 5, 10), extra=None, basis="numpy-f64", seed=None, **options):
    o = DEFAULT_FIELD | options
    q = beliefs(nodes, log_odds, o, counts)
    outputs = {"q": (q, "1", "crf.q")}
    if np.abs(q[-1] - 0.5).min() > 1e-3:
        outputs["labels"] = ((q[-1] > 0.5).astype(np.uint8), "1", "exact")
    write_case("mean_field", case, basis=basis, why=why, script=SCRIPT, equations=["paper:1", "paper:4", "paper:5", "paper:6"],
               seed=seed, params=o | {"iterations": " ".join(map(str, counts))},
               inputs=node_inputs(nodes) | {"log_odds": (np.asarray(log_odds, dtype=float), "nat")},
               outputs=outputs | (extra or {}))


def kernel_case(case, why, nodes, **options):
    o = DEFAULT_FIELD | options
    k1, k2 = kernels(nodes, o)
    write_case("kernel", case, basis="numpy-f64", why=why, script=SCRIPT, equations=["paper:5", "paper:6"], params=o,
               inputs=node_inputs(nodes), outputs={"k1": (k1, "1", "crf.kernel"), "k2": (k2, "1", "crf.kernel")})


def cloud(n, seed, missing=0.0):
    rng = np.random.default_rng(seed)
    moves = rng.random(n) < 0.3
    z = np.where(moves, rng.uniform(1.8, 2.2, n), rng.uniform(1.0, 5.0, n))
    u = np.where(moves, rng.uniform(270, 370, n), rng.uniform(0, 640, n))
    v = rng.uniform(0, 480, n)
    nodes = {
        "p_world": np.column_stack([(u - 320) * z / 535, (v - 240) * z / 535, z]),
        "uv_px": np.column_stack([u, v]),
        "reproj_px": np.abs(np.where(moves, 3.0, 0.9) + rng.normal(0, 0.5, n)),
        "observations": np.where(moves, rng.integers(1, 5, n), rng.integers(3, 20, n)).astype(float),
    }
    nodes["uv_px"][rng.random(n) < missing] = math.nan
    nodes["reproj_px"][rng.random(n) < missing] = math.nan
    nodes["observations"][rng.random(n) < missing] = math.nan
    return nodes, np.where(moves, 1.5, -2.0) + rng.normal(0, 1.2, n)


def row_of(xs, pixels, reproj=None, observations=None):
    nan = [math.nan] * len(xs)
    return {"p_world": [[x, 0.0, 2.0] for x in xs], "uv_px": [[u, 240.0] for u in pixels],
            "reproj_px": reproj or nan, "observations": observations or nan}


def enumerated(nodes, log_odds, o):
    """MAP, ln Z, marginals over all labellings in exact-ish arithmetic, and F of the coins q."""
    j = coupling(nodes, o)
    n = len(log_odds)
    energy = {}
    for x in itertools.product((0, 1), repeat=n):
        e = [-log_odds[i] for i in range(n) if x[i]]
        e += [j[a, b] for a in range(n) for b in range(a + 1, n) if x[a] != x[b]]
        energy[x] = math.fsum(e)
    best = min(energy, key=energy.get)
    weights = {x: mpmath.exp(-M(e)) for x, e in energy.items()}
    z = mpmath.fsum(weights.values())
    marginals = [float(mpmath.fsum(w for x, w in weights.items() if x[i]) / z) for i in range(n)]
    q = beliefs(nodes, log_odds, o, [40])[0]
    entropy = lambda p: p * math.log(p) if p > 0 else 0.0
    free = [-q[i] * log_odds[i] + entropy(q[i]) + entropy(1 - q[i]) for i in range(n)]
    free += [j[a, b] * (q[a] * (1 - q[b]) + q[b] * (1 - q[a])) for a in range(n) for b in range(a + 1, n)]
    return {
        "map": (np.array(best, dtype=np.uint8), "1", "exact"),
        "map_energy": (np.array([energy[best]]), "nat", "crf.energy"),
        "log_z": (np.array([float(mpmath.log(z))]), "nat", "crf.energy"),
        "marginals": (np.array(marginals), "1", "crf.q"),
        "free_energy": (np.array([math.fsum(free)]), "nat", "crf.energy"),
    }


def field_cases():
    two = row_of([0.0, 0.5], [300.0, 318.0])
    field_case("two_by_hand", "one sigma apart in metres and in pixels: k2 = e^-1; u = (2, 0); first message to the second: 3 e^-1 tanh(1)",
               two, [2.0, 0.0], counts=(0, 1, 2), feature_weight=0.0, normalisation="none", self_message=False)
    three = row_of([0.0, 0.0, 9.0], [300.0, 300.0, 300.0], [1.0, 1.6, 1.0], [4.0, 4.0, 7.0])
    field_case("three_by_hand", "two twins in place, one far away; features one sigma apart, or two; the mean over the row includes the node itself",
               three, [1.0, -0.5, 0.25], counts=(0, 1, 2))
    literal = dict(normalisation="none", self_message=False)
    nodes, log_odds = cloud(12, 5)
    o = DEFAULT_FIELD | literal | dict(feature_weight=0.1, position_weight=0.4)
    field_case("twelve_enumerated", "all 4096 labellings: least energy, ln Z, marginals; free energy of the settled coins", nodes, log_odds,
               counts=(0, 5, 40), seed=5, extra=enumerated(nodes, log_odds, o), basis="enumeration", **literal, feature_weight=0.1, position_weight=0.4)
    nodes, log_odds = cloud(64, 6)
    field_case("rows_64", "the defaults", nodes, log_odds, seed=6)
    field_case("rows_64_without_self", "as the defaults, j = i left out", nodes, log_odds, seed=6, self_message=False)
    field_case("none_64", "eq. 4 to the letter, but for squares in eq. 6", nodes, log_odds, seed=6, **literal,
               feature_weight=0.05, position_weight=0.5)
    field_case("symmetric_64", "normalised by the roots of both row sums", nodes, log_odds, seed=6, normalisation="symmetric")
    field_case("linear_64", "eq. 6 as printed", nodes, log_odds, seed=6, distance="linear")
    field_case("lc_crf_64", "weights 10 and 30, pixels alone, five iterations", nodes, log_odds, counts=(0, 1, 5), seed=6,
               feature_weight=10.0, position_weight=30.0, terms="pixel")
    field_case("damped_64", "half of the old belief stays", nodes, log_odds, seed=6, damping=0.5)
    nodes, log_odds = cloud(64, 7, missing=0.25)
    field_case("missing_64", "a quarter of pixels, errors and counts missing", nodes, log_odds, seed=7)


def kernel_cases():
    kernel_case("three_by_hand", "one and two sigma", row_of([0.0, 0.5, 1.0], [300.0, 318.0, 300.0], [1.0, 1.6, 2.2], [4.0, 4.0, 7.0]))
    nodes, _ = cloud(12, 8, missing=0.2)
    for distance in ("squared", "linear"):
        for terms in ("both", "space", "pixel"):
            kernel_case(f"{distance}_{terms}_12", "a fifth of pixels, errors and counts missing", nodes, distance=distance, terms=terms)


# --- label window ---------------------------------------------------------------------------------

def window_cases():
    rng = np.random.default_rng(9)
    histories = {
        "ten_then_out": [1] * 12,
        "one_pardon": [1] * 9 + [0] + [1] * 11,
        "noise_60": (rng.random(60) < 0.9).astype(int).tolist(),
    }
    for name, labels in histories.items():
        for reading, length in (("static_share", 10), ("literal", 11)):
            score = np.full(len(labels), math.nan)
            removed = np.zeros(len(labels), dtype=np.uint8)
            for k in range(length - 1, len(labels)):
                static = sum(1 - x for x in labels[k - length + 1:k + 1])
                score[k] = static / 10 if reading == "static_share" else 1 - static / 10
                removed[k] = static == (0 if reading == "static_share" else 10)
            seen = ~np.isnan(score)
            write_case("label_window", f"{name}_{reading}", basis="closed-form", why="S of eq. 7 after each run from the one that fills the window",
                       script=SCRIPT, equations=["paper:7"], params={"runs": 10, "reading": reading, "first": int(length - 1)},
                       inputs={"labels": (np.array(labels, dtype=np.uint8), "1")},
                       outputs={"score": (score[seen], "1", "crf.score"), "removed": (removed, "1", "exact")})


unary_cases()
kernel_cases()
field_cases()
window_cases()
