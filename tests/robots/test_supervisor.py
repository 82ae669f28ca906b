"""The supervisor of robots that are safe at rest: how long a law without measurements is followed,
and what ends its task.
"""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.core.outcome import Outcome
from vstestbed.robots.allocation import Order
from vstestbed.robots.base import FOLLOWS, HOLDS, STANDS_RADPS, STOPS, Reading, Supervisor

BASIS, AT_REST = np.eye(6)[:, :2], Reading(np.zeros(2), np.zeros(2))
ORDER = Order(np.array([0.5, 0.1]), BASIS @ [0.5, 0.1])
BLIND = "too few markers in sight"


def frames(
    supervisor: Supervisor,
    until: float,
    since: float = 0.0,
    blind: str = BLIND,
    moved_m: float = 0.0,
) -> float | None:
    """The time of the frame, at 25 Hz, at which the task is aborted [s]; None where it is not."""
    for k in range(round((until - since) / 0.04) + 1):
        supervisor.filter(since + 0.04 * k, blind, AT_REST, ORDER, BASIS, moved_m)
        if supervisor.aborted:
            return since + 0.04 * k
    return None


def test_with_sight_the_law_is_followed_for_ever():
    supervisor = Supervisor(1.0, 1.0)
    assert frames(supervisor, 5.0, blind="", moved_m=0.3) is None
    assert supervisor.filter(9.0, "", AT_REST, ORDER, BASIS) is ORDER
    assert supervisor.mode == FOLLOWS and supervisor.may_touch and not supervisor.down(9.0)


def test_without_sight_it_is_followed_for_a_while():
    supervisor = Supervisor(1.0)
    assert supervisor.filter(0.0, BLIND, AT_REST, ORDER, BASIS) is ORDER
    assert supervisor.mode == HOLDS and supervisor.aborted is None


def test_out_of_sight_for_too_long_it_stops():
    supervisor = Supervisor(1.0)
    assert frames(supervisor, 2.0) == pytest.approx(1.0)
    assert supervisor.aborted == (
        Outcome.target_lost,
        "too few markers in sight for 1 s, from the start on",
    )
    for t, blind in ((1.1, BLIND), (1.2, "")):  # for good, also when it sees again
        order = supervisor.filter(t, blind, AT_REST, ORDER, BASIS)
        assert (
            order.stopped and order.latched and not order.setpoint.any() and not order.twist.any()
        )
        assert (
            order.reason == "too few markers in sight for 1 s, from the start on"
            and supervisor.mode == STOPS
        )


def test_a_target_that_was_seen_is_not_called_never_seen():
    supervisor = Supervisor(1.0)
    frames(supervisor, 0.0, blind="")
    frames(supervisor, 2.0, since=0.04)
    assert supervisor.aborted == (Outcome.target_lost, "too few markers in sight for 1 s")


def test_seen_in_between_it_waits_anew():
    supervisor = Supervisor(1.0, 1.0)
    assert frames(supervisor, 0.96, moved_m=0.03) is None
    assert frames(supervisor, 1.0, since=1.0, blind="") is None
    assert frames(supervisor, 3.0, since=1.04, moved_m=0.03) == pytest.approx(2.04)


def test_too_far_without_sight_it_stops():
    supervisor = Supervisor(100.0, 1.0)
    # eight times .125 m after the first blind frame
    assert frames(supervisor, 2.0, moved_m=0.125) == pytest.approx(0.32)
    assert supervisor.aborted == (
        Outcome.target_lost,
        "too few markers in sight for 1 m of the way, from the start on",
    )


def test_it_is_down_once_its_joints_stand():
    supervisor = Supervisor(0.0)
    for speed, stands in (
        (2 * STANDS_RADPS, False),
        (-2 * STANDS_RADPS, False),
        (0.5 * STANDS_RADPS, True),
    ):
        supervisor.filter(0.0, BLIND, Reading(np.zeros(2), np.array([0.0, speed])), ORDER, BASIS)
        assert supervisor.down(0.0) is stands
    no_joints = Supervisor(0.0)
    no_joints.filter(0.0, BLIND, Reading(np.zeros(0), np.zeros(0)), ORDER, BASIS)
    assert no_joints.down(0.0)


def test_a_first_reason_stays():
    supervisor = Supervisor(1.0)
    supervisor.abort(0.5, Outcome.law_failed, "law mine raised ValueError")
    frames(supervisor, 3.0)
    assert supervisor.aborted == (Outcome.law_failed, "law mine raised ValueError")
