"""The Franka Panda against the Robotics Toolbox: pose and Jacobian, by the links that it prints and
by the bundled scenario's file.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vstestbed as vs
from tests.robots.arms import NEEDS_PANDA
from vstestbed.core.geometry import Array, Pose, adjoint, inverse
from vstestbed.robots.chain import JointChain, reader

# github.com/petercorke/robotics-toolbox-python, README.md: the links' table, its pose qr, and the
# pose of the hand there.
LINKS = [
    ("0 0 .333", "0 0 0"),
    ("0 0 0", "-90 0 0"),
    ("0 -.316 0", "90 0 0"),
    (".0825 0 0", "90 0 0"),
    ("-.0825 .384 0", "-90 0 0"),
    ("0 0 0", "90 0 0"),
    (".088 0 0", "90 0 0"),
]
QR = np.array([0, -0.3, 0, -2.2, 0, 2, np.pi / 4])
HAND_AT_QR = [[0.995, 0, 0.09983, 0.484], [0, -1, 0, 0], [0.09983, 0, -0.995, 0.4126], [0, 0, 0, 1]]
# tests/test_DHRobot.py: flange pose, and the Jacobian of the hand in its own axes, at 1, 2, ..., 7
# rad.
SEVEN = np.arange(1.0, 8.0)
FLANGE_AT_SEVEN = [
    [-0.5236, 0.6902, 0.4994, 0.08575],
    [0.8287, 0.5487, 0.1106, 0.3132],
    [-0.1977, 0.4718, -0.8593, 0.5321],
    [0, 0, 0, 1],
]
HANDS_JACOBIAN = [
    [0.3058, 0.1315, -0.2364, -0.0323, 0.0018, 0.2095, 0],
    [0.0954, 0.0303, -0.0721, 0.1494, -0.0258, 0.0144, 0],
    [-0.1469, 0.3385, 0.0506, 0.0847, 0, -0.0880, 0],
    [-0.4734, 0.8292, -0.0732, 0.8991, -0.2788, -0.0685, 0],
    [0.1938, 0.4271, 0.7224, 0.3461, -0.0191, 0.9976, 0],
    [-0.8593, -0.3605, 0.6876, -0.2679, -0.9602, 0, 1],
]


def hand(z: float) -> Array:
    """T_flange_hand: turned by -45 degrees, and so far along z [m]; the toolbox has 103.4 mm in its
    URDF and 103 mm in its table.
    """
    return Pose(xyz=(0, 0, z), rpy_deg=(0, 0, -45)).T


def by_the_printed_links(folder: Path) -> JointChain:
    text = '<site name="flange" pos="0 0 .107"/>'
    for i in reversed(range(7)):
        place, turn = LINKS[i]
        inertia = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        text = (
            f'<body pos="{place}" euler="{turn}">{inertia}'
            f'<joint name="q{i}" axis="0 0 1"/>{text}</body>'
        )
    file = folder / "panda.xml"
    file.write_text(f'<mujoco><compiler angle="degree"/><worldbody>{text}</worldbody></mujoco>')
    return reader().joint_chain(str(file), "flange", ())


def by_the_scenarios_file(_: Path) -> JointChain:
    return vs.load("arm_panda").robot.chain  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize(
    "chain", [by_the_printed_links, pytest.param(by_the_scenarios_file, marks=NEEDS_PANDA)]
)
def test_pose_and_jacobian_are_printed(chain, tmp_path: Path):
    panda = chain(tmp_path)
    # Half of the fourth decimal, the last one that is printed.
    np.testing.assert_allclose(panda.kinematics(QR)[0] @ hand(0.1034), HAND_AT_QR, atol=0.5e-4)
    T, J = panda.kinematics(SEVEN)
    np.testing.assert_allclose(T, FLANGE_AT_SEVEN, atol=0.5e-4)
    np.testing.assert_allclose(adjoint(inverse(hand(0.103))) @ J, HANDS_JACOBIAN, atol=0.5e-4)
