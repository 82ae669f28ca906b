"""What a step of a run is worth to a learner: potentials by the judged error, and rewards by their differences."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.tasks.judged import JudgedError

RewardKind = Literal["potential", "negative_error", "sparse"]
WORST = 1e4  # an error of so many times its limit, or more, or unknown, is the worst (2000 px where .2 px are the goal)


def potential(error: JudgedError, view: int = 0, views: int = 1) -> float:
    """How near a task is to its goal, phi in [0, 1]: 1 at no error, 0 at the worst, or where the error is unknown (markers lost).

        nearness = 1 - ln(1 + |error| / limit) / ln(1 + WORST),  phi = (view + nearness) / views

    Logarithmic: to halve the error has the same worth at 100 px as at 1 px, and pixels, metres and radians are on one scale.
    """
    return float(view + nearness(error.value, error.limit)) / views


def nearness(error: Any, limit: float) -> Any:
    """1 at no error, 0 at the worst, or where it is unknown (NaN); errors may be an array."""
    ratio = np.fmin(np.abs(error) / limit, WORST)  # the other one of NaN and a number
    return 1.0 - np.log1p(ratio) / math.log1p(WORST)


@dataclass(frozen=True)
class Reward:
    """What a step is worth.

    `potential`: discount phi' - phi, and `success_bonus` at a success. After the end (termination, not truncation) phi' is 0, so
    that the sum of the differences depends on the start alone, and the best policy is that of the bonus alone, at a learner's discount
    equal to this one.
    `negative_error`: phi' - 1 in [-1, 0] at every step, and the bonus. An end that is no success is charged with the worst error in
    all n steps that were left, -(discount + ... + discount^n): without this, to give up would cost less than to go to the goal.
    `sparse`: the bonus alone.

    kind: which of them. discount: gamma, in (0, 1]. success_bonus: reward of a success.
    Raises ParameterError: another kind, a discount out of its range, a bonus that is not finite.

    Reference: Ng, Harada & Russell 1999, "Policy invariance under reward transformations: theory and application to reward shaping",
    ICML, pp. 278-287; that phi must be 0 after the end: Grzes 2017, "Reward shaping in episodic reinforcement learning", AAMAS,
    pp. 565-573; that an end must be worth what an absorbing state in its place would be: Kostrikov, Agrawal, Dwibedi, Levine & Tompson
    2019, "Discriminator-actor-critic: addressing sample inefficiency and reward bias in adversarial imitation learning", ICLR.
    """

    kind: RewardKind
    discount: float = 0.99
    success_bonus: float = 10.0

    def __post_init__(self) -> None:
        if self.kind not in get_args(RewardKind):
            raise ParameterError.choice("reward", get_args(RewardKind), self.kind)
        if not 0 < self.discount <= 1:
            raise ParameterError.bound("discount", "over", "0 and at most 1", self.discount)
        if not math.isfinite(self.success_bonus):
            raise ParameterError.infinite("success_bonus", self.success_bonus)

    def of_step(self, before: Any, after: Any, terminated: Any, success: Any, left: Any = 0) -> Any:
        """The reward of a step between two potentials; of many steps by arrays.
        terminated: the episode has ended, and not by the clock. left: how many steps the episode would still have had.
        """
        bonus = self.success_bonus * np.asarray(success)
        if self.kind == "sparse":
            return bonus
        if self.kind == "negative_error":
            g = self.discount  # the sum g + ... + g^left: a reward of 1 in each of the steps that are left
            lost = 1.0 * left if g == 1 else g * -np.expm1(left * math.log(g)) / (1.0 - g)
            return after - 1.0 + bonus - np.where(np.logical_and(terminated, np.logical_not(success)), lost, 0.0)
        return np.where(terminated, 0.0, self.discount * after) - before + bonus
