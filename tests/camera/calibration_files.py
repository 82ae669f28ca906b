"""Valid calibrations of each format, mutations of them, and what plain readers find in them."""

import json
import random
from pathlib import Path

import cv2
import numpy as np
import yaml

CAMERA_INFO = {
    "image_width": 640,
    "image_height": 480,
    "camera_name": "c",
    "camera_matrix": {"rows": 3, "cols": 3, "data": [500, 0, 320, 0, 510, 240, 0, 0, 1]},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": [-0.1, 0.02, 0, 0, 0.01]},
}
POSE = {"x": 0.01, "y": -0.02, "z": 0.11, "qx": 0.0, "qy": 0.0, "qz": 0.6, "qw": 0.8}
EASY = {
    "parameters": {
        "eye_on_hand": True,
        "tracking_base_frame": "camera_optical_frame",
        "move_group": "arm",
    },
    "transformation": POSE,
}
MESSAGE = {
    "translation": {name: POSE[name] for name in "xyz"},
    "rotation": {name: POSE[f"q{name}"] for name in "xyzw"},
}
STAMPED = {
    "header": {"frame_id": "tool0", "stamp": 0},
    "child_frame_id": "camera_optical_frame",
    "transform": MESSAGE,
}
ECHO = {
    "header": {"stamp": {"sec": 1, "nanosec": 0}, "frame_id": "c"},
    "height": 480,
    "width": 640,
    "distortion_model": "plumb_bob",
    "d": [-0.1, 0.02, 0, 0, 0.01],
    "k": [500, 0, 320, 0, 510, 240, 0, 0, 1],
    "r": [1, 0, 0, 0, 1, 0, 0, 0, 1],
    "p": [450, 0, 330, 0, 0, 450, 238, 0, 0, 0, 1, 0],
    "binning_x": 0,
    "binning_y": 0,
    "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
}
OPENCV = """<?xml version="1.0"?>
<opencv_storage>
<calibration_time>"Mon Jan 14 01:23:21 2019"</calibration_time>
<nr_of_frames>15</nr_of_frames>
<image_width>640</image_width>
<image_height>480</image_height>
<fisheye_model>0</fisheye_model>
<camera_matrix type_id="opencv-matrix">
  <rows>3</rows>
  <cols>3</cols>
  <dt>d</dt>
  <data>
    500. 0. 320. 0. 510. 240. 0. 0. 1.</data></camera_matrix>
<distortion_coefficients type_id="opencv-matrix">
  <rows>5</rows>
  <cols>1</cols>
  <dt>d</dt>
  <data>
    -0.1 0.02 0. 0. 0.01</data></distortion_coefficients>
<avg_reprojection_error>2.6396006944129863e-01</avg_reprojection_error>
</opencv_storage>
"""


def opencv(ending: str) -> str:
    """The same in OpenCV's other formats."""
    storage = cv2.FileStorage(f".{ending}", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name in ("image_width", "image_height"):
        storage.write(name, CAMERA_INFO[name])
    storage.write(
        "camera_matrix", np.array(CAMERA_INFO["camera_matrix"]["data"], float).reshape(3, 3)
    )
    storage.write(
        "distortion_coefficients", np.array([CAMERA_INFO["distortion_coefficients"]["data"]])
    )
    return storage.releaseAndGetString()


ODD = [
    float("nan"),
    float("inf"),
    1e308,
    -1e308,
    10**400,
    0,
    -1,
    1e-320,
    True,
    None,
    "",
    "text",
    "1e3",
    [],
    {},
    [[]],
    [[[[1]]]],
    {"data": 1},
]
FIELDS = [
    "D",
    "K",
    "P",
    "R",
    "t",
    "T",
    "x",
    "camera_matrix",
    "distCoeffs",
    "roi",
    "binning_x",
    "fisheye_model",
    "mount",
    "skew",
    "cam0",
    "\u00e9",
]
# fmt: on
ENCODINGS = ["utf-16", "utf-32", "latin-1", "utf-8-sig", "cp037"]


def _places(plain: object, at: tuple = ()) -> list[tuple]:
    """The path of every value."""
    inner = (
        plain.items()
        if isinstance(plain, dict)
        else enumerate(plain)
        if isinstance(plain, list)
        else ()
    )
    return [path for key, value in inner for path in ((*at, key), *_places(value, (*at, key)))]


def _mutate(plain: dict, rng: random.Random) -> None:
    """Drop, double, rename or change one value."""
    *above, last = rng.choice(_places(plain) or [("K",)])
    block = plain
    for key in above:
        block = block[key]
    way = rng.choice(["drop", "odd", "odd", "more", "rename", "nest", "swap", "deep"])
    if way == "drop" and (isinstance(block, list) or last in block):
        del block[last]
    elif way == "more":
        block[rng.choice(FIELDS)] = rng.choice(ODD) if isinstance(block, dict) else None
    elif way == "rename" and isinstance(block, dict):
        block[
            rng.choice([str(last).upper(), str(last).title(), f"{last}_", rng.choice(FIELDS)])
        ] = block.pop(last)
    elif way == "nest":
        block[last] = rng.choice([[block[last]], {"data": block[last]}, str(block[last])])
    elif way == "swap":
        block[last] = plain[rng.choice(list(plain))]
    elif way == "deep":
        for _ in range(rng.choice([2, 20, 600])):
            block[last] = [block[last]]
    else:
        block[last] = rng.choice(ODD)


def mutated(number: int) -> tuple[str, bytes]:
    """Name and content of a calibration with some mutations, the same for a number."""
    rng = random.Random(number)
    kind = rng.choice(["yaml", "yaml", "json", "xml", "yml", "cv.json"])
    if kind in ("yaml", "json"):
        plain = json.loads(
            json.dumps(rng.choice([CAMERA_INFO, ECHO, EASY, STAMPED, {**CAMERA_INFO, **EASY}]))
        )
        for _ in range(rng.choice([0, 1, 1, 2, 3])):
            try:
                _mutate(plain, rng)
            except (KeyError, TypeError, IndexError, ValueError, RecursionError):
                continue
        try:
            text = (
                json.dumps(plain)
                if kind == "json" or rng.random() < 0.2
                else yaml.safe_dump(plain, sort_keys=False)
            )
        except (RecursionError, ValueError):
            text = "K: " + "[" * 3000
    else:
        text = OPENCV if kind == "xml" else opencv("yml" if kind == "yml" else "json")
        for _ in range(rng.choice([0, 1, 1, 2, 3])):
            was = rng.choice(
                [
                    "camera_matrix",
                    "image_width",
                    "rows",
                    "data",
                    "500",
                    "-0.1",
                    "0.02",
                    "opencv-matrix",
                    "d",
                    "640",
                    "<",
                    "[",
                    "0.",
                ]
            )
            text = text.replace(
                was,
                str(
                    rng.choice([*ODD[:12], *FIELDS, was.upper(), was * 3, "[" * 3000, "<a>" * 500])
                ),
                rng.choice([1, -1]),
            )
    content = text.encode(rng.choice(ENCODINGS), "replace") if rng.random() < 0.1 else text.encode()
    way = rng.random()
    if way < 0.15:
        content = content[: rng.randrange(len(content) + 1)]
    elif way < 0.25:
        spoilt = bytearray(content)
        for _ in range(rng.choice([1, 3, 30])):
            spoilt[rng.randrange(len(spoilt))] = rng.randrange(256)
        content = bytes(spoilt)
    return f"made.{kind}", content


def read_plainly(file: Path, found) -> bool:
    """Whether intrinsics are those that PyYAML, json or OpenCV read from a file."""
    text = file.read_text(encoding="utf-8-sig")
    if text.lstrip().startswith("<") or text.startswith("%YAML:1.0") or "opencv-matrix" in text:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        values = {name: _array(storage.getNode(name)) for name in storage.root().keys()}  # noqa: SIM118 - a FileNode is no mapping
    else:
        plain = (
            json.loads(text)
            if file.suffix == ".json"
            else next(one for one in yaml.safe_load_all(text) if one is not None)
        )
        values = {
            name: value.get("data") if isinstance(value, dict) else value
            for name, value in plain.items()
        }
    of = {str(name).replace("_", "").lower(): value for name, value in values.items()}
    K = next(
        np.array(of[name], float)
        for name in ("cameramatrix", "k", "m", "intrinsicmatrix")
        if name in of
    ).reshape(3, 3)
    given = [
        of[name]
        for name in ("distortioncoefficients", "d", "distcoeffs", "dist", "distortion", "distcoeff")
        if name in of
    ]
    k = np.array(given[0] if given else [], float).ravel()
    n = max(len(k), len(found.distortion))
    same_k = np.array_equal(
        np.pad(k, (0, n - len(k))),
        np.pad(np.array(found.distortion, float), (0, n - len(found.distortion))),
    )
    return same_k and np.array_equal(
        K[[0, 1, 0, 1], [0, 1, 2, 2]], [*found.focal_px, *found.principal_px]
    )


def _array(node):
    if node.isMap():
        return node.mat()
    if node.isSeq():
        return [_array(node.at(i)) for i in range(node.size())]
    return node.string() if node.isString() else node.real()
