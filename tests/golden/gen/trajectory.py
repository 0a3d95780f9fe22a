"""Trajectory alignment, absolute and relative errors.

    pip install numpy==2.4.6 scipy==1.17.1 mpmath==1.3.0 evo==1.38.1
    python3 tests/golden/gen/trajectory.py

- `umeyama_*`: the optimum in 50-digit arithmetic (mpmath), from the singular value
  decomposition of Umeyama 1991; the library under test uses Horn's quaternions instead.
- the others: association, absolute errors (no alignment, rigid, with scale) and relative errors
  over frames by evo; relative errors over 1 s from the definition, with scipy's rotations.
"""

import mpmath as mp
import numpy as np
from evo.core import metrics, sync
from evo.core.trajectory import PoseTrajectory3D
from scipy.spatial.transform import Rotation

from case import write_case

SCRIPT = "gen/trajectory.py"
MAX_DT_S = 0.02
ALIGNMENTS = {"none": None, "rigid": False, "similarity": True}  # value: with scale


# ---- alignment of points ----

def umeyama_50_digits(x, y, with_scale):
    """argmin of sum |y - (s R x + t)|^2, x and y [N, 3]."""
    mp.mp.dps = 50
    n = len(x)
    x = [mp.matrix(row) for row in x.tolist()]
    y = [mp.matrix(row) for row in y.tolist()]
    mean = lambda points: sum(points, mp.zeros(3, 1)) / n
    mean_x, mean_y = mean(x), mean(y)
    covariance = sum(((b - mean_y) * (a - mean_x).T for a, b in zip(x, y)), mp.zeros(3)) / n
    u, d, vt = mp.svd_r(covariance)
    sign = mp.diag([1, 1, mp.sign(mp.det(u) * mp.det(vt))])
    r = u * sign * vt
    variance = sum((a - mean_x).T * (a - mean_x) for a in x)[0] / n
    s = sum(d[i] * sign[i, i] for i in range(3)) / variance if with_scale else mp.mpf(1)
    t = mean_y - s * r * mean_x
    as_f64 = lambda m: np.array(m.tolist(), dtype=np.float64)
    return as_f64(r), as_f64(t)[:, 0], np.float64(s)


def write_umeyama(name, why, x, y, seed, rotation_tol="trajectory.rotation"):
    outputs = {}
    for alignment in ["rigid", "similarity"]:
        r, t, s = umeyama_50_digits(x, y, ALIGNMENTS[alignment])
        outputs[f"{alignment}_rotation"] = (r, "1", rotation_tol)
        outputs[f"{alignment}_translation"] = (t, "m", "trajectory.translation")
        outputs[f"{alignment}_scale"] = (s, "1", "trajectory.scale")
    write_case("trajectory", f"umeyama_{name}", basis="mpmath", why=why, script=SCRIPT, seed=seed,
               params={"kind": "alignment"}, inputs={"from": (x, "m"), "to": (y, "m")}, outputs=outputs)


def all_umeyama():
    rng = np.random.default_rng(71)
    cloud = lambda n, stretch: rng.normal(size=(n, 3)) * stretch
    turn = lambda: Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
    x = cloud(20, [1.0, 0.6, 0.3])
    noisy = 1.7 * x @ turn().T + [0.2, 1.2, -1.8] + 0.05 * rng.normal(size=x.shape)
    write_umeyama("noisy", "20 points, scale 1.7, noise of 5 cm", x, noisy, 71)
    mirrored = 0.8 * (x * [1, 1, -1]) @ turn().T + [3.0, 0.0, -2.0]
    write_umeyama("mirrored", "the unconstrained optimum is a reflection: the best proper rotation is wanted",
                  x, mirrored, 71)
    flat = cloud(15, [1.0, 0.7, 0.0])
    write_umeyama("planar", "points in a plane: the smallest singular value is 0",
                  flat, flat @ turn().T + [0.0, -0.5, 4.0], 71)
    narrow = cloud(15, [1.0, 1e-3, 1e-4])
    write_umeyama("narrow", "nearly on a line: 1 m by 1 mm by 0.1 mm",
                  narrow, narrow @ turn().T + [1.0, 1.0, 1.0], 71, rotation_tol="trajectory.rotation_narrow")
    x = cloud(3, 1.0)
    write_umeyama("three_points", "the smallest number of points that fixes a rotation",
                  x, x @ turn().T + 0.1 * rng.normal(size=(3, 3)), 71)
    x = cloud(20, 0.5)
    write_umeyama("far_away", "half a metre of motion, 10 km from the origin of both worlds",
                  x + [1e4, -1e4, 1e4], x @ turn().T + [-1e4, 1e4, 0.0], 71)


# ---- trajectories ----

def as_evo(t, poses):
    """poses [N, 7]: position, then qw qx qy qz."""
    return PoseTrajectory3D(poses[:, :3], poses[:, 3:], t)


def summary(error):
    """rmse, mean, median, std, min, max, sse."""
    return np.array([np.sqrt(np.mean(error**2)), error.mean(), np.median(error), error.std(),
                     error.min(), error.max(), np.sum(error**2)])


def evo_figures(gt, est):
    figures = {}
    ref_pairs, est_pairs = sync.associate_trajectories(gt, est, max_diff=MAX_DT_S)
    figures["pairs"] = (np.int64(est_pairs.num_poses), "1", "exact")
    figures["pair_times"] = (np.stack([ref_pairs.timestamps, est_pairs.timestamps], axis=1), "s", "exact")
    for alignment, with_scale in ALIGNMENTS.items():
        ref, aligned = ref_pairs, sync.copy.deepcopy(est_pairs)
        if with_scale is not None:
            r, t, s = aligned.align(ref, correct_scale=with_scale)
            figures[f"{alignment}_rotation"] = (r, "1", "trajectory.rotation_evo")
            figures[f"{alignment}_translation"] = (t, "m", "trajectory.translation_evo")
            figures[f"{alignment}_scale"] = (np.float64(s), "1", "trajectory.scale_evo")
        ape = metrics.APE(metrics.PoseRelation.translation_part)
        ape.process_data((ref, aligned))
        figures[f"{alignment}_ate"] = (summary(ape.error), "m", "trajectory.stats")
        figures[f"{alignment}_errors"] = (ape.error, "m", "trajectory.errors")
        for delta in [1, 30]:
            for kind, relation, unit in [("trans", metrics.PoseRelation.translation_part, "m"),
                                         ("rot", metrics.PoseRelation.rotation_angle_deg, "deg")]:
                rpe = metrics.RPE(relation, delta=delta, delta_unit=metrics.Unit.frames, all_pairs=True)
                rpe.process_data((ref, aligned))
                figures[f"{alignment}_rpe_{kind}_{delta}"] = (summary(rpe.error), unit, "trajectory.stats")
    return figures


def drift_per_second(gt_t, gt, est_t, est):
    """From each estimate to the one nearest 1 s later, except the last; the earlier pose seen
    from the later one. Plain loops over all partners."""
    def matrices(poses):
        m = np.tile(np.eye(4), (len(poses), 1, 1))
        m[:, :3, :3] = Rotation.from_quat(poses[:, [4, 5, 6, 3]]).as_matrix()
        m[:, :3, 3] = poses[:, :3]
        return m
    gt_m, est_m = matrices(gt), matrices(est)
    trans, rot = [], []
    for i, t in enumerate(est_t):
        j = int(np.argmin(np.abs(est_t - (t + 1.0))))
        if j == len(est_t) - 1 or abs(est_t[j] - t - 1.0) > 0.5:
            continue
        gi, gj = (int(np.argmin(np.abs(gt_t - est_t[k]))) for k in (i, j))
        if max(abs(gt_t[gi] - est_t[i]), abs(gt_t[gj] - est_t[j])) > MAX_DT_S:
            continue
        back = lambda later, earlier: np.linalg.inv(later) @ earlier
        e = np.linalg.inv(back(gt_m[gj], gt_m[gi])) @ back(est_m[j], est_m[i])
        trans.append(np.linalg.norm(e[:3, 3]))
        rot.append(np.degrees(np.linalg.norm(Rotation.from_matrix(e[:3, :3]).as_rotvec())))
    return {"second_rpe_steps": (np.int64(len(trans)), "1", "exact"),
            "second_rpe_trans": (summary(np.array(trans)), "m", "trajectory.stats"),
            "second_rpe_rot": (summary(np.array(rot)), "deg", "trajectory.stats")}


def write_trajectories(name, why, gt_t, gt, est_t, est, seed):
    outputs = evo_figures(as_evo(gt_t, gt), as_evo(est_t, est))
    outputs.update(drift_per_second(gt_t, gt, est_t, est))
    write_case("trajectory", name, basis="evo-1.38.1", why=why, script=SCRIPT, seed=seed,
               params={"kind": "errors", "max_dt_s": MAX_DT_S},
               inputs={"truth_t": (gt_t, "s"), "truth": (gt, "m, 1"),
                       "estimate_t": (est_t, "s"), "estimate": (est, "m, 1")}, outputs=outputs)


def loop(t):
    """A hand-held walk around a table: positions and quaternions (w, x, y, z) [N, 7]."""
    position = np.stack([np.cos(0.7 * t), 0.8 * np.sin(0.9 * t), 1.2 + 0.2 * np.sin(1.7 * t)], axis=1)
    rotation = Rotation.from_rotvec(np.stack([0.3 * np.sin(t), 0.4 * t, 0.2 * np.cos(1.3 * t)], axis=1))
    return np.hstack([position, rotation.as_quat()[:, [3, 0, 1, 2]]])


def estimated(rng, t, scale=1.0, noise_m=0.004, noise_rad=0.003):
    """The loop in another world, scaled and noisy."""
    poses = loop(t)
    world = Rotation.from_rotvec([0.4, -1.1, 2.0])
    position = scale * world.apply(poses[:, :3]) + [0.5, -2.0, 1.0] + noise_m * rng.normal(size=(len(t), 3))
    rotation = world * Rotation.from_quat(poses[:, [4, 5, 6, 3]]) * Rotation.from_rotvec(
        noise_rad * rng.normal(size=(len(t), 3)))
    return np.hstack([position, rotation.as_quat()[:, [3, 0, 1, 2]]])


def all_trajectories():
    rng = np.random.default_rng(72)
    start = 1548339819.0
    mocap = start + np.arange(450) / 100.0
    frames = start + 0.003 + np.arange(120) / 30.0
    stamps = lambda t: np.round(t, 6)
    write_trajectories("mocap_100hz", "30 Hz estimate against 100 Hz truth, scale off by 7 %", stamps(mocap),
                       loop(mocap - start), stamps(frames),
                       estimated(rng, frames - start, scale=1.07), 72)
    kept = np.ones(len(frames), bool)
    kept[40:52] = kept[70:72] = False
    held = (mocap < start + 2.6) | (mocap > start + 2.8)
    write_trajectories("holes", "tracking lost twice, motion capture lost once, estimate longer than the truth",
                       stamps(mocap[held][20:]), loop(mocap[held][20:] - start), stamps(frames[kept]),
                       estimated(rng, frames[kept] - start), 72)
    sparse = start + np.arange(60) / 15.0
    write_trajectories("sparse_truth", "fewer true poses than estimates: the truth leads the pairing",
                       stamps(sparse), loop(sparse - start), stamps(frames), estimated(rng, frames - start), 72)


if __name__ == "__main__":
    all_umeyama()
    all_trajectories()
