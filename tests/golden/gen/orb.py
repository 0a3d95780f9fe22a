"""ORB keypoints and descriptors: ORB-SLAM3's scheme written a second time, on OpenCV's FAST,
resize, blur and fastAtan2.

    pip install numpy==2.4.6 opencv-python-headless==5.0.0.93
    python3 tests/golden/gen/orb.py
"""

import math
import pathlib
import re

import cv2
import numpy as np

import pictures
from case import write_case
from pyramid import orb_levels

SOURCE = pathlib.Path(__file__).resolve().parents[3] / "crates/features/src/orb/pattern.rs"
PATTERN = np.array(re.findall(r"\[(-?\d+), (-?\d+), (-?\d+), (-?\d+)\]", SOURCE.read_text()), np.float32)
MARGIN, CELL, RADIUS = 16, 35, 15


def fast(image, threshold):
    detector = cv2.FastFeatureDetector_create(threshold, True, cv2.FAST_FEATURE_DETECTOR_TYPE_9_16)
    return [(int(k.pt[0]), int(k.pt[1]), int(k.response)) for k in detector.detect(image)]


def candidates(level):
    """(x, y, score) relative to the margin, cell by cell; a cell's window is 6 pixels larger."""
    width, height = level.shape[1] - 2 * MARGIN, level.shape[0] - 2 * MARGIN
    if width < 7 or height < 7:
        return []
    columns, rows = max(width // CELL, 1), max(height // CELL, 1)
    cell_w, cell_h = math.ceil(width / columns), math.ceil(height / rows)
    found = []
    for i in range(rows):
        for j in range(columns):
            x0, y0 = j * cell_w, i * cell_h
            window = level[MARGIN + y0:MARGIN + min(y0 + cell_h + 6, height),
                           MARGIN + x0:MARGIN + min(x0 + cell_w + 6, width)]
            if min(window.shape) < 7:
                continue
            corners = fast(window, 20) or fast(window, 7)
            found += [(x + x0, y + y0, score) for x, y, score in corners]
    return found


class Node:
    def __init__(self, x0, y0, x1, y1, keys):
        self.box, self.keys = (x0, y0, x1, y1), keys

    def children(self):
        x0, y0, x1, y1 = self.box
        xm, ym = x0 + math.ceil((x1 - x0) / 2), y0 + math.ceil((y1 - y0) / 2)
        pick = lambda right, below: [k for k in self.keys if (k[0] >= xm) == right and (k[1] >= ym) == below]
        nodes = [Node(x0, y0, xm, ym, pick(False, False)), Node(xm, y0, x1, ym, pick(True, False)),
                 Node(x0, ym, xm, y1, pick(False, True)), Node(xm, ym, x1, y1, pick(True, True))]
        return [n for n in nodes if n.keys]


def distribute(keys, width, height, wanted):
    """A list with its front at index 0, as ORB-SLAM keeps it; Python's sort is stable."""
    count = max(int(math.floor(np.float32(width) / np.float32(height) + np.float32(0.5))), 1)
    cell = np.float32(width) / np.float32(count)
    nodes = [Node(int(cell * i), 0, int(cell * (i + 1)), height,
                  [k for k in keys if int(np.float32(k[0]) / cell) == i]) for i in range(count)]
    nodes = [n for n in nodes if n.keys]
    while True:
        before, created = len(nodes), []
        for node in list(nodes):
            if len(node.keys) == 1:
                continue
            for child in node.children():
                nodes.insert(0, child)
                if len(child.keys) > 1:
                    created.append(child)
            nodes.remove(node)
        if len(nodes) >= wanted or len(nodes) == before:
            break
        if len(nodes) + 3 * len(created) > wanted:
            while len(nodes) < wanted:
                before, queue, created = len(nodes), created, []
                queue.sort(key=lambda n: (len(n.keys), n.box[0]))
                for node in reversed(queue):
                    for child in node.children():
                        nodes.insert(0, child)
                        if len(child.keys) > 1:
                            created.append(child)
                    nodes.remove(node)
                    if len(nodes) >= wanted:
                        break
                if len(nodes) == before:
                    break
            break
    return [max(n.keys, key=lambda k: k[2]) for n in nodes]  # max keeps the first of equals


def half_widths():
    """Rounded circle up to the diagonal, mirrored beyond it."""
    widths = [int(np.rint(math.sqrt(RADIUS ** 2 - v * v))) for v in range(12)] + [0] * 4
    v0 = 0
    for v in range(RADIUS, math.ceil(RADIUS * math.sqrt(2) / 2) - 1, -1):
        while widths[v0] == widths[v0 + 1]:
            v0 += 1
        widths[v] = v0
        v0 += 1
    return widths


def angle(image, x, y):
    m10 = m01 = 0
    for v in range(-RADIUS, RADIUS + 1):
        half = half_widths()[abs(v)]
        row = image[y + v, x - half:x + half + 1].astype(int)
        m10 += int((np.arange(-half, half + 1) * row).sum())
        m01 += v * int(row.sum())
    return np.float32(cv2.fastAtan2(float(m01), float(m10)))


def describe(blurred, x, y, angle_deg):
    radians = np.float64(angle_deg * np.float32(math.pi / 180))
    c, s = np.float32(np.cos(radians)), np.float32(np.sin(radians))
    value = lambda px, py: blurred[y + np.rint(px * s + py * c).astype(int), x + np.rint(px * c - py * s).astype(int)]
    bits = value(PATTERN[:, 0], PATTERN[:, 1]) < value(PATTERN[:, 2], PATTERN[:, 3])
    return np.packbits(bits, bitorder="little")


def features_per_level(total, count=8, factor=1.2):
    ratio = np.float32(1 / np.float64(np.float32(factor)))
    share = np.float32(total) * (np.float32(1) - ratio) / (np.float32(1) - np.float32(np.float64(ratio) ** count))
    wanted = []
    for _ in range(count - 1):
        wanted.append(int(np.rint(share)))
        share = share * ratio
    return wanted + [max(total - sum(wanted), 0)]


def extract(image, total):
    scales, levels = orb_levels(image)
    rows = []
    for level, (scale, picture, wanted) in enumerate(zip(scales, levels, features_per_level(total))):
        found = candidates(picture)
        if not found or wanted == 0:
            continue
        blurred = cv2.GaussianBlur(picture, (7, 7), 2, borderType=cv2.BORDER_REFLECT_101)
        area = (picture.shape[1] - 2 * MARGIN, picture.shape[0] - 2 * MARGIN)
        kept = sorted(distribute(found, *area, wanted), key=lambda k: (k[1], k[0]))
        for x, y, score in kept:
            x, y = x + MARGIN, y + MARGIN
            turn = angle(picture, x, y)
            rows.append((level, (np.float32(x) * scale, np.float32(y) * scale), turn, score, describe(blurred, x, y, turn)))
    level, pt, turn, response, descriptor = zip(*rows)
    return {
        "level": (np.array(level, np.int32), "1", "exact"),
        "pt": (np.array(pt, np.float32), "px", "exact"),
        "angle": (np.array(turn, np.float32), "deg", "exact"),
        "response": (np.array(response, np.float32), "1", "exact"),
        "descriptor": (np.array(descriptor, np.uint8), "bits", "exact"),
    }


def main():
    assert len(PATTERN) == 256 and half_widths() == [15, 15, 15, 15, 14, 14, 14, 13, 13, 12, 11, 10, 9, 8, 6, 3]
    cases = {
        "boxes_300": (pictures.boxes(320, 240, 11), 11, 300, "many more corners than wanted: the quad-tree decides"),
        "texture_1000": (pictures.texture(240, 200, 12), 12, 1000, "fewer corners than wanted, second threshold in most cells"),
        "wide_100": (pictures.boxes(300, 100, 13), 13, 100, "three roots of the quad-tree, levels too small to search"),
    }
    for name, (image, seed, total, why) in cases.items():
        write_case("orb", name, basis="opencv", why=why, script="gen/orb.py", seed=seed,
                   params={"features": total}, inputs={"image": (image, "1")}, outputs=extract(image, total))
    rng = np.random.default_rng(14)
    m10, m01 = rng.integers(-400_000, 400_000, (2, 1000)).astype(np.float32)
    m10[:9], m01[:9] = np.array([(x, y) for x in (-1, 0, 1) for y in (-1, 0, 1)]).T
    degrees = np.array([cv2.fastAtan2(float(y), float(x)) for y, x in zip(m01, m10)], np.float32)
    write_case("orb", "atan2", basis="opencv", why="the polynomial, octants and axes included",
               script="gen/orb.py", seed=14, inputs={"y": (m01, "1"), "x": (m10, "1")},
               outputs={"atan2": (degrees, "deg", "exact")})


if __name__ == "__main__":
    main()
