"""The catalogue: every registered kind passes the suites that a plugin is tested with
(`vstestbed.testing`).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import vstestbed as vs
import vstestbed.testing as suites
from tests.examples import wrong
from tests.examples.wrong import (
    Bare,
    Crooked,
    Displaced,
    Ghost,
    Numb,
    Remembering,
    Rolling,
    Shifted,
    Silent,
    Stateful,
    Wild,
)
from tests.examples.wrong_rooms import (
    Backwards,
    Forgetful,
    Idle,
    Impatient,
    Jumping,
    Mirrored,
    Untold,
)
from tests.robots.arms import block
from vstestbed.camera import CAMERAS
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose
from vstestbed.core.named_files import folder
from vstestbed.endings.monitors import MONITORS, AfterPictures, KeepOut, Settles
from vstestbed.features import FEATURES
from vstestbed.laws import IBVS, LAWS, PBVS
from vstestbed.laws.switched import Stage, SwitchCondition
from vstestbed.robots import ROBOTS, Free
from vstestbed.robots.free import FreeStart
from vstestbed.targets import (
    TARGETS,
    Ball,
    GroundLines,
    MeshTarget,
    PictureTarget,
    Points,
    Shape,
    Square,
)
from vstestbed.targets.motion import MOTIONS
from vstestbed.targets.regions import Whale
from vstestbed.targets.route import Straight
from vstestbed.tasks import GOALS
from vstestbed.tasks.metrics import METRICS
from vstestbed.tasks.stop import Converged
from vstestbed.testing.laws import quick
from vstestbed.vision import DETECTORS, Tags
from vstestbed.vision.perturb import PERTURBATIONS

POLICY = {"file": str(Path(wrong.__file__).with_name("policy.py")) + ":Smooth"}
TURNS = (
    Stage(law=IBVS(gain=1.0), until=SwitchCondition(error_under_px=20.0)),
    Stage(law=PBVS(gain=1.0)),
)
LAW_PARAMETERS = {word: {"gain": 1.0} for word in ("partitioned", "pbvs", "hybrid", "ibvs")} | {
    "policy": POLICY,
    "switched": {"laws": TURNS},
}
LEG = [
    {"T_camera_target": {"xyz": [1.5, -1.5, 2.37]}},
    {"T_camera_target": {"xyz": [-1.5, -1.5, 3.37]}},
]
TASKS = {
    "view": lambda: quick("view"),
    "view_from": lambda: scenario("omni_ibvs", {"robot.wheels": "planar"}),
    "views": lambda: scenario("omni_via_points", {"robot.wheels": "planar"}),
    "pose": lambda: quick("pose"),
    "gap": lambda: quick("gap"),
    "line": lambda: quick("line"),
    "track": lambda: scenario("arm_track_circle", {"stop.duration_s": 8.0}),
    # the whole path is flown in tests/loop
    "path": lambda: scenario("quadrotor_path", {"goal.way": LEG, "stop.duration_s": 25.0}),
    "landing": lambda: quick("landing"),
    "insertion": lambda: scenario(
        "arm_insert", {"robot.controller": "velocity", "robot.start.nominal.q_deg": BEFORE_MOUTH}
    ),
}
BEFORE_MOUTH = [13.0, 34.0, -168.0, 18.4, 46.0, -13.0]  # of a plug 2 cm before the approach
TARGET_EXAMPLES = {
    "square": lambda: Square(side=0.4, pose=Pose(xyz=(0, 0, 1))),
    "points": lambda: Points(at=((0, 0, 0), (0.2, 0, 0.1), (0, 0.3, 0)), pose=Pose(xyz=(0, 0, 1))),
    "picture": lambda: PictureTarget(
        file=str(folder("scenarios") / "targets" / "page.png"), width=0.6, pose=Pose(xyz=(0, 0, 1))
    ),
    "mesh": lambda: MeshTarget(
        file=str(folder("scenarios") / "targets" / "flange.stl"),
        scale=0.001,
        at=((85, 85, 18), (-110, 0, 18), (0, 100, 0)),
        pose=Pose(xyz=(0, 0, 1)),
    ),
    "lines": lambda: GroundLines(route=Straight(length_m=5.0)),
    "shape": lambda: Shape(figure=Whale(length=0.4), pose=Pose(xyz=(0, 0, 1))),
    "ball": lambda: Ball(radius=0.1, pose=Pose(xyz=(0, 0, 1))),
}


SMALL_PICTURES = {
    "camera.width": 160,
    "camera.height": 120,
    "camera.focal_length_m": 0.00435,
    "robot.start.nominal": {"xyz": [0.02, 0, -1.05], "rpy_deg": [0, 0, 4]},
}


def scenario(name, changes):
    return vs.load(name, {"detector": {"kind": "oracle"}, **changes})


def robot(kind):
    if kind == "mjcf":
        return ROBOTS.members[kind](
            **{name: value for name, value in block("scara").items() if name != "kind"}
        )
    if kind == "compound":
        return vs.load("mobile_ibvs").robot
    return (
        Free(start=FreeStart(nominal=Pose(xyz=(0, 0, -1))))
        if kind == "free"
        else ROBOTS.members[kind]()
    )


def test_the_catalogue_is_whole():
    assert set(TASKS) == set(GOALS.members)
    assert set(TARGET_EXAMPLES) == set(TARGETS.members)


@pytest.mark.parametrize(
    "kind",
    [pytest.param(k, marks=[pytest.mark.study] if k == "pursuit" else []) for k in LAWS.members],
)
def test_every_law(kind):
    # the photometric law needs a picture with structure
    loop = vs.load("camera_photometric", SMALL_PICTURES) if kind == "photometric" else None
    suites.check_law(loop.law if loop else LAWS.members[kind](**LAW_PARAMETERS.get(kind, {})), loop)


@pytest.mark.parametrize("kind", ROBOTS.members)
def test_every_robot(kind):
    suites.check_robot(robot(kind))


@pytest.mark.parametrize("kind", TARGETS.members)
def test_every_target(kind):
    suites.check_target(TARGET_EXAMPLES[kind]())


# `none` detects nothing
@pytest.mark.parametrize("kind", [kind for kind in DETECTORS.members if kind != "none"])
def test_every_detector(kind):
    suites.check_detector(DETECTORS.members[kind]())


LONG = ("views", "gap", "path", "landing")
"""Tasks whose closed loop takes seconds; tests/loop has quick ones of them."""


@pytest.mark.parametrize(
    "kind", [pytest.param(k, marks=[pytest.mark.study] if k in LONG else []) for k in GOALS.members]
)
def test_every_task(kind):
    suites.check_task(TASKS[kind]())


MOTION_EXAMPLES = {
    "still": {},
    "line": {"velocity_mps": (0.1, 0, 0.2), "from_s": 1.0, "until_s": 3.0},
    "circle": {"radius_m": 0.2, "frequency_hz": 0.3, "phase_deg": 20.0},
    "sinusoid": {"amplitude": Pose(xyz=(0.1, 0, 0), rpy_deg=(0, 10, 5)), "frequency_hz": 0.5},
    "lissajous": {"amplitude_m": (0.1, 0.2, 0), "frequency_hz": (0.3, 0.2, 0.1)},
    "random_walk": {"rms_m": (0.1, 0.1, 0.05)},
    "carried": {"route": Straight(length_m=5.0)},
    "held": {},
}
KEEP_OUT = {"corner": (-5, -5, -1), "opposite": (5, 5, 0)}


@pytest.mark.parametrize("kind", CAMERAS.members)
def test_every_camera(kind):
    suites.check_camera(CAMERAS.members[kind]())


@pytest.mark.parametrize("kind", FEATURES.members)
def test_every_feature(kind):
    suites.check_feature(FEATURES.members[kind]())


@pytest.mark.parametrize("kind", MOTIONS.members)
def test_every_motion(kind):
    suites.check_motion(MOTIONS.members[kind](**MOTION_EXAMPLES[kind]))


@pytest.mark.parametrize("kind", METRICS.members)
def test_every_metric(kind):
    suites.check_metric(METRICS.members[kind]())


@pytest.mark.parametrize("kind", PERTURBATIONS.members)
def test_every_perturbation(kind):
    suites.check_noise(PERTURBATIONS.members[kind]())


def test_every_monitor():
    rules = {
        "keep_out": KeepOut(**KEEP_OUT),
        "settles": Settles(early=1.0),
        "after_pictures": AfterPictures(pictures=3),
    }
    assert set(MONITORS.members) == set(rules)
    for rule in rules.values():
        suites.check_monitor(rule, ends=quick("view"))


class TestTheSuitesFindWhatIsWrong:
    def test_a_law_that_keeps_state(self, own_kinds):
        with pytest.raises(AssertionError, match="state is passed, not stored"):
            suites.check_law(LAWS.add(Stateful)())

    def test_a_robot_whose_motions_are_not_its_own(self):
        with pytest.raises(AssertionError, match="a motion that its flange_pose does not make"):
            suites.check_robot(Crooked())

    def test_a_detector_that_is_off(self, own_kinds):
        with pytest.raises(AssertionError, match="every marker must be within"):
            suites.check_detector(DETECTORS.add(Shifted)())

    def test_a_target_seen_where_it_is_not(self):
        with pytest.raises(AssertionError, match="seen_from must be points"):
            suites.check_target(Displaced(side=0.4, pose=Pose()))

    def test_a_lens_that_sees_behind_what_is_before_it(self, own_kinds):
        with pytest.raises(
            AssertionError,
            match="backwards: ray\\(project\\(p\\)\\) must point to p; project must be NaN",
        ):
            suites.check_camera(CAMERAS.add(Backwards)())

    def test_a_feature_with_a_wrong_sign(self, own_kinds):
        with pytest.raises(
            AssertionError,
            match=r"mirrored: column vx of L is .* from the error's difference quotient",
        ):
            suites.check_feature(FEATURES.add(Mirrored)())

    def test_a_motion_that_jumps(self, own_kinds):
        with pytest.raises(
            AssertionError, match=r"jumping: the path jumps by 0.1 m within 0.001 s at 1.999 s"
        ):
            suites.check_motion(MOTIONS.add(Jumping)())

    def test_a_motion_that_draws_without_saying_so(self, own_kinds):
        with pytest.raises(
            AssertionError, match="untold: `draws` is False, and another seed gives another path"
        ):
            suites.check_motion(MOTIONS.add(Untold)(rms_m=(0.1, 0.1, 0.1)))

    def test_a_detector_that_draws_without_saying_so(self, own_kinds):
        with pytest.raises(
            AssertionError, match="rolling: `draws` is False, and detect\\(\\) draws from rng"
        ):
            suites.check_detector(DETECTORS.add(Rolling)())

    def test_a_metric_with_another_figure_than_its_title(self, own_kinds):
        with pytest.raises(ParameterError, match=r"forgetful figures\(\) must give first_s"):
            suites.check_metric(METRICS.add(Forgetful)())

    def test_a_perturbation_that_does_nothing(self, own_kinds):
        with pytest.raises(AssertionError, match="idle: none of 400 draws changed the picture"):
            suites.check_noise(PERTURBATIONS.add(Idle)())

    def test_a_monitor_that_keeps_state(self, own_kinds):
        with pytest.raises(
            AssertionError,
            match=r"impatient: timed_out and then|belongs into the object that `monitor` makes",
        ):
            suites.check_monitor(MONITORS.add(Impatient)(), ends=quick("view"))

    def test_a_monitor_that_does_not_end_what_it_must(self):
        far = KeepOut(corner=(90, 90, 90), opposite=(91, 91, 91))
        with pytest.raises(
            AssertionError, match="keep_out: it must end this run, which ended converged"
        ):
            suites.check_monitor(far, ends=quick("view"))

    def test_a_task_that_ends_too_soon(self):
        easy = quick("view")
        easy = replace(easy, stop=replace(easy.stop, converged=Converged(error_px=1e4, hold_s=0.0)))
        with pytest.raises(AssertionError, match="3 frames must not be enough, converged"):
            suites.check_task(easy)


def test_tags_see_only_tags():
    assert Tags.markers == ("tag",)


class TestWhatASuiteAsksForIsSaid:
    def test_an_arm_whose_measured_twist_is_not_its_own(self):
        with pytest.raises(AssertionError, match="measured_twist differs"):
            suites.check_robot(Numb())

    def test_a_law_whose_step_returns_no_command(self, own_kinds):
        for law, got in ((Silent, "NoneType"), (Bare, "(NoneType, ndarray)")):
            r = vs.run(replace(quick("view"), law=LAWS.add(law)()))
            assert r.outcome is vs.Outcome.law_failed
            assert r.reason.startswith(
                f"law {r.scenario.law.kind} returned {got}; its step must return (state, Command)"
            )

    def test_a_law_that_writes_to_itself_is_told_its_own_line(self, own_kinds):
        r = vs.run(replace(quick("view"), law=LAWS.add(Remembering)()))
        assert "FrozenInstanceError" in r.reason and "(wrong.py, line" in r.reason

    def test_a_law_whose_twist_is_not_finite(self, own_kinds):
        r = vs.run(replace(quick("view"), law=LAWS.add(Wild)()))
        assert r.outcome is vs.Outcome.law_failed
        assert r.reason.startswith("law wild gave a twist that is not finite, [nan")

    def test_an_arm_without_a_body(self, own_kinds):
        with pytest.raises(
            ParameterError, match="ghost has joints and no body; let its `body` name an MJCF file"
        ):
            replace(quick("view"), robot=ROBOTS.add(Ghost)())
