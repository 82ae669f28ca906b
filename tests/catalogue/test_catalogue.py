"""The catalogue: every registered kind passes the suites that a plugin is tested with (`vstestbed.testing`)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import vstestbed as vs
import vstestbed.testing as suites
from tests.examples import wrong
from tests.examples.wrong import Crooked, Displaced, Ghost, Numb, Shifted, Silent, Stateful, Wild
from tests.robots.arms import block
from vstestbed.core.assets import folder
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose
from vstestbed.laws import LAWS
from vstestbed.robots import ROBOTS, Free
from vstestbed.robots.free import FreeStart
from vstestbed.targets import TARGETS, GroundLines, MeshTarget, PictureTarget, Points, Square
from vstestbed.targets.route import Straight
from vstestbed.tasks import GOALS
from vstestbed.tasks.stop import Converged
from vstestbed.testing.scenarios import quick
from vstestbed.vision import DETECTORS, Tags

POLICY = {"file": str(Path(wrong.__file__).with_name("policy.py")) + ":Smooth"}
LAW_PARAMETERS = {word: {"gain": 1.0} for word in ("partitioned", "pbvs", "hybrid", "ibvs")} | {"policy": POLICY}
TASKS = {
    "view": lambda: quick("view"),
    "view_from": lambda: scenario("omni_ibvs", {"robot.wheels": "planar"}),
    "views": lambda: scenario("omni_via_points", {"robot.wheels": "planar"}),
    "pose": lambda: quick("pose"),
    "gap": lambda: quick("gap"),
    "line": lambda: quick("line"),
    "track": lambda: scenario("arm_track_circle", {"stop.duration_s": 8.0}),
    "path": lambda: quick("path"),
    "landing": lambda: quick("landing"),
}
TARGET_EXAMPLES = {
    "square": lambda: Square(side=0.4, pose=Pose(xyz=(0, 0, 1))),
    "points": lambda: Points(at=((0, 0, 0), (0.2, 0, 0.1), (0, 0.3, 0)), pose=Pose(xyz=(0, 0, 1))),
    "picture": lambda: PictureTarget(file=str(folder("scenarios") / "targets" / "page.png"), width=0.6, pose=Pose(xyz=(0, 0, 1))),
    "mesh": lambda: MeshTarget(
        file=str(folder("scenarios") / "targets" / "flange.stl"),
        scale=0.001,
        at=((85, 85, 18), (-110, 0, 18), (0, 100, 0)),
        pose=Pose(xyz=(0, 0, 1)),
    ),
    "lines": lambda: GroundLines(route=Straight(length_m=5.0)),
}


def scenario(name, changes):
    return vs.load(name, {"detector": {"kind": "oracle"}, **changes})


def robot(kind):
    if kind == "mjcf":
        return ROBOTS.members[kind](**{name: value for name, value in block("scara").items() if name != "kind"})
    return Free(start=FreeStart(nominal=Pose(xyz=(0, 0, -1)))) if kind == "free" else ROBOTS.members[kind]()


def test_the_catalogue_is_whole():
    assert set(TASKS) == set(GOALS.members)
    assert set(TARGET_EXAMPLES) == set(TARGETS.members)


@pytest.mark.parametrize("kind", LAWS.members)
def test_every_law(kind):
    suites.check_law(LAWS.members[kind](**LAW_PARAMETERS.get(kind, {})))


@pytest.mark.parametrize("kind", ROBOTS.members)
def test_every_robot(kind):
    suites.check_robot(robot(kind))


@pytest.mark.parametrize("kind", TARGETS.members)
def test_every_target(kind):
    suites.check_target(TARGET_EXAMPLES[kind]())


@pytest.mark.parametrize("kind", DETECTORS.members)
def test_every_detector(kind):
    suites.check_detector(DETECTORS.members[kind]())


@pytest.mark.parametrize("kind", GOALS.members)
def test_every_task(kind):
    suites.check_task(TASKS[kind]())


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
        with pytest.raises(ParameterError, match=r"silent: step must return \(memory, Command\), got NoneType"):
            vs.run(replace(quick("view"), law=LAWS.add(Silent)()))

    def test_a_law_whose_twist_is_not_finite(self, own_kinds):
        r = vs.run(replace(quick("view"), law=LAWS.add(Wild)()))
        assert r.outcome is vs.Outcome.law_failed and r.reason.startswith("law wild gave a twist that is not finite, [nan")

    def test_an_arm_without_a_body(self, own_kinds):
        with pytest.raises(ParameterError, match="ghost has joints and no body; let its `model` name an MJCF file"):
            replace(quick("view"), robot=ROBOTS.add(Ghost)())
