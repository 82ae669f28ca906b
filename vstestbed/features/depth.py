"""Where the depth of a marker comes from."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from annotated_types import Gt

from vstestbed.core.spec import OneOf, spec


class DepthSource:
    """What a source of depth says of itself.

    Attributes:
        with_pose: depths come from the target's pose, which is solved from the pixels.
        on_floor: the robot's place on the floor is solved, not a free pose. true: the simulator's truth.
    """

    kind: Any  # the word in a scenario: a field of each
    with_pose: ClassVar[bool] = False
    on_floor: ClassVar[bool] = False
    true: ClassVar[bool] = False


@spec
class PnP(DepthSource):
    """Depth from the target's pose, solved from its known points and the measured pixels (perspective-n-point)."""

    kind: Literal["pnp"] = "pnp"
    with_pose: ClassVar[bool] = True


@spec
class Constant(DepthSource):
    """One fixed depth for all markers [m]."""

    kind: Literal["constant"] = "constant"
    depth_m: Annotated[float, Gt(0)] = 1.0


@spec
class AtGoal(DepthSource):
    """Each marker's depth in the goal view."""

    kind: Literal["goal"] = "goal"


@spec
class Estimate(DepthSource):
    """Each marker's inverse range by recursive least squares on the flow of its ray under the camera's own motion.

    The motion is what the robot measures of itself: an arm's encoders; the ideal camera moves as commanded. (The commanded
    twist of an arm would not do: its servos lag, and the first frame's command has not moved anything yet.)

    Args:
        initial_m: depth assumed until the camera has moved enough to tell [m].
        forget_s: time constant with which old frames lose their weight [s].
    """

    kind: Literal["estimate"] = "estimate"
    initial_m: Annotated[float, Gt(0)] = 1.0
    forget_s: Annotated[float, Gt(0)] = 0.5


@spec
class OracleDepth(DepthSource):
    """The simulator's true depth; only with `detector: {kind: oracle}`."""

    kind: Literal["oracle"] = "oracle"
    true: ClassVar[bool] = True


@spec
class OnFloor(DepthSource):
    """For a vehicle: depth from its place on the floor, solved from two or more landmarks of known height.

    The mount is known, the vehicle stands upright: three unknowns, where `pnp` has six and needs three markers. A vehicle
    that pitches on its suspension is off by as much. Of a single landmark the heading stays as it was.
    """

    kind: Literal["floor"] = "floor"
    with_pose: ClassVar[bool] = True
    on_floor: ClassVar[bool] = True


DEPTHS = OneOf("depth", PnP, Constant, AtGoal, Estimate, OnFloor, OracleDepth)
Depth = Annotated[DepthSource, DEPTHS]
