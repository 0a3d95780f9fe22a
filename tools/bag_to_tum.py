#!/usr/bin/env python3
"""A ROS 1 bag, a ROS 2 bag (sqlite or MCAP storage) to a folder in TUM layout, which `garad run` reads.

    pip install rosbags numpy opencv-python-headless
    python3 tools/bag_to_tum.py BAG OUT --colour /camera/color/image_raw \
        --depth /camera/aligned_depth_to_color/image_raw --info /camera/color/camera_info

BAG is a .bag or .mcap file or the folder of a ROS 2 bag. Depth must be registered to colour (RealSense: align_depth). Images may be
sensor_msgs/Image or CompressedImage. Written are rgb/, depth/ (16-bit PNG, millimetres), rgb.txt, depth.txt and camera.txt;
times are those of the headers. Tried with rosbags 0.11 on bags of rgb8 with 16UC1 and 32FC1 in all three forms; compressed
images are not tried.
"""
import argparse
from pathlib import Path

import cv2
import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

COLOUR = {  # encoding: channels, conversion to BGR
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgr8": (3, None),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "mono8": (1, None),
}
DEPTH = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}


def rows(msg, dtype, channels):
    """The pixels of a sensor_msgs/Image without the padding of its rows."""
    order = ">" if msg.is_bigendian else "<"
    dtype = np.dtype(dtype).newbyteorder(order)
    data = np.frombuffer(msg.data, np.uint8).reshape(msg.height, msg.step)
    used = np.ascontiguousarray(data[:, : msg.width * channels * dtype.itemsize])
    return used.view(dtype).reshape(msg.height, msg.width, channels)


def colour(msg):
    if hasattr(msg, "format"):
        return cv2.imdecode(np.frombuffer(msg.data, np.uint8), cv2.IMREAD_COLOR)
    if msg.encoding not in COLOUR:
        raise SystemExit(f"colour is {msg.encoding}; expected one of {', '.join(COLOUR)}")
    channels, conversion = COLOUR[msg.encoding]
    image = rows(msg, "u1", channels)
    return image if conversion is None else cv2.cvtColor(image, conversion)


def depth_mm(msg):
    if hasattr(msg, "format"):
        data = bytes(msg.data)
        start = max(data.find(b"\x89PNG"), 0)  # compressedDepth has a header of its own
        image = cv2.imdecode(np.frombuffer(data[start:], np.uint8), cv2.IMREAD_UNCHANGED)
        if image is None or image.dtype != np.uint16:
            raise SystemExit("compressed depth is no 16-bit PNG; expected 16UC1")
        return image
    if msg.encoding not in DEPTH:
        raise SystemExit(f"depth is {msg.encoding}; expected one of {', '.join(DEPTH)}")
    image = rows(msg, DEPTH[msg.encoding], 1)[:, :, 0]
    if msg.encoding == "32FC1":  # metres, NaN where missing
        image = np.rint(np.nan_to_num(image, nan=0.0, posinf=0.0, neginf=0.0) * 1000.0)
        image = np.where((image > 0) & (image < 65535), image, 0)
    return image.astype(np.uint16)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bag", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--colour", default="/camera/color/image_raw")
    parser.add_argument("--depth", default="/camera/aligned_depth_to_color/image_raw")
    parser.add_argument("--info", default="/camera/color/camera_info")
    args = parser.parse_args()
    kinds = {args.colour: "rgb", args.depth: "depth", args.info: "info"}
    lists, info = {"rgb": [], "depth": []}, None
    with AnyReader([args.bag], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        missing = set(kinds) - set(reader.topics)
        if missing:
            raise SystemExit(f"no {', '.join(sorted(missing))}; the bag has {', '.join(sorted(reader.topics))}")
        for kind in lists:
            (args.out / kind).mkdir(parents=True, exist_ok=True)
        wanted = [c for c in reader.connections if c.topic in kinds]
        for connection, _, raw in reader.messages(connections=wanted):
            kind = kinds[connection.topic]
            msg = reader.deserialize(raw, connection.msgtype)
            if kind == "info":
                info = info or msg
                continue
            stamp = f"{msg.header.stamp.sec}.{msg.header.stamp.nanosec:09d}"
            name = f"{kind}/{stamp}.png"
            cv2.imwrite(str(args.out / name), colour(msg) if kind == "rgb" else depth_mm(msg))
            lists[kind].append((float(stamp), f"{stamp} {name}\n"))
    if info is None or not lists["rgb"]:
        raise SystemExit("no camera_info or no colour image")
    for kind, lines in lists.items():
        (args.out / f"{kind}.txt").write_text("# timestamp filename\n" + "".join(line for _, line in sorted(lines)))
    times = sorted(t for t, _ in lists["rgb"])
    fps = round(1.0 / float(np.median(np.diff(times))), 3) if len(times) > 1 else 30
    k = getattr(info, "K", None) if hasattr(info, "K") else info.k  # ROS 1 and ROS 2
    d = list(info.D if hasattr(info, "D") else info.d)
    d = (d + [0.0] * 5)[:5] if info.distortion_model in ("plumb_bob", "rational_polynomial", "") else [0.0] * 5
    numbers = [info.width, info.height, k[0], k[4], k[2], k[5], 1000, fps, *d]
    header = "# width height fx fy cx cy depth_factor fps k1 k2 p1 p2 k3\n"
    (args.out / "camera.txt").write_text(header + " ".join(f"{v:.10g}" for v in numbers) + "\n")
    print(f"{len(lists['rgb'])} colour and {len(lists['depth'])} depth images in {args.out}")


if __name__ == "__main__":
    main()
