"""Where the depth of a marker comes from."""

from __future__ import annotations

from typing import Annotated, Literal

from annotated_types import Gt

from vstestbed.core.spec import OneOf, spec


@spec
class PnP:
    """Depth from the target's pose, solved from its known points and the measured pixels (perspective-n-point)."""

    kind: Literal["pnp"] = "pnp"


@spec
class Constant:
    """One fixed depth for all markers [m]."""

    kind: Literal["constant"] = "constant"
    depth_m: Annotated[float, Gt(0)] = 1.0


@spec
class AtGoal:
    """Each marker's depth in the goal view."""

    kind: Literal["goal"] = "goal"


@spec
class Estimate:
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
class OracleDepth:
    """The simulator's true depth; only with `detector: {kind: oracle}`."""

    kind: Literal["oracle"] = "oracle"


@spec
class OnFloor:
    """For a vehicle: depth from its place on the floor, solved from two or more landmarks of known height.

    The mount is known, the vehicle stands upright: three unknowns, where `pnp` has six and needs three markers. A vehicle
    that pitches on its suspension is off by as much. Of a single landmark the heading stays as it was.
    """

    kind: Literal["floor"] = "floor"


DEPTHS = OneOf("depth", PnP, Constant, AtGoal, Estimate, OnFloor, OracleDepth)
Depth = Annotated[PnP | Constant | AtGoal | Estimate | OnFloor | OracleDepth, DEPTHS]
