"""The ideal camera: it follows its commanded twist exactly, by the SE(3) exponential."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Discriminator, Tag

from vstestbed.core.geometry import Array, Pose
from vstestbed.core.quantity import Angles, Position
from vstestbed.core.spec import spec
from vstestbed.robots.allocation import ALL_SIX, Allocation, Mount
from vstestbed.robots.base import Reading, Robot, random_of
from vstestbed.robots.puma560 import Puma560, PumaStart


@spec
class Box:
    """A box of start poses round the nominal one.

    Args:
        xyz: half widths along world axes [m].
        rpy_deg: half widths in roll, pitch and yaw [deg].
    """

    xyz: Position = (0.0, 0.0, 0.0)
    rpy_deg: Angles = (0.0, 0.0, 0.0)


def _which(value: object) -> str:
    """Which of the two blocks of random starts is meant, so that its mistakes alone are named."""
    arm = isinstance(value, PumaStart) or (
        isinstance(value, dict) and not value.keys().isdisjoint(("nominal", "random"))
    )
    return "PumaStart" if arm else "Box"


RandomStart = Annotated[
    Annotated[Box, Tag("Box")] | Annotated[PumaStart, Tag("PumaStart")], Discriminator(_which)
]


@spec
class FreeStart:
    """Where the camera starts: `nominal`, and what `random` starts are drawn from.

    `random` is a box of poses, or an arm's start block (`nominal` and `random` with their q_deg):
    each seed then starts the camera where it starts the arm's flange, so that ideal and real motion
    can be compared in pairs.

    Args:
        nominal: the camera's pose in the world at the start of a run without a seed.
        random: what the start of a run with a seed is drawn from.
    """

    nominal: Pose
    random: RandomStart | None = None


@spec
class Free(Robot):
    """A camera without mass; its flange is the camera's body.

    Args:
        start: where the camera starts.
    """

    kind: Literal["free"] = "free"
    start: FreeStart

    def configuration(self) -> Array:
        """The nominal start as a flat pose, shape (16,)."""
        return self.start.nominal.T.ravel()

    def randomised(self, rng: np.random.Generator) -> Free:
        box = random_of(self.start, "{xyz: [.2, .2, .2]}")
        if isinstance(box, PumaStart):
            # By the arm's own draw, joint by joint: the same random numbers give the arm's flange
            # pose of the same seed.
            arm = Puma560(start=box).randomised(rng)
            nominal = Pose.of(arm.flange_pose(arm.configuration()))
            return Free(start=FreeStart(nominal=nominal, random=box))
        xyz = np.array(self.start.nominal.xyz) + rng.uniform(-1, 1, 3) * box.xyz
        rpy = np.array(self.start.nominal.rpy_deg) + rng.uniform(-1, 1, 3) * box.rpy_deg
        nominal = Pose(xyz=tuple(xyz.tolist()), rpy_deg=tuple(rpy.tolist()))
        return Free(start=FreeStart(nominal=nominal, random=box))

    def started_at(self, configuration: Array) -> Free:
        """The same camera from another pose, flat (16,)."""
        return Free(
            start=FreeStart(nominal=Pose.of(configuration.reshape(4, 4)), random=self.start.random)
        )

    def configuration_at(self, T_world_flange: Array, near: Array) -> Array:
        """The pose itself, flat (16,)."""
        return T_world_flange.ravel()

    def flange_pose(self, configuration: Array) -> Array:
        """The pose itself, (4, 4)."""
        return configuration.reshape(4, 4)

    def motion_basis(self, mount: Mount, q: Array) -> Array:
        return ALL_SIX

    def measured_twist(
        self, before: Reading, now: Reading, duration: float, commanded: Array, mount: Mount
    ) -> Array:
        """The commanded twist, which it follows exactly."""
        return commanded

    def stopping(self, setpoint: Array, elapsed_s: float) -> Array:
        """It has no mass, and stops at once."""
        return np.zeros_like(setpoint)

    def allocate(self, twist: Array, reading: Reading, mount: Mount, period: float) -> Allocation:
        """The twist of the flange that gives the camera this twist; no limits."""
        return Allocation(setpoint=mount.to_flange @ twist, twist=twist)
