"""The true links of an arm: displaced as its geometry's errors say, against the product of its DH
frames and its first-order model.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vstestbed as vs
from tests.robots.arms import HERE
from tests.robots.denavit_hartenberg import DH
from tests.robots.denavit_hartenberg import frames as frames_of
from tests.shortcuts import forward
from tests.sim.two_mass import arm, stage_of
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, adjoint, inverse, log
from vstestbed.effects.links import GeometryError, Payload
from vstestbed.robots import Puma560
from vstestbed.sim.base import SceneDescription
from vstestbed.sim.scene.scene import Scene

JOINTS = np.radians(
    [[0, 45, -180, 0, 45, -45], [30, -20, -60, 80, -40, 100], [-100, 120, -10, -50, 70, 10]]
)


def true_pose(robot: Puma560, q: Array) -> Array:
    """T_world_flange (4, 4) by MuJoCo."""
    s = vs.load("arm_ibvs")
    stage = Scene(SceneDescription(robot, s.camera, s.target, s.world, step=0.002))
    stage.place(0.0, s.target.T_world_start, q)
    T = stage.camera_pose() @ inverse(s.camera.mount.T)
    stage.close()
    return T


def wrong(scale: float, seed: int = 0) -> Puma560:
    return Puma560(geometry_error=GeometryError(sigma_m=1e-3 * scale, sigma_deg=0.1 * scale)).drawn(
        np.random.default_rng(seed)
    )


@pytest.mark.parametrize("q", JOINTS)
def test_the_flange_is_at_the_product_of_its_links(q: Array) -> None:
    robot = wrong(1.0)
    assert robot.geometry_error is not None
    D, frames, T = robot.geometry_error.displacements(6), frames_of(q), np.eye(4)
    assert D is not None
    for i in range(6):
        T = T @ inverse(frames[i]) @ frames[i + 1] @ D[i]
    np.testing.assert_allclose(true_pose(robot, q), T, atol=1e-12)
    np.testing.assert_allclose(robot.kinematics(q)[0], forward(q), atol=1e-15)  # it does not know


def test_its_error_is_that_of_the_first_order_model() -> None:
    """sum Ad(T_i,flange^-1) d_i; what is left falls with the square of the errors."""
    left = []
    for scale in (1.0, 0.1):
        robot, q = wrong(scale), JOINTS[1]
        assert robot.geometry_error is not None
        frames, twist = frames_of(q), np.zeros(6)
        for i, pose in enumerate(robot.geometry_error.offsets):
            twist += adjoint(inverse(inverse(frames[i + 1]) @ frames[6])) @ np.array(
                [*pose.xyz, *np.radians(pose.rpy_deg)]
            )
        found = log(inverse(forward(q)) @ true_pose(robot, q))
        assert np.abs(found).max() > 1e-3 * scale
        left.append(np.abs(found - twist).max())
    assert left[0] < 2e-5 and left[1] < 0.02 * left[0]


def test_errors_of_dh_parameters_are_displacements() -> None:
    """Joint 3 with a longer by 2 mm, alpha by 0.2 deg, d by 1 mm, theta by 0.1 deg: the table with
    these numbers.
    """
    da, dalpha, dd, dtheta = 2e-3, np.radians(0.2), 1e-3, np.radians(0.1)

    def link(d: float, a: float, alpha: float, theta: float) -> Array:
        turn, tilt = (
            Pose(rpy_deg=(0, 0, np.degrees(theta))).T,
            Pose(rpy_deg=(np.degrees(alpha), 0, 0)).T,
        )
        return turn @ Pose(xyz=(a, 0, d)).T @ tilt

    d, a, alpha = DH[2]
    D = inverse(link(d, a, alpha, 0.0)) @ link(d + dd, a + da, alpha + dalpha, dtheta)
    robot = Puma560(
        geometry_error=GeometryError(
            offsets=(Pose(), Pose(), vs.Pose(**_block(D)), Pose(), Pose(), Pose())
        )
    )
    q, frames = JOINTS[1], frames_of(JOINTS[1])
    T = (
        frames[2]
        @ link(d + dd, a + da, alpha + dalpha, q[2] + dtheta)
        @ inverse(frames[3])
        @ frames[6]
    )
    np.testing.assert_allclose(true_pose(robot, q), T, atol=1e-9)


def _block(T: Array) -> dict[str, tuple[float, ...]]:
    from spatialmath import SE3

    return {
        "xyz": tuple(T[:3, 3].tolist()),
        "rpy_deg": tuple(SE3(T, check=False).rpy(unit="deg", order="zyx").tolist()),
    }


def test_an_arm_by_its_file_is_displaced_too(tmp_path: Path) -> None:
    offsets = (Pose(xyz=(0, 0, 0.01)), Pose(xyz=(0.02, 0, 0)))
    robot = arm(tmp_path, geometry_error=GeometryError(offsets=offsets))
    stage = stage_of(robot)
    assert stage.camera_pose()[:3, 3] is not None
    stage.place(0.0, stage.target_pose(), np.zeros(2))
    assert stage.camera_pose()[:3, 3] == pytest.approx([0.62, 0, 1.01])
    stage.close()


def test_joints_of_one_body_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "one.xml"
    path.write_text(
        (HERE / "two_link.xml")
        .read_text()
        .replace(
            '<joint name="shoulder"/>', '<joint name="shoulder"/><joint name="tilt" axis="0 1 0"/>'
        )
    )
    robot = vs.ROBOTS.members["mjcf"](
        file=str(path),
        speed_limits=(1, 1, 1),
        start={"nominal": {"q_deg": [0, 0, 0]}},
        geometry_error=GeometryError(offsets=(Pose(), Pose(), Pose())),
    )
    with pytest.raises(ParameterError, match="shares its body with another joint"):
        stage_of(robot)


def test_a_payload_has_its_mass_inertia_and_place(tmp_path: Path) -> None:
    plain, laden = (
        stage_of(arm(tmp_path, payload=p))
        for p in (None, Payload(mass_kg=3.0, com_m=(0.1, 0.2, 0.0), edge_m=0.2))
    )
    assert laden.model.body_mass.sum() - plain.model.body_mass.sum() == pytest.approx(3.0)
    body = laden.model.body("robot/payload")
    assert body.inertia == pytest.approx([0.02] * 3)
    laden.place(0.0, laden.target_pose(), np.zeros(2))
    assert laden.data.xpos[body.id] == pytest.approx([0.7, 0.2, 1.0])
    plain.close(), laden.close()
