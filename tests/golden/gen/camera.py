"""Projection, Brown-Conrady distortion and its inverse.

The formulas are evaluated with 50 digits; the inverse is mpmath's root finder and derivatives are
mpmath's. cv2.projectPoints must agree with the distorted pixels to 1e-9 px.

    Needs: numpy 2.4.6, mpmath 1.3.0, opencv-python-headless 5.0.0.
"""

import cv2
import mpmath as mp
import numpy as np

from case import write_case

mp.mp.dps = 50
SIZE = (640, 480)
CAMERAS = {
    "freiburg1": ([517.306408, 516.469215, 318.643040, 255.313989], [0.262383, -0.953104, -0.005358, 0.002628, 1.163314]),
    "freiburg2": ([520.908620, 521.007327, 325.141442, 249.701764], [0.231222, -0.784899, -0.003257, -0.000105, 0.917205]),
    "bonn": ([542.822841, 542.576870, 315.593520, 237.756098], [0.039903, -0.099343, -0.000730, -0.000144, 0.0]),
    "pinhole": ([535.4, 539.2, 320.1, 247.6], [0.0] * 5),
}


def distort(x, y, d):
    k1, k2, p1, p2, k3 = (mp.mpf(v) for v in d)
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 ** 2 + k3 * r2 ** 3
    return (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y)


def distort_pixel(uv, k, d):
    fx, fy, cx, cy = (mp.mpf(v) for v in k)
    x, y = distort((mp.mpf(float(uv[0])) - cx) / fx, (mp.mpf(float(uv[1])) - cy) / fy, d)
    return x * fx + cx, y * fy + cy


def undistort_pixel(uv, k, d):
    fx, fy, cx, cy = (mp.mpf(v) for v in k)
    goal = ((mp.mpf(float(uv[0])) - cx) / fx, (mp.mpf(float(uv[1])) - cy) / fy)
    error = lambda x, y: [a - b for a, b in zip(distort(x, y, d), goal)]
    x, y = mp.findroot(error, goal, tol=mp.mpf(10) ** -80)
    return x * fx + cx, y * fy + cy


def project(p, k):
    fx, fy, cx, cy = (mp.mpf(v) for v in k)
    return [fx * p[0] / p[2] + cx, fy * p[1] / p[2] + cy]


def floats(rows):
    return np.array([[float(v) for v in row] for row in rows])


if __name__ == "__main__":
    for number, (name, (k, d)) in enumerate(CAMERAS.items()):
        rng = np.random.default_rng(number)
        corners = np.array([[-0.5, -0.5], [639.5, -0.5], [-0.5, 479.5], [639.5, 479.5], k[2:]])
        pixels = np.concatenate([corners, np.round(rng.uniform([0, 0], [639, 479], (40, 2)), 2)])
        points = np.concatenate([np.round(rng.uniform([-2, -2, 0.2], [2, 2, 6], (30, 3)), 4), [[1e-9, 0, 1e-3], [3e4, -2e4, 5e4]]])
        distorted = floats(distort_pixel(uv, k, d) for uv in pixels)
        normalised = np.concatenate([(pixels - k[2:]) / k[:2], np.ones((len(pixels), 1))], 1)
        matrix = np.array([[k[0], 0, k[2]], [0, k[1], k[3]], [0, 0, 1.0]])
        by_cv2 = cv2.projectPoints(normalised, np.zeros(3), np.zeros(3), matrix, np.array(d))[0][:, 0]
        assert abs(by_cv2 - distorted).max() < 1e-9
        mp_points = [[mp.mpf(float(v)) for v in p] for p in points]
        jacobian = [[[float(mp.diff(lambda *q: project(q, k)[row], tuple(p), tuple(int(i == c) for i in range(3))))
                      for c in range(3)] for row in range(2)] for p in mp_points]
        write_case(
            "camera", name, basis="mpmath-50 + opencv", why="every pixel of a real calibration has one ideal pixel and back",
            script="gen/camera.py", seed=number, equations=["E9"],
            params=dict(zip(["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"], k + d), width=SIZE[0], height=SIZE[1]),
            inputs={"pixels": (pixels, "px"), "points": (points, "m")},
            outputs={"distorted": (distorted, "px", "camera.pixel"),
                     "undistorted": (floats(undistort_pixel(uv, k, d) for uv in pixels), "px", "camera.undistorted"),
                     "projected": (floats(project(p, k) for p in mp_points), "px", "camera.pixel"),
                     "jacobian": (np.array(jacobian), "px/m", "camera.jacobian")},
        )
