"""A planar arm of two links as a robot plugin: two joints, a basis that depends on the
configuration; its body is in two_link.xml.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.core.spec import spec
from vstestbed.robots import Allocation, BodyFile, Mount, RobotBase
from vstestbed.robots.base import Reading

LENGTHS = 0.5, 0.4
SPEED_LIMIT = 2.0


@spec
class TwoLinkStart:
    """Joint angles [rad]."""

    q: tuple[float, float] = (0.3, 0.8)
    random: float | None = None


@spec
class TwoLink(RobotBase):
    """Two joints about the world's z axis; the flange at the tip, 1 m up, its x axis along the
    second link.
    """

    kind: Literal["two_link"] = "two_link"
    start: TwoLinkStart = TwoLinkStart()
    joints: ClassVar[tuple[str, ...]] = ("shoulder", "elbow")
    body: ClassVar[BodyFile] = BodyFile(str(Path(__file__).with_suffix(".xml")), actuators=joints)

    def configuration(self) -> Array:
        """Joint angles (2,) [rad]."""
        return np.array(self.start.q)

    def start_joints(self) -> Array:
        """Those of the configuration."""
        return self.configuration()

    def started_at(self, configuration: Array) -> TwoLink:
        """From other angles."""
        a, b = configuration.tolist()
        return replace(self, start=TwoLinkStart(q=(a, b)))

    def randomised(self, rng: np.random.Generator) -> TwoLink:
        """It has no random block."""
        from vstestbed.core.errors import ParameterError

        raise ParameterError("robot.start.random", "is missing")

    def flange_pose(self, configuration: Array) -> Array:
        """T_world_flange (4, 4)."""
        a, b = configuration[0], configuration[0] + configuration[1]
        x = LENGTHS[0] * np.cos(a) + LENGTHS[1] * np.cos(b)
        y = LENGTHS[0] * np.sin(a) + LENGTHS[1] * np.sin(b)
        return np.array(
            [
                [np.cos(b), -np.sin(b), 0, x],
                [np.sin(b), np.cos(b), 0, y],
                [0, 0, 1, 1.0],
                [0, 0, 0, 1],
            ]
        )

    def jacobian(self, q: Array) -> Array:
        """Flange twists (6, 2), (v, w) in the flange's frame, of the joints' speeds."""
        J = np.zeros((6, 2))
        J[0, 0], J[1, 0], J[1, 1] = (
            LENGTHS[0] * np.sin(q[1]),
            LENGTHS[1] + LENGTHS[0] * np.cos(q[1]),
            LENGTHS[1],
        )
        J[5] = 1.0
        return J

    def motion_basis(self, mount: Mount, q: Array) -> Array:
        """Camera twists of the two joints, shape (6, 2): u is the joints' speeds."""
        return mount.to_camera @ self.jacobian(q)

    def measured_twist(
        self, before: Reading, now: Reading, duration: float, commanded: Array, mount: Mount
    ) -> Array:
        """Mean camera twist (6,)."""
        return (
            self.motion_basis(mount, (before.q + now.q) / 2) @ (now.q - before.q) / duration
            if duration > 0
            else np.zeros(6)
        )

    def allocate(self, twist: Array, reading: Reading, mount: Mount, period: float) -> Allocation:
        """Joint speeds (2,) by least squares, scaled into the limits."""
        basis = self.motion_basis(mount, reading.q)
        u = np.linalg.lstsq(basis, twist, rcond=None)[0]
        scale = min(1.0, SPEED_LIMIT / max(float(np.abs(u).max()), 1e-12))
        return Allocation(
            setpoint=u * scale,
            twist=basis @ u * scale,
            scale=scale,
            limit="speed" if scale < 1 else "",
        )
