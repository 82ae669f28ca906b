"""A communication link that loses pictures and commands in bursts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt

from vstestbed.core.spec import spec


@spec
class BurstLoss:
    """A link whose losses come in bursts: a Markov chain of a good and a bad state, with a probability of loss in each.

    The chain takes one step a camera period, with p = `enter_probability` from good to bad and r = `leave_probability` back; it begins in
    its steady state. Pictures and commands have a chain each, since interference is that at the receiver. In the mean

        share of the time in the bad state   p / (p + r)
        length of a bad stretch              1 / r  periods, geometric
        share lost                           (r good_loss + p bad_loss) / (p + r)

    A command that is lost does not reach the robot, which keeps the last one until it ends (`timing.command_timeout_s`); the controller
    does not know of it. The log has such commands in the column `command_lost`.

    References: Gilbert 1960, doi:10.1002/j.1538-7305.1960.tb03959.x (no loss in the good state); Elliott 1963,
    doi:10.1002/j.1538-7305.1963.tb00955.x (loss in both). The defaults are chosen: 9 % lost, in bursts of 0.2 s at 25 Hz.

    Args:
        enter_probability: of the step from the good to the bad state, p [1].
        leave_probability: of the step back, r [1]; small for long bursts.
        good_loss: probability of a loss in the good state [1]; e.g. `0.01`.
        bad_loss: probability of a loss in the bad state [1].
        carries: what goes over the link.
    """

    enter_probability: Annotated[float, Ge(0), Le(1)] = 0.02
    leave_probability: Annotated[float, Gt(0), Le(1)] = 0.2
    good_loss: Annotated[float, Ge(0), Lt(1)] = 0.0
    bad_loss: Annotated[float, Ge(0), Le(1)] = 1.0
    carries: Literal["pictures", "commands", "both"] = "both"

    @property
    def draws(self) -> bool:
        """Whether anything is lost."""
        return self.good_loss > 0 or (self.enter_probability > 0 and self.bad_loss > 0)


Loses = Callable[[int], bool]  # whether what is sent in a camera period is lost; periods count from 0, and never go back


def bursty_link(loss: BurstLoss, rng: np.random.Generator) -> Loses:
    """One direction of the link in a run. loss: its parameters. rng: of this direction alone."""
    steps, losses = rng.spawn(2)
    p, r = loss.enter_probability, loss.leave_probability
    bad, now = bool(steps.random() < p / (p + r)), 0

    def loses(period: int) -> bool:
        nonlocal bad, now
        while now < period:
            bad ^= bool(steps.random() < (r if bad else p))
            now += 1
        return bool(losses.random() < (loss.bad_loss if bad else loss.good_loss))

    return loses


def directions(loss: BurstLoss | None, rng: np.random.Generator) -> tuple[Loses | None, Loses | None]:
    """The link for pictures and that for commands; None where nothing is lost. rng: of the link alone."""
    if loss is None:
        return None, None
    pictures, commands = (bursty_link(loss, stream) for stream in rng.spawn(2))
    return pictures if loss.carries != "commands" else None, commands if loss.carries != "pictures" else None
