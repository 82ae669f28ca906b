"""Poses as spatialmath writes them: in and out to 1e-12, at a pitch of 90 degrees, too; what is no
pose is refused with a sentence.
"""

from __future__ import annotations

import numpy as np
import pytest
from spatialmath import SE2, SE3, SO3, Twist3

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose
from vstestbed.core.planar import GroundPose, block_of
from vstestbed.core.spatial import pose_matrix, twist_numbers
from vstestbed.core.spec import spec
from vstestbed.robots.quadrotor import FlightPose


@spec
class Positioned:
    """A block with a field of each kind of pose."""

    pose: Pose = Pose()
    place: GroundPose = GroundPose()
    hover: FlightPose = FlightPose()


def random_pose(rng: np.random.Generator) -> SE3:
    return SE3.Rt(SO3.RPY(rng.uniform(-np.pi, np.pi, 3)), rng.uniform(-3, 3, 3))


@pytest.mark.parametrize(
    "off", [0.0, 1e-16, 1e-15, 1e-12, 1e-10, 1e-8, 1e-7, 1e-6, 1e-5, 1e-3, 0.1, 1.0]
)
def test_a_pose_goes_in_and_comes_out_near_a_pitch_of_90_degrees_and_elsewhere(off: float) -> None:
    rng = np.random.default_rng(1)
    for _ in range(40):
        pitch = rng.choice([-1, 1]) * (np.pi / 2 + off * rng.normal())
        plain = (
            SE3(rng.uniform(-3, 3, 3))
            * SE3.Rz(rng.uniform(-3, 3))
            * SE3.Ry(pitch)
            * SE3.Rx(rng.uniform(-3, 3))
        )
        other = random_pose(rng)
        # the same pose with other errors of rounding in its last digits
        rounded = other.inv() * (other * plain)
        for T in (plain, rounded):
            pose = Positioned(pose=T).pose
            assert np.abs(pose.T - T.A).max() < 1e-13
            assert np.abs(Pose.of(T).T - T.A).max() < 1e-13
            assert np.abs(pose.SE3().A - T.A).max() < 1e-13


def test_the_numbers_are_those_a_person_would_write() -> None:
    pose = Positioned(
        pose=SE3(1.5, 0, 0.1 + 0.2)
        * SE3.Ry(90, unit="deg")
        * SE3.Rz(-30, unit="deg")
        * SE3.Rz(30, unit="deg")
    ).pose
    assert pose == Pose(xyz=(1.5, 0.0, 0.3), rpy_deg=(0.0, 90.0, 0.0))
    assert "-0.0" not in str(Positioned(pose=SE3.Rx(np.pi)).pose)


def test_places_on_the_floor() -> None:
    rng = np.random.default_rng(2)
    for x, y, heading in rng.uniform(-3, 3, (50, 3)):
        flat = SE2(x, y, heading)
        for given in (flat, flat.A, flat.SE3(), flat.SE3().A):
            assert np.abs(Positioned(place=given).place.T - flat.SE3().A).max() < 1e-12
        hover = Positioned(hover=SE3(0, 0, 2) * flat.SE3()).hover
        assert (
            np.abs(
                Pose(xyz=hover.xyz, rpy_deg=(0, 0, hover.yaw_deg)).T - (SE3(0, 0, 2) * flat.SE3()).A
            ).max()
            < 1e-12
        )
    assert block_of(SE2(1, 2, np.pi / 2)) == {"x": 1.0, "y": 2.0, "heading_deg": 90.0}
    assert block_of(SE3(1, 2, 3)) == {"xyz": [1.0, 2.0, 3.0], "rpy_deg": [0.0, 0.0, 0.0]}
    assert block_of("still") == "still"


def test_what_is_no_pose_is_refused_with_a_sentence() -> None:
    for field, given, words in (
        ("pose", SE3.Rx([0.1, 0.2]), "pose must be one pose: take one of them, as poses.0., got 2"),
        ("pose", SE3.Empty(), "pose must be one pose: .*, got 0"),
        (
            "pose",
            SE2(1, 2, 3),
            (
                r"pose is a place in the plane \(SE2\), and here a pose in space belongs;"
                r" its SE3\(\) lifts it"
            ),
        ),
        ("pose", SO3(), r"pose must be a pose \(SE3\), got an SO3; SE3.Rt"),
        ("pose", Twist3([1, 2, 3, 4, 5, 6]), r"pose must be a pose \(SE3\), got a Twist3"),
        (
            "pose",
            np.eye(3),
            (
                r"pose must be a pose:"
                r" an SE3, or a homogeneous matrix \(4, 4\), got ndarray of shape \(3, 3\)"
            ),
        ),
        ("pose", np.full((4, 4), np.nan), "pose must be finite"),
        ("pose", np.diag([1.0, 1.0, -1.0, 1.0]), "pose is no rigid motion: it mirrors"),
        (
            "pose",
            np.diag([1.0, 1.01, 1.0, 1.0]),
            r"pose is no rigid motion: its axes are not .* \(off by 0.02\); SE3.norm\(\)",
        ),
        (
            "pose",
            SE3(1, 2, 3).A.T,
            "pose must end with the row 0 0 0 1; perhaps it is the transpose",
        ),
        ("pose", SE3(1500, 0, 700), "must be -1000 to 1000 m"),
        ("place", SE3(1, 2, 0.5), "place must be at height 0 on the floor, got 'z = 0.5 m'"),
        (
            "place",
            SE3.Rx(0.1),
            r"place must be upright, .* the z axis of this pose is \[0.0, -0.1, 0.995\]",
        ),
        ("place", SE2([SE2(), SE2()]), "place must be one pose: .*, got 2"),
        ("hover", SE3.Ry(np.pi), "hover must be upright"),
    ):
        with pytest.raises(ParameterError, match=words):
            Positioned(**{field: given})


def test_a_rotation_of_six_digits_is_a_rotation() -> None:
    T = np.round(random_pose(np.random.default_rng(3)).A, 7)
    assert np.abs(Positioned(pose=T).pose.T - T).max() < 1e-6


def test_matrices_and_twists() -> None:
    T = pose_matrix([[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    assert T[:3, 3].tolist() == [1, 2, 3]
    assert twist_numbers(Twist3([1, 2, 3, 4, 5, 6])).tolist() == [1, 2, 3, 4, 5, 6]
    assert twist_numbers([1, 2]) == [1, 2]
    with pytest.raises(ParameterError, match=r"command must be one twist: .*, got 2"):
        twist_numbers(Twist3([Twist3(np.ones(6)), Twist3(np.ones(6))]))
    with pytest.raises(
        ParameterError, match=r"command must be a twist \(Twist3\) or numbers, got an SE3"
    ):
        twist_numbers(SE3())
