"""One scene in another size takes the same time and has the same errors in the picture: cameras
from 0.1 mm to 100 m from their target.
"""

from __future__ import annotations

import copy
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.outcome import Outcome
from vstestbed.loop.recording import Recording

ROOM: dict[str, Any] = {
    "robot": {
        "kind": "free",
        "start": {"nominal": {"xyz": [0.12, -0.1, -1.3], "rpy_deg": [5, -4, 20]}},
    },
    "camera": {"kind": "perspective", "width": 320, "height": 240, "fovy_deg": 50, "rate_hz": 10},
    "target": {
        "kind": "square",
        "side": 0.4,
        "pose": {"xyz": [0, 0, 0]},
        "marker": {"kind": "disc", "radius": 0.03, "lit": False},
    },
    "detector": {"kind": "oracle"},
    "law": {"kind": "ibvs", "gain": 0.8},
    "world": {"floor_z": -200},
    "goal": {"T_camera_target": {"xyz": [0, 0, 1]}},
    "stop": {"duration_s": 20, "converged": {"error_px": 0.3, "hold_s": 0.5}},
}
"""A camera 1 m from the goal's view of a square of 0.4 m."""
SPACE = {
    "kind": "points",
    "at": [[0, 0, 0], [0.3, 0, 0], [0, 0.3, 0], [0.1, 0.1, 0.15]],
    "pose": {"xyz": [0, 0, 0]},
}
POSTER = {
    "kind": "picture",
    "file": "texture:poster",
    "width": 0.6,
    "pose": {"xyz": [0, 0, 0]},
    "draw_markers": False,
}
LENGTHS = "side", "radius", "size", "width", "gain_z", "depth_m", "initial_m", "margin_m"
"""Fields that are lengths, or speeds for a pure number, beside positions."""
# cameras from 0.16 mm to 83 m away at the start; powers of two, as rounding then is the same
SMALLEST, LARGEST = 2.0**-13, 64.0


def resized(given: Any, k: float) -> Any:
    """A scenario, or a part of it, with all its lengths times k."""
    if isinstance(given, dict):
        own = {
            name: value * k
            if name in LENGTHS and not isinstance(value, dict)
            else resized(value, k)
            for name, value in given.items()
        }
        return {
            name: np.multiply(value, k).tolist() if name in ("xyz", "at") else value
            for name, value in own.items()
        }
    return given


def flown(k: float, **parts: Any) -> Recording:
    """The run of the room with these parts, k times as large;
    the picture's own size is in pixels.
    """
    scenario = copy.deepcopy(ROOM) | parts
    camera, world = scenario.pop("camera"), scenario.pop("world")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.yaml"
        file.write_text(json.dumps(resized(scenario, k) | {"camera": camera, "world": world}))
        return vs.run(vs.load(file))


def apart_s(one: Recording, other: Recording) -> float:
    """How far apart in time two runs converge [s]."""
    times: list[Any] = [recording.summary()["time_to_converge_s"] for recording in (one, other)]
    return abs(times[0] - times[1])


def in_pixels(recording: Recording) -> np.ndarray:
    """Its error from frame to frame [px]."""
    return recording.frame()["error_px"].to_numpy()


LAWS: dict[str, dict[str, Any]] = {
    "ibvs": {"kind": "ibvs", "gain": 0.8},
    "polar": {"kind": "ibvs", "gain": 0.8, "feature": {"kind": "polar"}},
    "line": {"kind": "ibvs", "gain": 0.8, "feature": {"kind": "line"}},
    "visibility": {"kind": "ibvs", "visibility": {"margin_px": 20}},
    "adaptive": {"kind": "ibvs", "gain": {"kind": "adaptive"}},
    "damped": {"kind": "ibvs", "solve": {"damping": 0.05}},
    "feedforward": {"kind": "ibvs", "feedforward": {"kind": "kalman_cv"}},
    "pbvs": {"kind": "pbvs", "gain": 0.8},
    "hybrid": {"kind": "hybrid", "gain": 0.8},
    "partitioned": {"kind": "partitioned", "gain": 0.8, "gain_z": 1.0},
    "qp": {"kind": "qp"},
    "predictive": {"kind": "predictive"},
    "uncalibrated": {"kind": "uncalibrated"},
}
IN_METRES = {"adaptive", "damped", "uncalibrated"}
"""Laws with a parameter by the metre (a slope, damping, first speed), by the scene's unit under 3
cm and over 32 m: they are the same only where the scene is as many times as large as its unit.
"""


@pytest.mark.parametrize("law", LAWS)
def test_no_law_sees_the_scale(law: str):
    room, small, large = (flown(k, law=LAWS[law]) for k in (1.0, SMALLEST, LARGEST))
    assert room.outcome is Outcome.converged
    for other in (small, large):
        assert (
            other.outcome is Outcome.converged
            and other.summary()["time_to_converge_s"] == room.summary()["time_to_converge_s"]
        )
        # rounding, of which normal equations make more; pixels of the program of `predictive`
        # differ by its solver's own tolerance of 1e-6
        np.testing.assert_allclose(
            in_pixels(other), in_pixels(room), atol=1e-2 if law == "predictive" else 1e-4
        )


@pytest.mark.parametrize("k", [SMALLEST, 1e-3, 1e-2, LARGEST])
def test_points_in_space_have_a_pose_at_every_scale(k: float):
    target = SPACE | {"marker": {"kind": "sphere", "radius": 0.02, "lit": False}}
    room, other = (flown(size, target=target) for size in (1.0, k))
    assert other.outcome is Outcome.converged
    # 1e-3 px: away from powers of two the iterations of the pose end at another digit
    np.testing.assert_allclose(in_pixels(other), in_pixels(room), atol=1e-3)


@pytest.mark.parametrize("renderer", ["gl", "rays"])
def test_pictures_are_the_same_at_every_scale(renderer: str):
    camera = ROOM["camera"] | {"renderer": renderer}
    first = {}
    for k in (SMALLEST, 1.0, LARGEST):
        recording = flown(k, camera=camera, detector={"kind": "blobs"})
        assert recording.outcome is Outcome.converged
        first[k] = (recording.summary()["time_to_converge_s"], in_pixels(recording)[0])
    times, errors = zip(*first.values(), strict=True)
    assert max(times) - min(times) <= 0.1 + 1e-9  # a frame
    # the rims of thick discs, 1/300 of the radius in a room and 1/50 of it in a small scene, and
    # single precision of the geometry
    assert max(errors) - min(errors) < 0.05


MADE_OF: dict[str, dict[str, Any]] = {
    "blobs": {"detector": {"kind": "blobs"}},
    "tags": {
        "detector": {"kind": "tags"},
        "target": ROOM["target"] | {"marker": {"kind": "tag", "size": 0.12, "lit": False}},
    },
    "balls": {
        "detector": {"kind": "blobs"},
        "target": SPACE | {"marker": {"kind": "sphere", "radius": 0.02, "lit": False}},
    },
    "fisheye": {"detector": {"kind": "blobs"}, "camera": {"kind": "fisheye"}},
    "ball": {
        "detector": {"kind": "region"},
        "target": {"kind": "ball", "radius": 0.15, "pose": {"xyz": [0, 0, 0]}},
        "law": {
            "kind": "ibvs",
            "redundant": True,
            "depth": "size",
            "feature": {"kind": "ellipse", "rows": ["xn", "yn", "an"]},
        },
    },
    "patch": {
        "detector": {"kind": "patch"},
        "target": POSTER | {"marker": {"kind": "disc", "radius": 0.02}},
    },
    "keypoints": {
        "detector": {"kind": "keypoints"},
        "target": POSTER | {"marker": {"kind": "disc", "radius": 0.02}},
    },
    "photometric": {
        "robot": {
            "kind": "free",
            "start": {"nominal": {"xyz": [0.03, -0.02, -1.05], "rpy_deg": [1, -1, 5]}},
        },
        "detector": {"kind": "none"},
        "law": {"kind": "photometric"},
        "target": POSTER | {"marker": {"kind": "disc", "radius": 0.02}},
        "stop": {"duration_s": 20, "converged": {"error_grey": 4, "hold_s": 0.5}},
    },
}


@pytest.mark.study
@pytest.mark.parametrize("renderer", ["gl", "rays"])
@pytest.mark.parametrize("k", [1e-4, 1e-3, 1e-2, 1e-1, 10.0, LARGEST])
@pytest.mark.parametrize("of", MADE_OF)
def test_no_detector_sees_the_scale(of: str, k: float, renderer: str):
    if renderer == "rays" and of in ("patch", "keypoints", "photometric", "tags"):
        renderer = "gl"  # rays draw no textures
    parts = MADE_OF[of]
    parts = parts | {"camera": parts.get("camera", ROOM["camera"]) | {"renderer": renderer}}
    room, other = (flown(size, **parts) for size in (1.0, k))
    frame = 1 / room.scenario.camera.rate_hz
    assert room.outcome is other.outcome is Outcome.converged
    # two frames: where the last pixels come by noise of the detector, the threshold is crossed a
    # frame sooner or later
    assert apart_s(other, room) <= (30 if of == "photometric" else 2) * frame
    if of != "photometric":
        # noise of the detector
        assert abs(in_pixels(other)[0] - in_pixels(room)[0]) < (1.0 if of == "keypoints" else 0.3)


@pytest.mark.study
@pytest.mark.parametrize("k", [1e-4, 1e-3, 1e-2, 1e-1, 10.0, LARGEST])
@pytest.mark.parametrize("law", sorted(LAWS.keys() - IN_METRES))
def test_no_law_sees_any_decade(law: str, k: float):
    room, other = flown(1.0, law=LAWS[law]), flown(k, law=LAWS[law])
    assert other.outcome is Outcome.converged
    # the units of scenes that are no power of two differ by up to 2, by which the weights of a
    # program do
    slack = 0.2 if law == "predictive" else 1e-9
    assert apart_s(other, room) <= slack
