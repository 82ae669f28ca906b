"""The robot my_robot, by the camera motions that it can make and its limits.

    pytest my_robot.py
    vstestbed run ibvs_book --plugin my_robot.py --set robot.kind=my_robot

It is a gantry without mass: it moves the camera along x, y, z and turns it about the optical axis,
up to a speed. A robot with a body names its MJCF file in `model`; an arm that has such a file needs
no class: `robot: {kind: mjcf, file: arm.xml, ...}`.
"""

from typing import Literal

import numpy as np

import vstestbed as vs
import vstestbed.testing
from vstestbed.robots import Free

# (6, 4): the flange twists vx, vy, vz and wz, (v, w) in the flange's frame
MOTIONS = np.eye(6)[:, [0, 1, 2, 5]]


@vs.ROBOTS.add
@vs.spec
class MyRobot(Free):
    """A flying flange with four motions; `Free` has the start block, and places the flange at
    `start.nominal`.

    Args:
        speed_mps: largest speed of the camera [m/s].
    """

    kind: Literal["my_robot"] = "my_robot"  # pyright: ignore[reportIncompatibleVariableOverride] - a word of its own
    speed_mps: float = 0.5

    def motion_basis(self, mount, q):
        """Camera twists (6, 4) of its motions; `mount.to_camera` (6, 6) maps flange twists to the
        camera's.
        """
        return mount.to_camera @ MOTIONS

    def allocate(self, twist, reading, mount, period):
        """The setpoint (here the flange's twist) for a camera twist (6,), within the limits for one
        period [s].
        """
        flange = MOTIONS @ MOTIONS.T @ mount.to_flange @ twist  # what it cannot do is left out
        scale = min(1.0, self.speed_mps / max(float(np.linalg.norm(flange[:3])), 1e-12))
        limit = "speed" if scale < 1 else ""
        return vs.Allocation(
            setpoint=flange * scale,
            twist=mount.to_camera @ flange * scale,
            scale=scale,
            limit=limit,
        )

    def measured_twist(self, before, now, duration, commanded, mount):
        """The camera's mean twist (6,) between two readings: of a robot without mass what was
        commanded.
        """
        return commanded

    def started_at(self, configuration):
        """The same robot from another pose, flat (16,)."""
        return MyRobot(start=super().started_at(configuration).start, speed_mps=self.speed_mps)

    def randomised(self, rng):
        """The same robot with a start drawn from `start.random`."""
        return MyRobot(start=super().randomised(rng).start, speed_mps=self.speed_mps)


def test_my_robot():
    """Its motions agree with its poses, its start is where it says, and its limits hold."""
    start = {"nominal": {"xyz": (0, 0, -1)}}
    vstestbed.testing.check_robot(MyRobot(start=start))  # pyright: ignore[reportArgumentType] - a mapping becomes the block
