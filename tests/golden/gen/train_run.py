"""Golden case of a training run: four keyframes, sixty iterations, and everything about them that is a rule and not
an image. The gradients are inputs. From them follow, by the rules of docs/book/src/training.md,

    the view and the level of every iteration        newest and shuffled in turn; 2, 1, 0 (eq. 16)
    the rates                                        means with the extent of the path, harmonics by degree
    labels and what they remove                      eq. 7, n = 3
    clones, splits, pruning                          mean gradient in units of half an image, scales, opacity, age
    the views that stay                              of the two nearest the older goes

and the state of every Gaussian after each change: parameters, moments, sums, windows, age, label. f64 throughout; Adam
is the recurrence of O6. Draws are those of SplitMix64 (Steele, Lea, Flood 2014), of which the case holds what a port
needs: the swaps of the shuffles and the normals of the splits.

    Needs: numpy (2.4.6). Run: python3 train_run.py
"""

import math

import numpy as np
from case import write_case

MASK, GAMMA = 2**64 - 1, 0x9E3779B97F4A7C15
WIDTH, HEIGHT, ROWS = 44, 28, 18
SEED, RUNS, USES, SH_DEGREE, SH_EVERY, MAX_VIEWS = 11, 3, 3, 1, 14, 3
RATES = {"means": 0.01, "log_scales": 0.03, "quaternions": 0.02, "opacity_logits": 0.08, "sh": 0.05, "sh_rest_divisor": 8.0}
EVERY, THRESHOLD, YOUNG, SPLIT_EXTENT, LARGE_EXTENT, MIN_OPACITY, MAX_GAUSSIANS = 25, 0.02, 2, 0.03, 0.1, 0.1, 18
CHILDREN, SHRINK, AHEAD_M, YOUNG_SHARE = 2, 1.6, 2.5, 4
B1, B2, EPS = 0.9, 0.999, 1e-15
ITERATIONS = [12, 15, 16, 17]
RECORD_AFTER = [13, 15, 25, 26, 50, 60]
PARTS = {"means": (0, 3), "log_scales": (3, 6), "quaternions": (6, 10), "opacity_logits": (10, 11), "sh": (11, 23)}


class Draws:
    def __init__(self, seed, key):
        self.state = self.mix((seed + GAMMA) & MASK)
        for part in key:
            self.state = (self.mix(self.state ^ ((part + GAMMA) & MASK)) + GAMMA) & MASK

    @staticmethod
    def mix(z):
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
        return z ^ (z >> 31)

    def bits(self):
        self.state = (self.state + GAMMA) & MASK
        return self.mix(self.state)

    def below(self, n):
        return (self.bits() * n) >> 64

    def normal(self):
        uniform = lambda: (self.bits() >> 11) / 2**53
        radius = math.sqrt(-2 * math.log(1 - uniform()))
        return radius * math.cos(2 * math.pi * uniform())


def matrix(q):
    w, x, y, z = np.asarray(q) / np.linalg.norm(q)
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


def extent(centers):
    mean = np.mean(centers, axis=0)
    return max(1.1 * max(np.linalg.norm(c - mean) for c in centers), 1.0)


class Gaussian:
    def __init__(self, parameters, born, drive):
        self.p, self.m, self.v = np.array(parameters, float), np.zeros(23), np.zeros(23)
        self.born, self.label, self.window = born, 0, []
        self.sum, self.seen, self.drive = 0.0, 0, drive

    def copy(self):
        """The parameters, label, age and window of the parent; no moments."""
        other = Gaussian(self.p, self.born, self.drive)
        other.label, other.window = self.label, list(self.window)
        return other


def clear(value, threshold):
    """Rounding in f32 must not decide."""
    assert abs(value / threshold - 1) > 1e-3, (value, threshold)
    return value


class Run:
    def __init__(self):
        self.map, self.views, self.order, self.uses = [], [], [], {}
        self.draws, self.t, self.degree = Draws(SEED, [0x7261696E]), 0, 0
        self.swaps, self.normals, self.counts = [], [], {"clone": 0, "split": 0, "faded": 0, "large": 0, "old": 0, "full": 0}
        self.rng = np.random.default_rng(83)

    def pick(self, i):
        if i % 2 == 0:
            return len(self.views) - 1
        if not self.order:
            self.order = list(range(len(self.views)))
            for k in range(len(self.order) - 1, 0, -1):
                self.swaps.append(self.draws.below(k + 1))
                self.order[k], self.order[self.swaps[-1]] = self.order[self.swaps[-1]], self.order[k]
        return self.order.pop()

    def thin(self, poses):
        while len(self.views) > MAX_VIEWS:
            places = []
            for v in self.views:
                rotation, translation = poses[v]
                center = -rotation.T @ translation
                places.append((center, center + rotation.T @ np.array([0, 0, AHEAD_M])))
            old = len(places) - len(places) // YOUNG_SHARE
            apart = lambda a, b: sum(np.linalg.norm(p - q) for p, q in zip(places[a], places[b]))
            pairs = sorted((apart(a, b), a) for a in range(old) for b in range(a + 1, len(places)))
            clear(pairs[0][0], pairs[1][0])
            gone = pairs[0][1]
            del self.views[gone]
            self.order = [v - (v > gone) for v in self.order if v != gone]

    def gradients(self, level):
        """Random; at the centre as large as the Gaussian's drive wants it. Dynamic ones are not rendered."""
        g, px, visible = np.zeros((ROWS, 23), np.float32), np.zeros((ROWS, 2), np.float32), np.zeros(ROWS, np.uint8)
        half = np.array([math.ceil(WIDTH / 2**level), math.ceil(HEIGHT / 2**level)]) / 2
        for r, one in enumerate(self.map):
            rare = one.drive > 2
            visible[r] = not one.label and (self.rng.uniform() < (0.2 if rare else 0.8))
            row = self.rng.normal(size=23) * (1 + 0.4 * math.sin(r))
            keep = np.ones(23, bool) if visible[r] else np.arange(23) == 10
            g[r] = np.where(keep & (visible[r] | one.label), row, 0)
            angle = self.rng.uniform(0, 2 * math.pi)
            size = one.drive * THRESHOLD * self.rng.uniform(0.9, 1.1)
            px[r] = size * np.array([math.cos(angle), math.sin(angle)]) / half
        return g, px, visible

    def step(self, g, px, visible, level, extent_m):
        self.t += 1
        columns = 11 + 3 * (self.degree + 1) ** 2
        rates = np.zeros(23)
        for name, (a, b) in PARTS.items():
            rates[a:b] = RATES[name]
        rates[:3] *= extent_m
        rates[14:] /= RATES["sh_rest_divisor"]
        half = np.array([math.ceil(WIDTH / 2**level), math.ceil(HEIGHT / 2**level)]) / 2
        for r, one in enumerate(self.map):
            gradient = np.where(np.arange(23) < columns, g[r].astype(float), 0)
            one.m = B1 * one.m + (1 - B1) * gradient
            one.v = B2 * one.v + (1 - B2) * gradient**2
            one.p -= rates * (one.m / (1 - B1**self.t)) / (np.sqrt(one.v / (1 - B2**self.t)) + EPS)
            if visible[r]:
                one.sum += np.linalg.norm(px[r].astype(float) * half)
                one.seen += 1
        if self.t % EVERY == 0:
            self.densify(extent_m)
        return [rates[0], rates[3], rates[6], rates[10], rates[11], rates[14]]

    def densify(self, extent_m):
        draws, before, split = Draws(SEED, [0x67726F77, self.t]), list(self.map), set()
        young_from = max(self.views[-1] - YOUNG, 0)
        for one in before:
            mean = clear(one.sum / one.seen, THRESHOLD) if one.seen else 0.0
            if one.label or mean < THRESHOLD:
                continue
            if one.born < young_from:
                self.counts["old"] += 1
                continue
            if len(self.map) + CHILDREN > MAX_GAUSSIANS:
                self.counts["full"] += 1
                break
            sigma = np.exp(one.p[3:6])
            if clear(sigma.max(), SPLIT_EXTENT * extent_m) <= SPLIT_EXTENT * extent_m:
                self.map.append(one.copy())
                self.counts["clone"] += 1
                continue
            split.add(one)
            self.counts["split"] += 1
            for _ in range(CHILDREN):
                child = one.copy()
                normals = [draws.normal() for _ in range(3)]
                self.normals += normals
                child.p[:3] += matrix(one.p[6:10]) @ (sigma * normals)
                child.p[3:6] -= math.log(SHRINK)
                self.map.append(child)
        stay = []
        for one in self.map:
            one.sum, one.seen = 0.0, 0
            faded = clear(1 / (1 + math.exp(-one.p[10])), MIN_OPACITY) < MIN_OPACITY and not one.label
            large = clear(np.exp(one.p[3:6].max()), LARGE_EXTENT * extent_m) > LARGE_EXTENT * extent_m and not one.label
            self.counts["faded"] += faded
            self.counts["large"] += large and one not in split
            if not (faded or large or one in split):
                stay.append(one)
        self.map = stay

    def label(self, labels):
        """-1: not labelled. Dynamic in each of the last n runs: removed (eq. 7)."""
        for one, label in zip(self.map, labels):
            if label >= 0:
                one.label = int(label)
                one.window.append(one.label)
        gone = [one for one in self.map if len(one.window) >= RUNS and all(one.window[-RUNS:])]
        self.map = [one for one in self.map if one not in gone]
        return len(gone)


def newcomers():
    """Per keyframe: mean, standard deviations, quaternion, opacity, drive of the gradient in thresholds."""
    turned = (0.9, 0.3, -0.2, 0.25)
    return [
        [((0.1, 0.2, 2.0), (0.02, 0.03, 0.025), (1, 0, 0, 0), 0.7, 1.5),       # cloned, later too old
         ((-0.4, 0.1, 2.2), (0.03, 0.13, 0.02), turned, 0.8, 1.4),             # split
         ((0.5, -0.3, 1.8), (0.02, 0.02, 0.02), (1, 0, 0, 0), 0.6, 1.6),       # dynamic thrice: removed
         ((0.3, 0.4, 2.5), (0.03, 0.02, 0.02), (1, 0, 0, 0), 0.03, 0.5),       # fades
         ((-0.2, -0.4, 1.9), (0.02, 0.04, 0.03), (1, 0, 0, 0), 0.03, 0.6),     # faded, but dynamic
         ((0.6, 0.1, 2.1), (0.04, 0.02, 0.03), turned, 0.5, 0.8),              # left as it is
         ((-0.6, 0.5, 3.0), (0.5, 0.05, 0.3), (1, 0, 0, 0), 0.9, 0.7)],        # too large
        [((0.2, -0.1, 2.4), (0.02, 0.025, 0.03), (1, 0, 0, 0), 0.55, 1.3),     # cloned
         ((0.0, 0.3, 2.6), (0.02, 0.02, 0.02), turned, 0.65, 2.5)],            # rarely seen: a mean over fewer
        [((-0.3, 0.2, 2.3), (0.02, 0.28, 0.05), turned, 0.75, 1.7)],           # split in the second round
        [((0.4, 0.3, 2.7), (0.03, 0.02, 0.02), (1, 0, 0, 0), 0.6, 1.6)],       # no room for its clone
    ]


def main():
    turn = lambda a, b: np.array([math.cos(a / 2), 0.3 * math.sin(a / 2), math.sqrt(1 - 0.09) * math.sin(a / 2) * math.cos(b), math.sqrt(1 - 0.09) * math.sin(a / 2) * math.sin(b)])
    q = [turn(0.2, 0.1), turn(0.5, -0.2), turn(0.6, -0.1), turn(-0.7, 0.4)]
    centers = [np.array(c) for c in ((0.0, 0.0, 0.0), (3.0, 0.5, 0.2), (3.3, 0.7, 0.1), (6.5, -1.0, 1.2))]
    poses = [(matrix(a), -matrix(a) @ c) for a, c in zip(q, centers)]
    labels = np.full((4, ROWS), -1, np.int8)
    run, new, shuffled = Run(), newcomers(), []
    out = {name: [] for name in ["picks", "gaussians", "degree", "rates", "extent", "views"]}
    state = {name: [] for name in ["rows", "parameters", "first_moments", "second_moments", "gradient_sums", "seen",
                                   "window_runs", "window_dynamic", "born", "labels"]}
    given = {name: [] for name in ["gradient", "gradient_px", "visible"]}

    def record():
        state["rows"].append(len(run.map))
        for one in run.map:
            for name, value in (("parameters", one.p.copy()), ("first_moments", one.m), ("second_moments", one.v),
                                ("gradient_sums", one.sum), ("seen", one.seen), ("window_runs", len(one.window)),
                                ("window_dynamic", sum(one.window[-RUNS:])), ("born", one.born), ("labels", one.label)):
                state[name].append(value)

    removed = []
    rows = np.zeros((0, 14), np.float32)
    for k, iterations in enumerate(ITERATIONS):
        for r, one in enumerate(run.map):
            labels[k, r] = label_of(one, k)
        removed.append(run.label(labels[k]))
        for mean, sigma, quaternion, opacity, drive in new[k]:
            color = run.rng.uniform(-1, 1, 3)
            row = np.array([*mean, *np.log(sigma), *quaternion, math.log(opacity / (1 - opacity)), *color], np.float32)
            rows = np.vstack([rows, row])
            run.map.append(Gaussian([*row.astype(float), *np.zeros(9)], k, drive))
        run.views.append(k)
        run.uses[k] = 0
        run.thin(poses[: k + 1])
        out["views"] += run.views
        extent_m = extent(centers[: k + 1])
        out["extent"].append(extent_m)
        record()
        for i in range(iterations):
            view = run.views[run.pick(i)]
            run.degree = max(run.degree, min(run.t // SH_EVERY, SH_DEGREE))
            level = max(2 - run.uses[view] // USES, 0)
            run.uses[view] += 1
            g, px, visible = run.gradients(level)
            for name, value in zip(given, (g, px, visible)):
                given[name].append(value)
            out["rates"].append(run.step(g, px, visible, level, extent_m))
            out["picks"].append((view, level))
            out["degree"].append(run.degree)
            out["gaussians"].append(len(run.map))
            if run.t in RECORD_AFTER:
                record()
        assert len(run.map) <= MAX_GAUSSIANS <= ROWS
    print(run.counts, "removed by labels:", removed, "views:", out["views"], "gaussians:", sorted(set(out["gaussians"])))
    print("levels:", np.bincount([p[1] for p in out["picks"]]), "rows:", state["rows"])
    assert run.counts["clone"] >= 3 and run.counts["split"] >= 2 and min(run.counts.values()) >= 1 and sum(removed) == 1
    exact, close = lambda x: (np.array(x, np.int64), "1", "exact"), lambda x, unit, tol: (np.array(x, np.float64), unit, tol)
    write_case("train_run", "four_keyframes", basis="numpy: the rules of docs/book/src/training.md replayed in f64", script="gen/train_run.py", seed=83,
               equations=["paper:7", "paper:16", "O6"],
               why="views, levels, rates, labels, clones, splits, pruning, thinning, and the state of every Gaussian after each",
               params={"width": WIDTH, "height": HEIGHT, "seed": SEED, "runs": RUNS, "uses_per_level": USES, "sh_degree": SH_DEGREE,
                       "sh_every": SH_EVERY, "max_views": MAX_VIEWS, "beta1": B1, "beta2": B2, "eps": EPS, "every": EVERY,
                       "grad_threshold": THRESHOLD, "young_keyframes": YOUNG, "split_extent": SPLIT_EXTENT, "min_opacity": MIN_OPACITY,
                       "prune_large": True, "max_gaussians": MAX_GAUSSIANS, **{f"rate_{name}": rate for name, rate in RATES.items()}},
               inputs={"intrinsics": (np.array([40.0, 42.0, 21.3, 14.2]), "px: fx fy cx cy"),
                       "camera_from_world_q": (np.array(q), "w x y z"), "camera_from_world_t": (np.array([t for _, t in poses]), "m"),
                       "iterations": (np.array(ITERATIONS), "per keyframe"), "inserted": (np.array([len(n) for n in new]), "per keyframe"),
                       "new": (rows, "mean 3, log-scales 3, quaternion 4, opacity logit, colour coefficients of degree 0"),
                       "run_labels": (labels, "per keyframe and row, before insertion: 1 dynamic, -1 none"),
                       "record_after": (np.array(RECORD_AFTER), "iterations; and before the first of each keyframe"),
                       "gradient": (np.array(given["gradient"]), "per iteration and row: as the parameters, 12 of the harmonics"),
                       "gradient_px": (np.array(given["gradient_px"]), "1/px, at the centre"),
                       "visible": (np.array(given["visible"]), "1 rendered"),
                       "swaps": (np.array(run.swaps), "drawn for the shuffles, in their order"),
                       "normals": (np.array(run.normals), "drawn for the children, in their order")},
               outputs={**{name: exact(out[name]) for name in ("picks", "gaussians", "degree", "views")},
                        "rates": close(out["rates"], "means, log-scales, quaternions, opacity logits, harmonics of degree 0, others", "train_run.rate"),
                        "extent": close(out["extent"], "m", "train_run.rate"),
                        **{name: exact(state[name]) for name in ("rows", "seen", "window_runs", "window_dynamic", "born", "labels")},
                        "parameters": close(state["parameters"], "1", "train_run.parameter"),
                        "gradient_sums": close(state["gradient_sums"], "1", "train_run.sum"),
                        "first_moments": close(state["first_moments"], "1", "train_run.moment"),
                        "second_moments": close(state["second_moments"], "1", "train_run.moment")})


def label_of(one, k):
    """Who is labelled how at keyframe k, by drive and birth."""
    script = {(0, 1.5): (0, -1, 0), (0, 1.4): (0, 1, 0), (0, 1.6): (1, 1, 1), (0, 0.5): (0, 0, 0), (0, 0.6): (1, 0, 1),
              (0, 0.8): (-1, 0, -1), (0, 0.7): (0, 0, 0), (1, 1.3): (-1, 0, 0), (1, 2.5): (-1, -1, 0), (2, 1.7): (-1, -1, 0)}
    return script[(one.born, one.drive)][k - 1]


if __name__ == "__main__":
    main()
