"""The fence round the simulator's truth, by type and by what numbers derive from: no name of a
field matters.

Three checks, each with a planted leak that it finds: types in signatures and in their fields,
objects and tainted numbers in everything that a law, a detector, an observer, a task's reference, a
supervisor or an onboard controller is given while a run goes on, and commands under a corrupted
truth.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import pkgutil
import types
import typing
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

import vstestbed as vs
from vstestbed.camera import Picture
from vstestbed.core.geometry import Array
from vstestbed.core.named_files import model_path
from vstestbed.endings import Termination
from vstestbed.features.observation import Observation
from vstestbed.laws import Law
from vstestbed.loop.controller import Controller
from vstestbed.loop.ego_motion import Exposure
from vstestbed.loop.shutter import CameraClock, Exposed
from vstestbed.robots.base import RobotLog, RobotState
from vstestbed.sim.base import IdealPlant, Truth
from vstestbed.sim.plant import MujocoPlant
from vstestbed.sim.scene.scene import Scene
from vstestbed.tasks import Task
from vstestbed.tasks.frame import Frame
from vstestbed.vision.base import TruthView
from vstestbed.vision.observe import Observer

ROOMS = ("laws", "robots", "vision", "features", "camera", "targets")
TRUE = (
    Truth,
    TruthView,
    RobotState,
    Frame,
    MujocoPlant,
    IdealPlant,
    Scene,
    mujoco.MjData,
    mujoco.MjModel,
)
"""Types that hold the truth, or the simulator's state."""


class TestTypes:
    """What signatures and the fields of what they take can hold."""

    @staticmethod
    def within(hint: Any, seen: set[Any]) -> Iterator[type]:
        """The classes in an annotation, in those of its fields, and so on."""
        for part in (hint, *typing.get_args(hint)):
            if part is not hint:
                yield from TestTypes.within(part, seen)
            elif isinstance(part, type) and part not in seen:
                seen.add(part)
                yield part
                if dataclasses.is_dataclass(part) or getattr(part, "_fields", None):
                    for field in typing.get_type_hints(part).values():
                        yield from TestTypes.within(field, seen)

    @staticmethod
    def functions(room: str) -> Iterator[tuple[type | None, Callable[..., Any]]]:
        """All functions of a room, methods with their class."""
        package = importlib.import_module(f"vstestbed.{room}")
        for info in pkgutil.walk_packages(package.__path__, f"vstestbed.{room}."):
            module = importlib.import_module(info.name)
            for thing in vars(module).values():
                if inspect.isclass(thing) and thing.__module__ == module.__name__:
                    yield from ((thing, f) for f in vars(thing).values() if inspect.isfunction(f))
                elif inspect.isfunction(thing) and thing.__module__ == module.__name__:
                    yield None, thing

    @staticmethod
    def true_arguments(function: Callable[..., Any]) -> set[type]:
        """Which types of the truth a function's arguments and result reach."""
        try:
            hints = typing.get_type_hints(function)
        except NameError:  # a name that is imported for the type checker alone
            return set()
        return {
            found
            for hint in hints.values()
            for found in TestTypes.within(hint, set())
            if issubclass(found, TRUE)
        }

    def test_only_detectors_and_a_robots_log_take_the_truth(self):
        taken = [
            (cls, f, self.true_arguments(f)) for room in ROOMS for cls, f in self.functions(room)
        ]
        assert len(taken) > 600
        for cls, function, found in taken:
            if found == {TruthView} and cls is not None:
                # Every detector has the argument, by its interface; the loop fills it only for the
                # oracle.
                assert function.__name__ == "detect" or cls is TruthView, function.__qualname__
            elif found:
                logs = (
                    function.__qualname__ == "_slip"
                    if cls is None
                    else issubclass(cls, RobotLog | RobotState)
                )
                assert found == {RobotState} and logs, function.__qualname__

    def test_what_a_law_or_a_task_is_given_holds_none(self):
        given = [
            typing.get_type_hints(owner.step if owner is Law else owner.reference)
            for owner in (Law, Task)
        ]
        reached = {
            found
            for hints in given
            for hint in hints.values()
            for found in self.within(hint, set())
        }
        assert Observation in reached and not reached & set(TRUE)

    def test_a_planted_field_is_found_whatever_its_name(self):
        @dataclasses.dataclass
        class Weather:
            pressure: list[Truth | None]

        def forecast(weather: Weather) -> None: ...

        # `within` reads the fields' annotations in this function's names.
        Weather.__annotations__["pressure"] = list[Truth | None]
        forecast.__annotations__ = {"weather": Weather, "return": None}
        assert self.true_arguments(forecast) == {Truth}


class Tainted(np.ndarray):
    """An array of the truth. NumPy hands the class on to whatever is computed from it."""


def tainted(truth: Truth) -> Truth:
    fields = truth._asdict()
    return truth._replace(
        **{name: a.view(Tainted) for name, a in fields.items() if isinstance(a, np.ndarray)}
    )


def leaks(thing: Any, path: str, seen: set[int]) -> Iterator[str]:
    """Paths to objects of the truth, and to numbers that derive from it, in all that can be reached
    from a thing.
    """
    if (
        id(thing) in seen
        or isinstance(
            thing, str | bytes | int | float | type | types.ModuleType | np.random.Generator
        )
        or thing is None
    ):
        return
    seen.add(id(thing))
    if isinstance(thing, (*TRUE, Tainted)):
        yield f"{path}: {type(thing).__name__}"
    elif isinstance(thing, Picture):
        # Its `draw_whole` reaches the renderer, and is called by `Picture.completed` alone (tested
        # below): it gives a picture.
        yield from leaks(thing.images, f"{path}.images", seen)
    elif isinstance(thing, dict):
        for key, value in thing.items():
            yield from leaks(value, f"{path}[{key!r}]", seen)
    elif isinstance(thing, list | tuple | set | frozenset):
        for k, value in enumerate(thing):
            yield from leaks(value, f"{path}[{k}]", seen)
    elif isinstance(thing, np.ndarray):
        if isinstance(thing.base, Tainted):
            yield f"{path}: a view of a tainted array"
    else:
        for name, value in parts_of(thing):
            yield from leaks(value, f"{path}.{name}", seen)


def parts_of(thing: Any) -> Iterator[tuple[str, Any]]:
    """Attributes of an object; of a function its closure, defaults and bound object."""
    yield from getattr(thing, "__dict__", {}).items()
    for cls in type(thing).__mro__:
        slots = vars(cls).get("__slots__", ())
        yield from (
            (s, getattr(thing, s))
            for s in ((slots,) if isinstance(slots, str) else slots)
            if hasattr(thing, s) and s[:2] != "__"
        )
    for name in ("__self__", "__defaults__", "func", "args", "keywords"):
        if callable(thing) and (value := getattr(thing, name, None)) is not None:
            yield name, value
    for cell in getattr(thing, "__closure__", None) or ():
        yield "closure", cell.cell_contents


OF_ROBOTS = "motion_basis", "allocate", "measured_twist", "secondary_task", "actuate", "reported"
"""Methods of a robot that decide; some are of capabilities that not every robot has."""


def watched(monkeypatch: pytest.MonkeyPatch, scenario: vs.Scenario, every: int = 1) -> list[str]:
    """Leaks into what the deciding parts are given and keep, filled while the scenario runs."""
    found: list[str] = []
    supervisor = type(scenario.robot.supervisor(False, 1.0, 1.0))
    parts = (
        (type(scenario.law), ("init", "step")),
        (type(scenario.detector), ("begin", "regions_of_interest", "detect")),
        (Observer, ("observe",)),
        (type(scenario.goal), ("reference", "passed")),
        (supervisor, ("filter",)),
        (
            type(scenario.robot),
            tuple(name for name in OF_ROBOTS if hasattr(type(scenario.robot), name)),
        ),
    )

    def spy(cls: type, name: str) -> None:
        real, calls = getattr(cls, name), [0]

        def call(*given: Any, **named: Any) -> Any:
            result = real(*given, **named)
            calls[0] += 1
            if calls[0] % every == 1 or every == 1:
                found.extend(leaks((given, named, result), f"{cls.__name__}.{name}", set()))
            return result

        monkeypatch.setattr(cls, name, call)

    for cls, names in parts:
        for name in names:
            spy(cls, name)
    for plant in (MujocoPlant, IdealPlant):
        true = plant.truth
        monkeypatch.setattr(plant, "truth", lambda self, true=true: tainted(true(self)))
    return found


SMALL = {"camera.width": 320, "camera.height": 240}
QUARTER = {"camera.width": 160, "camera.height": 120, "law.levels": 3}
RUNS = {
    "arm_ibvs": {"law.gain": 2},
    "ibvs_book": {},
    "arm_track_circle": {},
    "arm_patch": {},
    "car_pbvs": {},
    "omni_ibvs": {},
    "car_line": {},
    "quadrotor_path": {},
    "quadrotor_land": {},
    "arm_keypoints": SMALL,
}
CORRUPTED = (
    "arm_ibvs",
    "arm_depth",
    "arm_patch",
    "arm_region",
    "car_pbvs",
    "quadrotor_path",
    "arm_keypoints",
    "arm_photometric",
)


@pytest.mark.parametrize("name", RUNS)
def test_nothing_that_decides_is_given_the_truth_or_what_derives_from_it(
    name: str, monkeypatch: pytest.MonkeyPatch
):
    scenario = vs.load(name, RUNS[name] | {"stop.duration_s": 0.12})
    found = watched(monkeypatch, scenario, every=7 if scenario.robot.onboard else 1)
    r = vs.run(scenario)
    assert len(r.table) >= 3 and not found


def planted(
    monkeypatch: pytest.MonkeyPatch, leak: Callable[[Truth, Observation], Observation]
) -> None:
    """A leak: the controller, which is given no truth,
    gets hold of that of its picture's exposure.
    """
    shot_of, observe, truths = CameraClock._shot, Controller._observe, {}

    def overheard(self: CameraClock, step: int, truth: Truth) -> Exposed:
        made = shot_of(self, step, truth)
        truths[made[0].number] = truth
        return made

    def leaky(self: Controller, shot: Exposure, *rest: Any) -> Observation:
        return leak(truths[shot.number], observe(self, shot, *rest))

    monkeypatch.setattr(CameraClock, "_shot", overheard)
    monkeypatch.setattr(Controller, "_observe", leaky)


def leak_into_observation(truth: Truth, seen: Observation) -> Observation:
    """Numbers computed from the truth, under the name of an honest field."""
    return dataclasses.replace(
        seen, place=np.array([2.0, 1.0, 0.5]) * truth.T_world_camera[:3, 3] + 1
    )


def leak_object(truth: Truth, seen: Observation) -> Observation:
    return dataclasses.replace(seen, motion=[{"pressure": truth}])  # type: ignore[arg-type] - a planted leak


def leak_closure(truth: Truth, seen: Observation) -> Observation:
    return dataclasses.replace(seen, motion=lambda: truth.twist)  # type: ignore[arg-type] - a planted leak


@pytest.mark.parametrize("leak", [leak_into_observation, leak_object, leak_closure])
@pytest.mark.parametrize("name", ["arm_ibvs", "ibvs_book"])
def test_a_planted_leak_is_found(
    name: str, leak: Callable[..., Observation], monkeypatch: pytest.MonkeyPatch
):
    planted(monkeypatch, leak)
    scenario = vs.load(name, {"stop.duration_s": 0.1})
    found = watched(monkeypatch, scenario)
    vs.run(scenario)
    law = type(scenario.law).__name__
    assert any(where.startswith(f"{law}.step") for where in found), found


class TestCorruptedTruth:
    """Numbers that lose their class on the way, as plain floats do: commands must not change with
    the truth.
    """

    @staticmethod
    def commands(scenario: vs.Scenario) -> Array:
        r = vs.run(scenario)
        names = [
            n
            for n in r.columns
            if n.startswith(("cmd_", "applied_", "depth_", "u_goal", "v_goal"))
            or n in ("scale", "error_px", "error_grey", "supervisor")
        ]
        return np.column_stack([r[n] for n in names])

    @staticmethod
    def corrupt(monkeypatch: pytest.MonkeyPatch) -> None:
        rng = np.random.default_rng(0)
        # Termination, which believes the lies, would end the run at once: here the clock does.
        monkeypatch.setattr(
            Termination,
            "verdict",
            lambda termination, frame: (
                (vs.Outcome.timed_out, "") if frame.t >= 0.2 - 1e-9 else None
            ),
        )
        for plant in (MujocoPlant, IdealPlant):
            true = plant.truth

            def lie(self: Any, true: Callable[[Any], Truth] = true) -> Truth:
                truth = true(self)
                T = truth.T_world_camera.copy()
                T[:3, 3] += rng.normal(size=3)
                garbage = {
                    n: rng.normal(size=np.shape(getattr(truth, n)))
                    for n in ("p_camera", "twist", "q", "qd", "ctrl", "act", "wind")
                }
                return truth._replace(T_world_camera=T, hidden=~truth.hidden, **garbage)

            monkeypatch.setattr(plant, "truth", lie)

    @pytest.mark.parametrize("name", CORRUPTED)
    def test_no_command_changes(self, name: str, monkeypatch: pytest.MonkeyPatch):
        small = {"arm_keypoints": SMALL, "arm_photometric": QUARTER}
        scenario = vs.load(name, {"stop.duration_s": 0.2} | small.get(name, {}))
        honest = self.commands(scenario)
        self.corrupt(monkeypatch)
        np.testing.assert_array_equal(self.commands(scenario), honest)

    def test_a_planted_number_is_found(self, monkeypatch: pytest.MonkeyPatch):
        planted(
            monkeypatch,
            lambda truth, seen: dataclasses.replace(
                seen, depth=seen.depth + 1e-3 * float(truth.twist[0])
            ),
        )
        scenario = vs.load("arm_ibvs", {"stop.duration_s": 0.2})
        honest = self.commands(scenario)
        self.corrupt(monkeypatch)
        assert not np.array_equal(self.commands(scenario), honest)


@pytest.mark.app()
def test_a_picture_alone_draws_itself_whole():
    package = Path(vs.__file__).parent
    read = {
        file.relative_to(package).as_posix()
        for file in package.rglob("*.py")
        if "draw_whole" in (text := file.read_text())
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Attribute) and node.attr == "draw_whole"
    }
    assert read == {"camera/base.py"}


def test_robots_sensors_are_such_as_robots_have():
    """MuJoCo also has sensors of places and velocities in the world."""
    real = {
        mujoco.mjtSensor.mjSENS_GYRO,
        mujoco.mjtSensor.mjSENS_ACCELEROMETER,
        mujoco.mjtSensor.mjSENS_VELOCIMETER,
    }
    # the last is the compass
    real |= {mujoco.mjtSensor.mjSENS_RANGEFINDER, mujoco.mjtSensor.mjSENS_FRAMEXAXIS}
    for name in ("arm_ibvs", "car_pbvs", "omni_ibvs", "quadrotor_path"):
        robot = vs.load(name).robot
        model = mujoco.MjModel.from_xml_path(str(model_path(robot.body.file)))
        assert {model.sensor(sensor).type[0] for sensor in robot.body.sensors} <= {
            int(s) for s in real
        }
        assert not any(joint.startswith("root") for joint in robot.joints)
