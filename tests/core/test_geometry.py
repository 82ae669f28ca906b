"""Frames and twists: golden numbers, and the neighbourhoods of no turn and of a half turn where
formulas lose their digits.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import (
    Pose,
    adjoint,
    angles,
    clip,
    direction,
    exp,
    inverse,
    joined,
    lengths,
    log,
    pose_from,
    quaternion_wxyz,
    rigid_error,
    rotation_angle,
    rotation_from_quaternion,
    rotation_from_rpy,
    skew,
    transform,
)

GOLDEN = json.loads(
    (Path(__file__).parents[1] / "golden" / "interaction_matrices.json").read_text()
)
# The golden file has 15 digits; its own tolerance is 1e-10 (1 + |value|).
RTOL = ATOL = 1e-10
AXES = [
    np.array([1.0, 0, 0]),
    np.array([0, 0, 1.0]),
    np.array([1.0, -2, 2]) / 3,
    np.array([-0.6, 0.0, 0.8]),
]


def turn(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rotation by Rodrigues' formula with the angle's own sine and cosine."""
    S = skew(axis)
    return np.eye(3) + np.sin(angle) * S + 2 * np.sin(angle / 2) ** 2 * S @ S


class TestGolden:
    @pytest.mark.parametrize("case", GOLDEN["exponential_map"]["cases"])
    def test_exponential(self, case):
        *twist, dt = case["in"]
        np.testing.assert_allclose(exp(np.array(twist) * dt), case["M"], rtol=RTOL, atol=ATOL)

    @pytest.mark.parametrize("case", GOLDEN["velocity_twist"]["cases"])
    def test_adjoint(self, case):
        np.testing.assert_allclose(adjoint(np.array(case["M"])), case["V"], rtol=RTOL, atol=ATOL)

    @pytest.mark.parametrize("case", GOLDEN["rotation_conversions"]["cases"])
    def test_rotations(self, case):
        R, theta_u = np.array(case["R"]), np.array(case["thetau"])
        x, y, z, w = case["q_xyzw"]
        # q and -q are one rotation; ours has w >= 0
        q = np.array([w, x, y, z]) * (1 if w >= 0 else -1)
        np.testing.assert_allclose(quaternion_wxyz(R), q, rtol=RTOL, atol=ATOL)
        np.testing.assert_allclose(rotation_from_quaternion(q), R, rtol=RTOL, atol=ATOL)
        np.testing.assert_allclose(rotation_angle(R), np.linalg.norm(theta_u), rtol=RTOL, atol=ATOL)
        np.testing.assert_allclose(
            exp(np.concatenate([np.zeros(3), theta_u]))[:3, :3], R, rtol=RTOL, atol=ATOL
        )


class TestExponential:
    @pytest.mark.parametrize("size", [0.0, 1e-12, 1e-8, 0.99e-4, 1.01e-4, 1e-2, 3.0])
    def test_one_parameter_group(self, size: float):
        twist = np.array([0.3, -0.2, 0.5, *(size * AXES[2])])
        # exp(2 x) = exp(x) exp(x), on both sides of the series' border: rounding only.
        np.testing.assert_allclose(exp(2 * twist), exp(twist) @ exp(twist), atol=1e-14)
        np.testing.assert_allclose(exp(-twist), inverse(exp(twist)), atol=1e-15)

    @pytest.mark.parametrize("size", [0.0, 1e-8, 1.99e-4, 2.01e-4, 0.3, 3.14])
    def test_the_logarithm_undoes_it(self, size: float):
        twist = np.array([0.3, -0.2, 0.5, *(size * AXES[2])])
        # Rounding; towards half a turn the quaternion's first number is the difference of nearly
        # equal ones.
        np.testing.assert_allclose(log(exp(twist)), twist, atol=1e-11 if size > 3 else 1e-14)

    def test_without_rotation_it_translates(self):
        np.testing.assert_array_equal(exp(np.array([1.0, 2, 3, 0, 0, 0]))[:3, 3], [1, 2, 3])

    def test_series_meets_the_closed_form(self):
        v, w = np.array([0.3, -0.2, 0.5]), AXES[2]
        below, above = (exp(np.concatenate([v, s * w])) for s in (0.9999999e-4, 1.0000001e-4))
        # 2e-11 rad lie between the two; a step from one formula to the other would come on top of
        # that.
        np.testing.assert_allclose(below, above, atol=2.1e-11)

    def test_batches_are_single_ones_stacked(self):
        twists = np.random.default_rng(0).normal(size=(2, 3, 6))
        T = exp(twists)
        for i in np.ndindex(2, 3):
            np.testing.assert_allclose(T[i], exp(twists[i]), atol=1e-15)


class TestAngles:
    @pytest.mark.parametrize("axis", AXES)
    @pytest.mark.parametrize(
        "angle", [0.0, 1e-12, 1e-8, 1e-4, 1.0, np.pi / 2, np.pi - 1e-4, np.pi - 1e-8, np.pi]
    )
    def test_angle_keeps_its_digits_everywhere(self, axis: np.ndarray, angle: float):
        # Rounding of the matrix's elements; an arc cosine of the trace would be off by 1e-8 at both
        # ends.
        assert rotation_angle(turn(axis, angle)) == pytest.approx(angle, abs=4e-15)

    @pytest.mark.parametrize("axis", AXES)
    @pytest.mark.parametrize("angle", [1e-9, 1.0, np.pi - 1e-9, np.pi, np.pi + 1e-9])
    def test_quaternion_through_the_half_turn(self, axis: np.ndarray, angle: float):
        q = quaternion_wxyz(turn(axis, angle))
        expected = np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis])
        assert q[0] >= 0
        # At an exact half turn q and -q are equally good; rounding elsewhere.
        assert min(np.abs(q - expected).max(), np.abs(q + expected).max()) < 4e-15
        np.testing.assert_allclose(rotation_from_quaternion(q), turn(axis, angle), atol=4e-15)


class TestPoses:
    def test_roll_pitch_yaw_is_rz_ry_rx(self):
        roll, pitch, yaw = np.radians([10, 20, 30])
        x, y, z = np.eye(3)
        T = Pose(xyz=(1, 2, 3), rpy_deg=(10, 20, 30)).T
        np.testing.assert_allclose(
            T[:3, :3], turn(z, yaw) @ turn(y, pitch) @ turn(x, roll), atol=1e-15
        )
        np.testing.assert_array_equal(T[:, 3], [1, 2, 3, 1])

    def test_inverse_transform_and_errors(self):
        T = pose_from(np.array([1.0, -2, 0.5]), quaternion_wxyz(turn(AXES[2], 2.0)))
        p = np.random.default_rng(1).normal(size=(5, 3))
        np.testing.assert_allclose(transform(inverse(T), transform(T, p)), p, atol=1e-14)
        position, angle = rigid_error(T, T @ exp(np.array([0.3, 0.4, 0, 0, 0, 0.7])))
        # exp with w along z moves the origin by a chord of the arc of length .5: .5 sin(.35)/.35.
        assert position == pytest.approx(0.5 * np.sin(0.35) / 0.35, abs=1e-14)
        assert angle == pytest.approx(0.7, abs=1e-14)

    def test_adjoint_carries_twists_between_frames_of_one_body(self):
        T_a_b, twist_b = (
            Pose(xyz=(0.1, -0.2, 0.3), rpy_deg=(20, -30, 50)).T,
            np.array([0.1, 0.2, -0.3, 0.4, -0.5, 0.6]),
        )
        # exp(Ad x) = T exp(x) T^-1, the definition.
        np.testing.assert_allclose(
            exp(adjoint(T_a_b) @ twist_b), T_a_b @ exp(twist_b) @ inverse(T_a_b), atol=4e-15
        )

    def test_wrong_poses_are_refused(self):
        with pytest.raises(ParameterError, match="xyz"):
            Pose(xyz=(1, 2))
        with pytest.raises(ParameterError, match="rpy_deg"):
            Pose(rpy_deg=(1, 2, float("nan")))


def test_angles_and_directions_are_inverse():
    p = np.random.default_rng(5).standard_normal((3, 1000, 3))
    theta_phi = angles(p)
    unit = p / np.linalg.norm(p, axis=-1, keepdims=True)
    np.testing.assert_allclose(np.cos(theta_phi[..., 0]), unit[..., 2], atol=1e-15)
    np.testing.assert_allclose(direction(theta_phi), unit, atol=1e-15)


def test_angles_on_and_near_the_axis():
    p = np.array([[0, 0, 2.0], [-0.0, 0.0, -1.0], [1e-12, 0, 1.0], [0, 1e-12, -1.0], [0, 0, 0]])
    expected = [[0, 0], [np.pi, 0], [1e-12, 0], [np.pi - 1e-12, np.pi / 2], [np.nan, np.nan]]
    np.testing.assert_allclose(angles(p), expected, rtol=1e-15, atol=0)


def test_a_pose_is_found_again_from_its_matrix_and_many_rotations_are_as_one():
    rng = np.random.default_rng(4)
    rpy = np.concatenate(
        [rng.uniform(-180, 180, (20, 3)), [[10, 90, 40], [0, -90, 0], [0, 0, 180], [0, 0, 0]]]
    )
    R = rotation_from_rpy(np.radians(rpy))
    for turned, one in zip(rpy.tolist(), R, strict=True):
        pose = Pose(xyz=(1, 2, 3), rpy_deg=tuple(turned))
        assert one == pytest.approx(pose.T[:3, :3], abs=1e-12)
        # at a pitch of 90 degrees, too, other angles
        assert pytest.approx(pose.T, abs=1e-12) == Pose.of(pose.T).T


def test_poses_have_the_same_bits_as_those_of_spatialmath():
    """Logs of earlier versions, which used it, are made again byte for byte."""
    from spatialmath import SE3, SO3
    from spatialmath.base import tr2rpy

    rng = np.random.default_rng(0)
    for rpy in np.concatenate(
        [rng.uniform(-180, 180, (300, 3)), rng.choice([-180, -90, 0, 30, 45, 90, 180.0], (300, 3))]
    ):
        expected = SE3.Rt(SO3.RPY(*rpy, order="zyx", unit="deg"), [1.0, 2.0, 3.0]).A
        assert (
            Pose(xyz=(1.0, 2.0, 3.0), rpy_deg=tuple(rpy.tolist())).T.tobytes() == expected.tobytes()
        )
        angles = tr2rpy(expected[:3, :3], order="zyx", unit="deg", check=False)
        assert np.array(Pose.of(expected).rpy_deg).tobytes() == np.asarray(angles, float).tobytes()


def test_shortcuts_are_what_they_replace():
    """To the last bit: logs must not depend on which of them is used."""
    rng = np.random.default_rng(5)
    p = rng.normal(size=(3, 5, 2))
    np.testing.assert_array_equal(lengths(p), np.linalg.norm(p, axis=-1, keepdims=True))
    np.testing.assert_array_equal(
        joined(p[..., 1], p[..., 0], 1.0),
        np.stack([p[..., 1], p[..., 0], np.ones((3, 5))], axis=-1),
    )
    for x in (-3.0, -1.0, 0.2, 2.0, 5.0, float("nan")):
        assert clip(x, -1.0, 2.0) == max(-1.0, min(2.0, x))
