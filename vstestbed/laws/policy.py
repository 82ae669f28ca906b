"""A learned policy as a law: a function of a Python file, or a network in an ONNX file."""

from __future__ import annotations

import copy
import inspect
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from vstestbed.core.errors import EnvironmentLackError, ParameterError
from vstestbed.core.foreign import foreign, of_field
from vstestbed.core.geometry import Array
from vstestbed.core.named_files import absolute_file, is_there, line_of, load_file
from vstestbed.core.spec import spec
from vstestbed.features.depth import AtGoal, Depth
from vstestbed.features.observation import Goal, Observation
from vstestbed.imaging.chain import scaled
from vstestbed.laws.base import Command, Law, TwistLimits
from vstestbed.laws.photometric import NO_PICTURE, luminance

__all__ = ["MOST_PX", "Policy", "action_unit", "observed"]

# bound of the pixels that a policy sees [px]: an oracle's are anywhere when its field of view is
# unlimited
MOST_PX = 1e6


def observed(
    seen: Observation, goal: Goal, cameras: tuple[str, ...] = ()
) -> dict[str, NDArray[np.float32]]:
    """What a policy sees of one frame, in new arrays of float32, which learners work with.

    `markers` (N, 2) [px], 0 for a marker that is not seen; `seen` (N,), 1 or 0; `goal` (N, 2), the
    markers at the goal [px], 0 where none would be seen; and where the observation has it,
    `agent_pos` (k,), what the robot's own sensors tell (`Robot.proprioception`). Pixels are within
    +-MOST_PX. Of further `cameras`, `markers_NAME` and `seen_NAME` likewise, 0 for one whose last
    picture is missing or old.
    """
    found = {
        "markers": _pixels(seen.uv),
        "seen": seen.seen.astype(np.float32),
        "goal": _pixels(goal.uv),
    }
    views = seen.cameras or {}
    for name in cameras or views:
        uv = views[name].seen.uv if name in views else np.full_like(seen.uv, np.nan)
        found[f"markers_{name}"] = _pixels(uv)
        found[f"seen_{name}"] = np.isfinite(uv[:, 0]).astype(np.float32)
    if seen.proprioception is not None:
        found["agent_pos"] = np.array(seen.proprioception, dtype=np.float32)
    return found


def _pixels(uv: Array) -> NDArray[np.float32]:
    """Pixels (N, 2) as a new array of finite numbers, 0 for NaN."""
    return np.clip(np.nan_to_num(uv, nan=0.0), -MOST_PX, MOST_PX).astype(np.float32)


def action_unit(limits: TwistLimits, basis: Array) -> Array:
    """Velocities (n,) of an action of 1 along the robot's motions, basis (6, n) [m/s, rad/s], so
    that u = unit * action.

    They are a law's limits, 1 m/s and 1 rad/s where it has none: a motion that turns the camera has
    the limit of rate.
    """
    speed = limits.speed_mps or 1.0
    rate = limits.rate_radps or 1.0
    # a turn of the base also moves the camera; a translation never turns it
    turns = np.abs(basis[3:]).max(axis=0) > 1e-9
    return np.where(turns, rate, speed)


# from what a policy sees to an action (n,) in [-1, 1]; None where it has none
Act = Callable[[Mapping[str, NDArray[Any]]], Any]
Side = Annotated[int, Ge(1), Le(4096)]  # of a picture [px]
ONNX_KINDS: dict[str, Any] = {
    "tensor(float)": np.float32,
    "tensor(double)": np.float64,
    "tensor(uint8)": np.uint8,
}


@spec
class Policy(Law[Act]):
    """u = scale * action of a learned policy, action = act(observation) in [-1, 1]^n, beyond which
    it is clipped.

    `file` is `FILE.py:NAME` or `FILE.onnx`, absolute, or relative to the scenario's file. NAME is
    one of
    - a function `act(observation)` without a state;
    - a class, or an object: each run has an instance or a deep copy of its own, whose `reset()`,
      where it has one, is called first; its `act(observation)`, or the instance itself, is called
      for each frame.
    The observation is a dict of float32 arrays: `markers`, `seen`, `goal` and, where it is asked
    for, `agent_pos` (`observed`). An ONNX network has inputs of some of these names, with a batch
    dimension of 1 before them, and the action (1, n) as its first output; it runs in one thread. An
    action that is None or, while a marker is not seen, zero orders rest.

    With `picture_px` it sees `pixels` and `goal_pixels` (H, W, 3) in place of markers: the picture,
    and that of the goal, RGB in whole numbers of 8 bits, scaled as an environment with `picture_px`
    scales them. The run is then judged by grey levels, as of `photometric`.

    An action of 1 is the law's limit of speed or rate, without one 1 m/s or 1 rad/s
    (`action_unit`).

    Args:
        file: the policy. To load a scenario runs the code of it.
        picture_px: (width, height) of the pictures that it sees [px]; null: it sees markers; e.g.
            `[96, 72]`.
        agent_pos: show it what the robot's own sensors tell (`Robot.proprioception`): an arm's
            joints, a vehicle's odometry.
        depth: source of depth for tasks that need a pose; the policy does not see it.
        limits: largest speed and rate of the commanded twist.
    """

    kind: Literal["policy"] = "policy"
    file: str
    picture_px: tuple[Side, Side] | None = None
    agent_pos: bool = False
    depth: Depth = AtGoal()
    limits: TwistLimits = TwistLimits()
    tasks = ("view", "path", "landing", "pose", "gap", "line")
    needs_same_markers = True

    def __post_init__(self) -> None:
        """Load the policy, so that a mistake in `file` is told before anything runs."""
        if not re.search(r"\.onnx$|\.py:\w+$", self.file):
            raise ParameterError.form(
                "file", "FILE.py:NAME, such as my.py:act, or FILE.onnx", self.file
            )
        # frozen; a run remembers where its policy is
        object.__setattr__(self, "file", absolute_file(self.file, Path.cwd()))
        _loaded(self.file, self._sees)

    @property
    def _sees(self) -> tuple[str, ...]:
        """The names of what it sees."""
        views = ("markers", "seen", "goal")
        if self.picture_px is not None:
            views = ("pixels", "goal_pixels")
        return (*views, "agent_pos") if self.agent_pos else views

    @property
    def inputs(self) -> tuple[str, ...]:
        """The fields of an Observation that it looks at."""
        view = "uv" if self.picture_px is None else "image"
        return (view, "proprioception") if self.agent_pos else (view,)

    def markers_needed(self, basis: Array) -> int:
        """One, with pictures none: what a policy can do with fewer markers than the robot has
        motions is its own matter.
        """
        return 1 if self.picture_px is None else 0

    def init(self, goal: Goal) -> Act:
        """The policy itself: a copy of its own for each run, where it has a state.
        Raises ParameterError: its class or its `reset` raises, or it has no `act`.
        """
        made: Any = _loaded(self.file, self._sees)
        try:
            if inspect.isclass(made):
                made = made()
            elif not inspect.isroutine(made) and not self.file.endswith(".onnx"):
                # it may have a state, whether it tells or not
                made = copy.deepcopy(made)
            getattr(made, "reset", lambda: None)()
        except Exception as error:  # the code of others
            path = Path(self.file.rpartition(":")[0])
            words = (
                f"{line_of(error, str(path), path)}:"
                f" the policy cannot begin ({type(error).__name__}: {error})"
            )
            raise ParameterError("law.file", words) from error
        act = getattr(made, "act", made)
        if not callable(act):
            raise ParameterError(
                "law.file",
                f"{Path(self.file).name}: {type(made).__name__} has no method act(observation)",
            )
        return act

    def step(
        self, state: Act, observation: Observation, goal: Goal, basis: Array
    ) -> tuple[Act, Command]:
        """One frame: ask the policy. Raises ParameterError: the action is not n numbers."""
        seen, error_grey = self._seen(observation, goal)
        if seen is None:
            return state, Command.rest(basis, NO_PICTURE)
        given = state(seen)
        if given is None:
            return state, Command.rest(basis, "the policy gave no action")
        try:
            action = np.asarray(given, dtype=float)
        except (TypeError, ValueError):
            action = np.zeros(0)
        n = basis.shape[1]
        if action.shape != (n,):
            found = type(given).__name__
            if isinstance(given, np.ndarray | list | tuple):
                found = f"shape {np.shape(given)}"
            raise ParameterError.returned(
                "law.file",
                f"act of {Path(self.file).name}",
                f"{n} numbers for this robot's motions",
                found,
            )
        if not action.any() and not observation.seen.all():
            return state, Command.rest(basis, "the policy rests while a marker is out of sight")
        u = action_unit(self.limits, basis) * np.clip(action, -1.0, 1.0)
        command = self.limits.command(u, basis)
        return state, replace(command, error_grey=error_grey)

    def _seen(
        self, observation: Observation, goal: Goal
    ) -> tuple[dict[str, NDArray[Any]] | None, float]:
        """What it sees of a frame, None without a picture, and the RMS difference of the pictures'
        luminance [grey levels].
        Raises ParameterError: the goal has no picture.
        """
        own = observed(observation, goal)
        if self.picture_px is None:
            return own, math.nan
        if goal.image is None:
            raise ParameterError.missing(
                "goal.image", "this policy compares with it; give goal_images to the Controller"
            )
        if observation.image is None:
            return None, math.nan
        now = scaled(observation.image.image, self.picture_px)
        there = scaled(goal.image.image, self.picture_px)
        seen: dict[str, NDArray[Any]] = {"pixels": now, "goal_pixels": there}
        if "agent_pos" in own:
            seen["agent_pos"] = own["agent_pos"]
        return seen, float(np.sqrt(np.mean((luminance(now) - luminance(there)) ** 2)))


def _loaded(file: str, sees: tuple[str, ...]) -> Any:
    """The function, class or object that `Policy.file` names."""
    is_network = file.endswith(".onnx")
    source, _, name = file.rpartition(":")
    path = Path(file if is_network else source)
    if not is_there(path):
        raise ParameterError("file", f"{path} is not there; give the place of {path.name}")
    if is_network:
        return _network(path, path.stat().st_mtime_ns, sees)
    try:
        found = getattr(load_file(path), name, None)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever the code of others raises, also SystemExit
        words = f"cannot be imported ({type(error).__name__}: {error})"
        raise ParameterError("file", f"{line_of(error, str(path), path)} {words}") from error
    if not (callable(found) or callable(getattr(found, "act", None))):
        raise ParameterError("file", f"{path} has no function or class {name!r}")
    return found


@lru_cache(maxsize=16)
def _network(path: Path, written: int, known: tuple[str, ...]) -> Act:
    """The network of an ONNX file that was last written at a time [ns], as a function of what a
    policy sees.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise EnvironmentLackError(
            f"onnxruntime is not installed, which {path.name} needs",
            "pip install 'vstestbed[policy]'",
        ) from error
    options = onnxruntime.SessionOptions()
    # comparisons have a process for each core
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    with foreign(path, "an ONNX network", of_field("file")):
        network = onnxruntime.InferenceSession(
            str(path), options, providers=["CPUExecutionProvider"]
        )
    inputs = network.get_inputs()
    for wanted in inputs:
        if wanted.name not in known or wanted.type not in ONNX_KINDS:
            hint = "; agent_pos needs law.agent_pos: true" if wanted.name == "agent_pos" else ""
            words = (
                f"wants {wanted.name!r} as {wanted.type};"
                f" a policy sees {', '.join(known)} as float, double or uint8{hint}"
            )
            raise ParameterError("file", f"{path.name} {words}")

    def act(observation: Mapping[str, NDArray[np.float32]]) -> Array:
        given = {i.name: observation[i.name][None].astype(ONNX_KINDS[i.type]) for i in inputs}
        return np.asarray(network.run(None, given)[0], dtype=float)[0]

    return act
