"""The reward of a learner: from the error by which the task is judged, and from its outcome."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

from vstestbed.core.errors import ParameterError
from vstestbed.tasks.judged import JudgedError

RewardKind = Literal["potential", "negative_error", "sparse"]
WORST = 1e4
"""An error of so many times its limit, or more, or unknown, is the worst (2000 px where .2 px are the goal)."""


def potential(error: JudgedError, view: int = 0, views: int = 1) -> float:
    """How near a task is to its goal, phi in [0, 1]: 1 at no error, 0 at the worst, or where the error is unknown (markers lost).

        nearness = 1 - ln(1 + |error| / limit) / ln(1 + WORST),  phi = (view + nearness) / views

    Logarithmic: to halve the error has the same worth at 100 px as at 1 px, and pixels, metres and radians are on one scale.

    Args:
        error: the judged error. view: number of the goal view that it belongs to. views: how many there are in turn.
    """
    ratio = WORST if math.isnan(error.value) else min(abs(error.value) / error.limit, WORST)
    return (view + 1.0 - math.log1p(ratio) / math.log1p(WORST)) / views


@dataclass(frozen=True)
class Reward:
    """What a step is worth.

    `potential`: discount phi' - phi, and `success_bonus` at a success. After the end (termination, not truncation) phi' is 0, so
    that the sum of the differences depends on the start alone, and the best policy is that of the bonus alone, at a learner's discount
    equal to this one.
    `negative_error`: phi' - 1 in [-1, 0] at every step, and the bonus. An end that is no success is charged with the worst error in
    all n steps that were left, -(discount + ... + discount^n): without this, to give up would cost less than to go to the goal.
    `sparse`: the bonus alone.

    Args:
        kind: which of them. discount: gamma, in (0, 1]. success_bonus: reward of a success.

    Raises:
        ParameterError: another kind, a discount out of its range, a bonus that is not finite.

    Reference: Ng, Harada & Russell 1999, "Policy invariance under reward transformations: theory and application to reward shaping",
    ICML, pp. 278-287; that phi must be 0 after the end: Grzes 2017, "Reward shaping in episodic reinforcement learning", AAMAS,
    pp. 565-573; that an end must be worth what an absorbing state in its place would be: Kostrikov, Agrawal, Dwibedi, Levine & Tompson
    2019, "Discriminator-actor-critic: addressing sample inefficiency and reward bias in adversarial imitation learning", ICLR.
    """

    kind: RewardKind = "potential"
    discount: float = 0.99
    success_bonus: float = 10.0

    def __post_init__(self) -> None:
        """Refuse what is no reward."""
        if self.kind not in get_args(RewardKind):
            raise ParameterError("reward", f"must be one of {', '.join(get_args(RewardKind))}", self.kind)
        if not 0 < self.discount <= 1:
            raise ParameterError("discount", "must be over 0 and at most 1", self.discount)
        if not math.isfinite(self.success_bonus):
            raise ParameterError("success_bonus", "must be finite", self.success_bonus)

    def of_step(self, before: float, after: float, terminated: bool, success: bool, left: int = 0) -> float:
        """The reward of a step between two potentials.

        Args:
            before, after: the potentials. terminated: the episode has ended, and not by the clock. success: the goal was reached.
            left: how many steps the episode would still have had.
        """
        bonus = self.success_bonus if success else 0.0
        if self.kind == "sparse":
            return bonus
        if self.kind == "negative_error":
            return after - 1.0 + bonus - (self._sum(left) if terminated and not success else 0.0)
        return (0.0 if terminated else self.discount * after) - before + bonus

    def _sum(self, n: int) -> float:
        """A reward of 1 in each of the next n steps: discount + ... + discount^n."""
        return float(n) if self.discount == 1 else self.discount * -math.expm1(n * math.log(self.discount)) / (1.0 - self.discount)
