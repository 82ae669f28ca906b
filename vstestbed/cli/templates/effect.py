"""The effect my_effect of a robot: what it changes in the model, what it does while the run lasts,
what it writes into the log.

    pytest my_effect.py
    vstestbed run arm_ibvs --plugin my_effect.py --set "robot.effects=[my_effect]"

It is oil that is churned in the gears.
"""

from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Le

import vstestbed as vs
import vstestbed.testing


@vs.EFFECTS.add
@vs.spec
class MyEffect(vs.EffectBase):
    """A torque tau = -drag_nms2 |w| w against the speed w of each joint.

    Args:
        drag_nms2: c [Nm s^2].
    """

    kind: Literal["my_effect"] = "my_effect"  # its word in a scenario
    drag_nms2: Annotated[float, Ge(0), Le(1e3)] = 1.0
    columns: ClassVar[tuple[str, ...]] = ("my_effect_w",)  # of the log

    def check(self, joints):
        """Refuse what does not fit the robot."""
        if not joints:
            raise vs.errors.ParameterError("kind", "is for a robot with joints")

    def actor(self, body, rng):
        """What it does in one run; `body.motor_torque()` has the motors' torques, `edit` changes
        the model before it is compiled.
        """
        return Churning(self, body)


class Churning(vs.effects.Actor):
    """The torques of one run."""

    def __init__(self, effect, body):
        # the motors' side of elastic joints
        self.effect, self.data, self.at = effect, body.data, body.at.motor_qvel
        self.force = np.zeros(body.model.nv)  # the plant adds it to those of other effects

    def act(self, t, dt):
        """Set the force for the coming physics step."""
        w = self.data.qvel[self.at]
        self.force[self.at] = -self.effect.drag_nms2 * np.abs(w) * w

    def row(self):
        """A value for each of `columns`: the power that the torques take [W]."""
        return (float(self.force[self.at] @ self.data.qvel[self.at]),)


def test_my_effect():
    """It stands in the log, acts, and two runs of it are alike."""
    vstestbed.testing.check_effect(MyEffect())
