"""Lost markers in the reason of a run: which, where they left the picture, when, and what would
help.
"""

import re
from dataclasses import replace

import numpy as np
import pytest

import vstestbed as vs
from tests.tasks.frames import frame
from vstestbed.core.geometry import Pose, inverse
from vstestbed.core.outcome import Outcome
from vstestbed.laws import IBVS, QP
from vstestbed.laws.points import Visibility
from vstestbed.loop.explanation import LostMarkers, _takes  # pyright: ignore[reportPrivateUsage]

SOON = {"stop.lost_after_s": 0.2, "stop.duration_s": 3.0, "camera.rate_hz": 25}
SIDEWAYS = {
    "robot.start.nominal": {"xyz": [0, 0, -1], "rpy_deg": [0, 0, 0]},
    "target.pose.xyz": [0, 0, 0],
    "detector": "oracle",
}
PLATE = {"world.plates": [{"pose": {"xyz": [1.0, 0, 0.7], "rpy_deg": [0, 90, 0]}, "from_s": 0.4}]}


def reason(name: str, **changes: object) -> str:
    recording = vs.run(vs.load(name, SOON | changes))
    assert recording.outcome is Outcome.target_lost
    return recording.reason


@pytest.mark.parametrize(
    ("xyz", "border"),
    [
        ([0.45, 0, -1], "left"),
        ([-0.45, 0, -1], "right"),
        ([0, 0.45, -1], "top"),
        ([0, -0.45, -1], "bottom"),
    ],
)
def test_the_border(xyz: list[float], border: str):
    said = reason("ibvs_book", **SIDEWAYS | {"robot.start.nominal.xyz": xyz})
    assert re.search(
        (
            rf"; markers \d, \d were beyond the {border} border of the picture"
            r" from the start on; a wider camera"
        ),
        said,
    )


def test_what_hides_them_and_from_when_on():
    for detector in ("oracle", "blobs"):  # blobs know nothing of a plate: the judge does
        said = reason("arm_ibvs", **PLATE, detector=detector)
        assert (
            "markers 0, 1, 2, 3 were hidden by plate_0 from 0.40 s on; move what hides them" in said
        )
        assert said.endswith("; the robot stands")


def test_too_small_with_the_radius_and_the_least_that_is_found():
    said = reason("arm_ibvs", **{"target.marker.radius": 0.002})
    assert (
        "markers 0, 1, 2, 3 were too small (a radius of 0.85 px;"
        " blobs finds 1.7 px and more, of full colour) from the start on" in said
    )
    assert "larger markers (target.marker.radius)" in said
    # no guess where the truth is known
    assert "has not found one of 4 markers in any picture) for 0.2 s; markers" in said
    assert said.count("from the start on") == 1


def test_only_laws_that_the_scenario_takes_are_advised():
    for changes, advice in (
        (
            {},
            (
                "a wider camera, a start nearer to the goal view, or a law that minds the border"
                " (law.visibility, law: qp) would help"
            ),
        ),
        (
            {"law": "pbvs"},
            (
                "a wider camera, a start nearer to the goal view, or a law that minds the border"
                " (law: qp) would help"
            ),
        ),
        ({"law": "qp"}, "a wider camera or a start nearer to the goal view would help"),
    ):
        assert f"; {advice}" in reason(
            "ibvs_book", **SIDEWAYS | {"robot.start.nominal.xyz": [0.45, 0, -1]} | changes
        )


def test_a_camera_that_sees_all_round_is_not_advised_to_mind_its_border():
    assert not _takes(vs.load("quadrotor_hover"), IBVS(visibility=Visibility(margin_px=1.0)))
    assert not _takes(vs.load("omni_ibvs"), QP()) and _takes(vs.load("arm_ibvs"), QP())


def test_a_cause_that_is_not_known_is_not_named():
    said = reason("arm_ibvs", **{"noise.dropout": 0.99, "detector": "oracle"})
    assert (
        "not found although in the picture (with a radius of " in said
        and "why is not known" in said
    )


class TestStart:
    def test_behind_the_target(self):
        said = reason("ibvs_book", **{"robot.start.nominal.xyz": [0, 0, 4]})
        assert (
            said.startswith("the camera starts behind the plane of the target")
            and "start in front of it" in said
        )


class TestFrames:
    """One marker after the other, without a run."""

    S = vs.load("ibvs_book", SIDEWAYS)

    def given(self, t: float, *unseen: int, x: float = 0.0):
        T = Pose(xyz=(x, 0, -1)).T
        one = frame(t, T_world_camera=T)
        p = self.S.target.points_at(inverse(T))
        uv = np.where(np.isin(np.arange(4), unseen)[:, None], np.nan, self.S.camera.project(p))
        truth = one.truth._replace(p_camera=p, hidden=np.zeros(4, dtype=bool))
        error = one.error._replace(all_seen=not unseen)
        return replace(one, observation=replace(one.observation, uv=uv), error=error, truth=truth)

    def test_each_has_its_time_and_comes_back(self):
        lost = LostMarkers(self.S, lambda T, p: ("",) * len(p))
        lost.add(self.given(0.0))
        assert lost.sentence() == ""
        lost.add(self.given(0.04, 3, x=0.45))
        lost.add(self.given(0.08, 0, 3, x=0.45))
        lost.add(self.given(0.12, 0, 2, 3, x=0.45))
        assert lost.sentence().startswith(
            "markers 0, 3 were beyond the left border of the picture from 0.04 s on,"
            " the last one from 0.08 s on; "
        )
        assert "marker 2 was not found although in the picture" in lost.sentence()
        lost.add(self.given(0.16, 2))
        assert "markers" not in lost.sentence().split(";")[0] and "marker 2" in lost.sentence()

    def test_a_marker_that_does_not_count_is_not_missed(self):
        lost = LostMarkers(self.S, lambda T, p: ("",) * len(p))
        one = self.given(0.0, 3)
        lost.add(replace(one, goal=replace(one.goal, counted=np.array([True, True, True, False]))))
        assert lost.sentence() == ""


def test_the_near_plane_of_the_pictures_is_named():
    """The lens of an arm's camera lies within the wrist, so that nothing near it is drawn; a target
    stands 4 mm before it.
    """
    with vs.Session(vs.load("arm_ibvs", {"detector": "oracle"})) as session:
        T_world_camera = session.reset().truth.T_world_camera
    T_world_target = T_world_camera @ Pose(xyz=(0, 0, 0.004)).T
    small = {
        "target.side": 0.002,
        "target.marker.radius": 0.0003,
        "goal.T_camera_target.xyz": [0, 0, 0.003],
        "target.pose": T_world_target,
    }
    assert (
        "were hidden by the near plane (nothing within 6 mm of the lens is drawn) from the start on"
        in reason("arm_ibvs", **small)
    )
