"""An effect of one's own: a cable from a hook in the room to the flange, which pulls at the wrist
when it is taut.

    vstestbed run arm_ibvs --plugin cable.py --set "robot.effects=[{kind: cable}]"

The effect is one class: `edit` changes the robot's model when the scene is composed, `actor` is
what it does while the run lasts, and `columns` is what the log has of it.
"""

from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Gt, Le, Len

import vstestbed as vs
from vstestbed.effects import Actor, RobotBody, RobotModel

Positive = Annotated[float, Gt(0), Le(1e5)]


@vs.EFFECTS.add
@vs.spec
class Cable(vs.EffectBase):
    """A cable of a length between a hook and the flange: F = stiffness_npm (|flange - hook| -
    length_m) along it where that is positive.

    Args:
        hook_m: the hook in the robot's base frame [m].
        length_m: of the cable [m].
        stiffness_npm: of the cable [N/m].
    """

    kind: Literal["cable"] = "cable"
    hook_m: Annotated[tuple[float, ...], Len(3, 3)] = (0.0, 0.0, 1.5)
    length_m: Positive = 1.0
    stiffness_npm: Positive = 500.0
    columns: ClassVar[tuple[str, ...]] = ("cable_n",)

    def edit(self, robot: RobotModel) -> None:
        """MuJoCo's own spring between two sites."""
        robot.spec.worldbody.add_site(name="cable_hook", pos=self.hook_m, group=4)
        robot.flange.add_site(name="cable_end", pos=robot.T_body_flange[:3, 3], group=4)
        cable = robot.spec.add_tendon(
            name="cable", springlength=[0.0, self.length_m], rgba=[0.0, 0.0, 0.0, 0.0]
        )
        cable.stiffness[0] = self.stiffness_npm
        cable.wrap_site("cable_hook")
        cable.wrap_site("cable_end")

    def actor(self, body: RobotBody, rng: np.random.Generator) -> Actor:
        """It only reports: the spring acts by itself."""
        return Tension(self, body)


class Tension(Actor):
    """The column `cable_n`: the tension of the cable [N]."""

    def __init__(self, cable: Cable, body: RobotBody):
        self._cable, self._length, self._i = (
            cable,
            body.data.ten_length,
            body.model.tendon("robot/cable").id,
        )

    def row(self) -> Sequence[Any]:
        """Of the present instant."""
        return (self._cable.stiffness_npm * max(0.0, self._length[self._i] - self._cable.length_m),)
