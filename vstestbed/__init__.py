"""vstestbed: visual servoing meets real dynamics.

    import vstestbed as vs
    recording = vs.run(vs.load("arm_ibvs", {"law.gain": 1.0}))
    recording.outcome, recording.summary(), recording.frame()

`vs.Session` is the same run, stepped by hand; `vs.Controller` is its controller alone, for a real
camera and robot.

A scenario in Python, of parts from the rooms `robots`, `camera`, `targets`, `vision`, `laws`,
`tasks`; poses are also spatialmath's SE3:

    scenario = vs.Scenario(
        robot=vs.robots.Free(start={"nominal": SE3(1, 1, -3) * SE3.Rz(0.6)}),
        target=vs.targets.Square(side=0.5, pose=SE3(0, 0, 3)),
        law=vs.laws.IBVS(gain=0.8),
        goal=vs.tasks.GoalView(T_camera_target=SE3(0, 0, 1)),
    )
    vs.dump(scenario, "mine.yaml")  # the file from which `load` makes it

To extend it, a kind is one class and one registration:

    @vs.LAWS.add
    @vs.spec
    class Mine(vs.LawBase):
        kind: Literal["mine"] = "mine"
        gain: float = 0.5

        def step(self, state, observation, goal, basis): ...

Public names are imported when first used, so that `import vstestbed` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from vstestbed.core.former_modules import imported, know_former_modules

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from vstestbed import camera, effects, features, laws, robots, targets, tasks, testing, vision
    from vstestbed.apps.tune.tuning import tune
    from vstestbed.camera import CAMERAS, Calibration, Camera
    from vstestbed.core import errors
    from vstestbed.core.geometry import Array, Pose
    from vstestbed.core.outcome import Outcome
    from vstestbed.core.planar import GroundPose
    from vstestbed.core.spec import spec
    from vstestbed.effects import EFFECTS, EffectBase
    from vstestbed.endings.monitors import MONITORS
    from vstestbed.features import FEATURES, Feature
    from vstestbed.features.observation import Goal, Observation, Sight
    from vstestbed.laws import LAWS, Command, ErrorLaw, Law, LawBase
    from vstestbed.loop.controller import Controller
    from vstestbed.loop.recording import Recording
    from vstestbed.loop.session import Session, run
    from vstestbed.report.comparison.planning import starts_needed
    from vstestbed.robots import ROBOTS, Allocation, Mount, Order, Reading, Robot, RobotBase
    from vstestbed.scenario.dump import dump
    from vstestbed.scenario.load import load
    from vstestbed.scenario.noise import Noise
    from vstestbed.scenario.scenario import Scenario
    from vstestbed.sim.scene.world import World
    from vstestbed.studies.comparison import compare
    from vstestbed.studies.run_folder import run_into
    from vstestbed.targets import TARGETS, Target
    from vstestbed.targets.motion import MOTIONS, MotionBase
    from vstestbed.tasks import GOALS, Task, TaskBase
    from vstestbed.tasks.frame import Cycle, Frame
    from vstestbed.tasks.metrics import METRICS
    from vstestbed.tasks.stop import Stop
    from vstestbed.timing.clock import Clock
    from vstestbed.timing.plan import Timing
    from vstestbed.vision import DETECTORS, KEYPOINTS, Detection, Detector, DetectorBase
    from vstestbed.vision.perturb import PERTURBATIONS, PerturbationBase

_HOMES = {
    "vstestbed.camera": ("CAMERAS", "Calibration", "Camera"),
    "vstestbed.core.geometry": ("Array", "Pose"),
    "vstestbed.core.outcome": ("Outcome",),
    "vstestbed.core.planar": ("GroundPose",),
    "vstestbed.core.spec": ("spec",),
    "vstestbed.report.comparison.planning": ("starts_needed",),
    "vstestbed.studies.comparison": ("compare",),
    "vstestbed.studies.run_folder": ("run_into",),
    "vstestbed.apps.tune.tuning": ("tune",),
    "vstestbed.effects": ("EFFECTS", "EffectBase"),
    "vstestbed.features": ("FEATURES", "Feature"),
    "vstestbed.features.observation": ("Goal", "Observation", "Sight"),
    "vstestbed.laws": ("LAWS", "Command", "ErrorLaw", "Law", "LawBase"),
    "vstestbed.loop.controller": ("Controller",),
    "vstestbed.loop.recording": ("Recording",),
    "vstestbed.loop.session": ("Session", "run"),
    "vstestbed.robots": ("ROBOTS", "Allocation", "Mount", "Order", "Reading", "Robot", "RobotBase"),
    "vstestbed.scenario.dump": ("dump",),
    "vstestbed.scenario.load": ("load",),
    "vstestbed.scenario.noise": ("Noise",),
    "vstestbed.scenario.scenario": ("Scenario",),
    "vstestbed.timing.clock": ("Clock",),
    "vstestbed.sim.scene.world": ("World",),
    "vstestbed.timing.plan": ("Timing",),
    "vstestbed.targets": ("TARGETS", "Target"),
    "vstestbed.targets.motion": ("MOTIONS", "MotionBase"),
    "vstestbed.tasks": ("GOALS", "Task", "TaskBase"),
    "vstestbed.tasks.frame": ("Cycle", "Frame"),
    "vstestbed.tasks.stop": ("Stop",),
    "vstestbed.tasks.metrics": ("METRICS",),
    "vstestbed.endings.monitors": ("MONITORS",),
    "vstestbed.vision": ("DETECTORS", "KEYPOINTS", "Detection", "Detector", "DetectorBase"),
    "vstestbed.vision.perturb": ("PERTURBATIONS", "PerturbationBase"),
}
_ROOMS = (
    "camera",
    "effects",
    "features",
    "laws",
    "robots",
    "targets",
    "tasks",
    "testing",
    "vision",
)
_MODULES = {"errors": "vstestbed.core.errors"} | {room: f"vstestbed.{room}" for room in _ROOMS}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "CAMERAS",
    "DETECTORS",
    "EFFECTS",
    "FEATURES",
    "GOALS",
    "KEYPOINTS",
    "LAWS",
    "METRICS",
    "MONITORS",
    "MOTIONS",
    "PERTURBATIONS",
    "ROBOTS",
    "TARGETS",
    "Allocation",
    "Array",
    "Calibration",
    "Camera",
    "Clock",
    "Command",
    "Controller",
    "Cycle",
    "Detection",
    "Detector",
    "DetectorBase",
    "EffectBase",
    "ErrorLaw",
    "Feature",
    "Frame",
    "Goal",
    "GroundPose",
    "Law",
    "LawBase",
    "MotionBase",
    "Mount",
    "Noise",
    "Observation",
    "Order",
    "Outcome",
    "PerturbationBase",
    "Pose",
    "Reading",
    "Recording",
    "Robot",
    "RobotBase",
    "Scenario",
    "Session",
    "Sight",
    "Stop",
    "Target",
    "Task",
    "TaskBase",
    "Timing",
    "World",
    "camera",
    "compare",
    "dump",
    "effects",
    "errors",
    "features",
    "laws",
    "load",
    "robots",
    "run",
    "run_into",
    "spec",
    "starts_needed",
    "targets",
    "tasks",
    "testing",
    "tune",
    "vision",
]


know_former_modules()


def __getattr__(name: str) -> object:
    if name in _MODULES:
        return import_module(_MODULES[name])
    if name in _HOME_OF:
        try:
            home = imported(_HOME_OF[name], f"vstestbed.{name}")
        except ModuleNotFoundError as error:
            if error.name != _HOME_OF[name]:
                raise
            # of an app that is not there, which its sentence names
            raise AttributeError(str(error)) from None
        if _HOME_OF[name].startswith("vstestbed.loop"):
            _show_in_notebooks()
        return getattr(home, name)
    raise AttributeError(
        f"module 'vstestbed' has no attribute {name!r}; public names: {', '.join(__all__)}"
    )


def _show_in_notebooks() -> None:
    """Let a recording show its report and figures: the room of recordings is below that of reports,
    and imports nothing of it.
    """
    from vstestbed.loop.recording import Recording

    Recording.shown_by, Recording.drawn_by = staticmethod(_cell_of), staticmethod(_figure_of)


def _cell_of(recording: Recording) -> str:
    from vstestbed.report.run.page import recording_cell

    return recording_cell(recording)


def _figure_of(recording: Recording, name: str) -> Figure:
    from vstestbed.report.run.page import figure_of

    return figure_of(recording, name)


def __dir__() -> list[str]:
    return __all__
