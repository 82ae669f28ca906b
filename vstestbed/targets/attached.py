"""Targets attached to something that moves: a vehicle on a route, or the robot's gripper (eye to hand)."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from vstestbed.core.geometry import Array
from vstestbed.core.planar import pose_on_ground
from vstestbed.core.quantity import Length, Narrower, PositiveSpeed
from vstestbed.core.spec import OneOf, spec
from vstestbed.targets.motion import OWN_MOTIONS, MotionBase
from vstestbed.targets.route import AnyRoute


@spec
class Carried(MotionBase):
    """The target rides on a vehicle that drives along a route; `target.pose` is then where it sits in the vehicle's frame.

    The vehicle is simulated with its masses, wheels and servos. Its driver steers by the true place, and is no part of the experiment.

    Args:
        by: the vehicle's kind. It starts on the route.
        route: its path on the floor.
        speed_mps: its speed [m/s].
        from_m: arc length on the route at which it starts [m].
    """

    kind: Literal["carried"] = "carried"
    by: Literal["car", "omni"] = "car"
    route: AnyRoute
    # 3 m/s is the largest speed limit that a car may have (`CarLimits`).
    speed_mps: Annotated[PositiveSpeed, Narrower(le=3)] = 0.5
    from_m: Length = 0.0
    by_itself: ClassVar[bool] = False

    @property
    def carrier(self) -> Carried:
        """Itself: the vehicle, its route and its speed."""
        return self

    def start(self, pose: Array) -> Array:
        """On the vehicle, at its start on the route."""
        return pose_on_ground(self.route.at(self.from_m)[:3]) @ pose


@spec
class Held(MotionBase):
    """The robot's gripper holds the target, and the camera stands in the room (eye to hand).

    `target.pose` is then where the target sits in the flange's frame, `camera.mount` where the camera stands in the world.
    """

    kind: Literal["held"] = "held"
    by_itself: ClassVar[bool] = False
    on_gripper: ClassVar[bool] = True

    def start(self, pose: Array) -> Array:
        """The pose in the flange's frame; its place in the world depends on the robot (`sim.scene.start_pose`)."""
        return pose


MOTIONS = OneOf("motion", *OWN_MOTIONS, Carried, Held, default="still")
