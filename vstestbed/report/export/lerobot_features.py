"""What a LeRobot dataset holds of each frame: the observations, actions and ends of the scenario's environment (`vstestbed.env`).

`observation.image` is what LeRobot makes of the environment's `pixels`, `observation.state` of its `agent_pos`; `markers`, `seen`,
`goal` and `action` are the environment's own. A policy that is trained on them drives in it. Without a detector there are no markers, and
their three features are left out: the format has none of no numbers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array
from vstestbed.laws.policy_io import MOST_PX, ActionScale
from vstestbed.loop.columns import TWIST
from vstestbed.loop.own_mount import mount_at
from vstestbed.report.export.columns import unit_of_joint
from vstestbed.report.export.source import RecordedRun
from vstestbed.robots import Mount
from vstestbed.scenario.scenario import Scenario

IMAGE = "observation.image"
Features = dict[str, dict[str, Any]]
Numbers = dict[str, NDArray[Any]]
"""Values of features by name, (frames, k) each."""
COUNTERS = ("frame_index", "episode_index", "index", "task_index")
SENSOR_UNITS = {
    "odo_x": "m",
    "odo_y": "m",
    "range": "m",
    "vx": "m/s",
    "vy": "m/s",
    "vz": "m/s",
    "wx": "rad/s",
    "wy": "rad/s",
    "wz": "rad/s",
}
"""Of sensors that are no joints; the others measure angles."""


def features_of(scenario: Scenario, state: tuple[str, ...]) -> Features:
    """The features of a scenario's dataset as `meta/info.json` has them; state: names of what is known of the robot's own sensors."""
    camera, n = scenario.camera, scenario.rows
    even = (camera.height + camera.height % 2, camera.width + camera.width % 2)  # as films are
    pixels = [f"{axis}_{i} [px]" for i in range(n) for axis in "uv"]
    found: Features = {IMAGE: {"dtype": "video", "shape": [*even, 3], "names": ["height", "width", "channels"], "info": _video(scenario)}}
    if state:
        found["observation.state"] = _vector([f"{name} [{_unit(name, scenario)}]" for name in state])
    found["action"] = _vector(_action_names(scenario))
    if n:
        found |= {"markers": _vector(pixels), "seen": _vector([f"marker_{i}" for i in range(n)]), "goal": _vector(pixels)}
    found["sim_time"] = {"dtype": "float64", "shape": [1], "names": None}
    found |= {f"next.{name}": {"dtype": "bool", "shape": [1], "names": None} for name in ("done", "success")}
    found["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
    return found | {name: {"dtype": "int64", "shape": [1], "names": None} for name in COUNTERS}


def numbers_of(run: RecordedRun) -> tuple[Numbers, tuple[str, ...]]:
    """The values of a run's frames, but for picture and counters; and the names of the entries of `observation.state`.

    A picture that never arrived has no frame, as the environment has no step of it: `timestamp` counts frames at the camera's rate, as
    LeRobot wants it, `sim_time` is when they were taken.
    """
    s = run.scenario
    blocks = list(run.log.blocks(_columns(run)))
    log = {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}
    n, frames = s.rows, len(log["t"])
    state = _state(s, log)
    last = np.arange(frames) == frames - 1
    found: Numbers = {"observation.state": np.stack(list(state.values()), axis=1)} if state else {}
    found["action"] = actions(s, log)
    if n:
        uv, goal = (np.stack([log[f"{axis}{at}_{i}"] for i in range(n) for axis in "uv"], axis=1) for at in ("", "_goal"))
        found |= {"markers": _pixels(uv), "seen": np.isfinite(uv[:, ::2]).astype(float), "goal": _pixels(goal)}
    found |= {"sim_time": log["t"], "next.done": last, "next.success": last & run.success}
    found["timestamp"] = np.arange(frames) / s.camera.rate_hz
    found["frame_index"] = np.arange(frames)
    return {name: values.reshape(frames, -1) for name, values in found.items()}, tuple(state)


def actions(scenario: Scenario, log: dict[str, Array]) -> Array:
    """The commanded velocities along the robot's motions as actions in [-1, 1], (frames, n): u = pinv(basis) twist.

    The motions of an arm of fewer than six joints depend on the joints, which are those of the exposure here.
    """
    robot, mount = scenario.robot, Mount.of(scenario.believed_camera.mount.T)
    scale = ActionScale.of(scenario.law.limits, robot.motion_basis(mount, robot.start_joints()))
    twists = np.stack([log[f"cmd_{name}"] for name in TWIST], axis=1)
    q = np.stack([log[f"q_{name}"] for name in robot.joints], axis=1) if robot.joints else np.zeros((len(twists), 0))
    bases = (robot.motion_basis(mount_at(scenario, mount, at), at) for at in q)
    return np.array([scale.action(np.linalg.pinv(basis) @ twist) for basis, twist in zip(bases, twists, strict=True)])


def _columns(run: RecordedRun) -> list[str]:
    """The columns of the log that are read."""
    s = run.scenario
    markers = [f"{axis}{at}_{i}" for i in range(s.rows) for axis in "uv" for at in ("", "_goal")]
    return ["t", *markers, *(f"cmd_{name}" for name in TWIST), *(f"q_{name}" for name in s.robot.joints), *s.own_columns]


def _state(scenario: Scenario, log: dict[str, Array]) -> dict[str, Array]:
    """What the log tells of the robot's own sensors, in the order of `agent_pos`: joints, and what the robot's columns have."""
    robot = scenario.robot
    own = robot.log(robot.supervisor(scenario.goal.lands, *scenario.stop.lost_after)).proprioception(log)
    known = {name: log[f"q_{name}"] for name in robot.joints} | own
    return {name: known[name] for name in robot.proprioception_names if name in known}


def _pixels(uv: Array) -> Array:
    """Pixels as a policy sees them (`policy_io.observed`): 0 for a marker that is not seen."""
    return np.clip(np.nan_to_num(uv, nan=0.0), -MOST_PX, MOST_PX)


def _action_names(scenario: Scenario) -> list[str]:
    """Names of the motions, each with the velocity of an action of 1."""
    robot = scenario.robot
    basis = robot.motion_basis(Mount.of(scenario.believed_camera.mount.T), robot.start_joints())
    scale, turns = ActionScale.of(scenario.law.limits, basis), np.abs(basis[3:]).max(axis=0) > 1e-9
    names = TWIST if basis.shape[1] == 6 else [f"motion_{i}" for i in range(basis.shape[1])]
    units = ["rad/s" if turn else "m/s" for turn in turns]
    return [f"{name} [{most:g} {unit}]" for name, most, unit in zip(names, scale.per_unit.tolist(), units, strict=True)]


def _unit(name: str, scenario: Scenario) -> str:
    return unit_of_joint(name, scenario) if name in scenario.robot.joints else SENSOR_UNITS.get(name, "rad")


def _vector(names: list[str]) -> dict[str, Any]:
    return {"dtype": "float32", "shape": [len(names)], "names": names}


def _video(scenario: Scenario) -> dict[str, Any]:
    """What LeRobot notes of a video."""
    size = {
        "video.height": scenario.camera.height + scenario.camera.height % 2,
        "video.width": scenario.camera.width + scenario.camera.width % 2,
    }
    kind = {"video.codec": "h264", "video.pix_fmt": "yuv420p", "video.is_depth_map": False, "video.channels": 3, "has_audio": False}
    return size | kind | {"video.fps": rate_of(scenario)}


def rate_of(scenario: Scenario) -> float:
    """The camera's rate [Hz], a whole number where it is one."""
    rate = scenario.camera.rate_hz
    return int(rate) if rate == int(rate) else rate
