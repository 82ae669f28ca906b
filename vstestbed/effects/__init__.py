"""What a robot's body and drives really do: each imperfection whole, with its block, its physics
and its source.

An effect may change the robot's model when the scene is composed (`edit`), act while a run lasts
(`actor`), and have columns in the log (`columns`); `base` has the contract. Robots hold the blocks
as fields and list them in the order in which they act (`Robot.acting`).
"""

from vstestbed.effects.base import EFFECTS, Actor, Effect, EffectBase, RobotBody, RobotModel

__all__ = ["EFFECTS", "Actor", "Effect", "EffectBase", "RobotBody", "RobotModel"]
