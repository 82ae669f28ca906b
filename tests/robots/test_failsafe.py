"""What is done when the law cannot: held, sunk, rotors off, and why."""

import numpy as np

from vstestbed.core.outcome import Outcome
from vstestbed.robots.allocation import Order
from vstestbed.robots.base import FOLLOWS, HOLDS
from vstestbed.robots.flight import (
    DOWN_S,
    HOLD,
    HOLD_S,
    OFF,
    SINKS,
    Failsafe,
    FlightEstimate,
    FlightReading,
    descend,
)

SETPOINT = np.array([0.5, 0.1, -0.2, 0.3])
BASIS = np.eye(6)[:, [0, 1, 2, 5]]
LAWS, AT_REST = Order(SETPOINT, BASIS @ SETPOINT), Order(HOLD, np.zeros(6))


def reading(
    range_m: float = 3.0, overturned: bool = False, rotor_limit_s: float = 0.0, stands: bool = False
) -> FlightReading:
    """What the craft measures and estimates: by default it hovers 3 m over the ground."""
    still, no_joints = np.zeros(3), np.zeros(0)
    estimate = FlightEstimate(still, still, np.zeros(2), still, rotor_limit_s, overturned, stands)
    return FlightReading(no_joints, no_joints, tilt=np.zeros(2), range_m=range_m, estimate=estimate)


def flown(
    failsafe: Failsafe, until: float, since: float = 0.0, lost: str = "", **given: float
) -> np.ndarray | str:
    """The last order of a stretch of frames at 25 Hz: its setpoint, which its twist agrees with, or
    how it stops the craft.
    """
    order = LAWS
    for t in np.arange(since, until, 0.04):
        order = failsafe.filter(
            float(t), lost, reading(**given), AT_REST.halted(lost) if lost else LAWS, BASIS
        )
        np.testing.assert_array_equal(order.twist, BASIS @ order.setpoint)
        assert (order is LAWS) is not bool(order.reason)
        assert order.setpoint.any() is not order.stopped
    return order.stop or order.setpoint


def test_it_follows_the_law():
    failsafe = Failsafe(lands=False, lost_after_s=1.0)
    np.testing.assert_array_equal(flown(failsafe, 5.0), SETPOINT)
    assert failsafe.mode == FOLLOWS and failsafe.aborted is None


def test_lost_it_holds_then_sinks_then_stands():
    failsafe = Failsafe(lands=False, lost_after_s=1.0)
    assert flown(failsafe, 0.9, lost="nothing in sight") == "stop"
    assert failsafe.mode == HOLDS and not failsafe.may_touch
    np.testing.assert_array_equal(flown(failsafe, 3.0, 0.9, lost="nothing in sight"), descend(0.4))
    assert failsafe.mode == SINKS and failsafe.may_touch
    assert failsafe.aborted is not None and failsafe.aborted[0] is Outcome.target_lost
    assert flown(failsafe, 4.0, 3.0, lost="nothing in sight", stands=True) == "off"
    assert failsafe.mode == OFF and failsafe.down(4.0)


def test_seen_again_it_follows_again():
    failsafe = Failsafe(lands=False, lost_after_s=1.0)
    flown(failsafe, 2.0, lost="nothing in sight")
    np.testing.assert_array_equal(flown(failsafe, 2.1, 2.0), SETPOINT)
    assert failsafe.aborted is None and failsafe.mode == FOLLOWS


def test_seen_again_when_low_it_sets_down_all_the_same():
    failsafe = Failsafe(lands=False, lost_after_s=1.0)
    flown(failsafe, 2.0, lost="nothing in sight")
    np.testing.assert_array_equal(flown(failsafe, 2.1, 2.0, range_m=0.3), descend(0.4))


def test_overturned_it_gives_up_whatever_it_sees():
    failsafe = Failsafe(lands=False, lost_after_s=1.0)
    assert flown(failsafe, 0.1, overturned=True) == "stop"
    np.testing.assert_array_equal(flown(failsafe, HOLD_S + 1.0, 0.1), descend(0.4))
    assert failsafe.aborted is not None and failsafe.aborted[0] is Outcome.overturned


def test_a_rotor_at_its_limit_for_too_long():
    failsafe = Failsafe(lands=False, lost_after_s=1.0)
    flown(failsafe, 0.1, rotor_limit_s=0.9)
    assert failsafe.aborted is None
    flown(failsafe, 0.2, 0.1, rotor_limit_s=1.1)
    assert failsafe.aborted is not None and failsafe.aborted[0] is Outcome.rotor_limit


def test_only_a_landing_ends_with_rotors_off_in_sight_of_its_target():
    assert flown(Failsafe(lands=True, lost_after_s=1.0), 1.0, stands=True) == "off"
    np.testing.assert_array_equal(
        flown(Failsafe(lands=False, lost_after_s=1.0), 1.0, stands=True), SETPOINT
    )


def test_down_is_half_a_second_with_rotors_off():
    failsafe = Failsafe(lands=True, lost_after_s=1.0)
    assert not failsafe.down(9.0)
    flown(failsafe, 1.0, stands=True)
    assert failsafe.off_at == 0.0 and not failsafe.down(DOWN_S - 0.01) and failsafe.down(DOWN_S)
    assert flown(failsafe, 2.0, 1.0) == "off"  # once off they stay off, whatever is seen


def test_the_reason_says_what_and_when():
    failsafe = Failsafe(lands=False, lost_after_s=1.0)
    flown(failsafe, 1.5, lost="nothing in sight")
    assert failsafe.aborted == (Outcome.target_lost, "nothing in sight for 1 s at 1.0 s")
    failsafe = Failsafe(lands=False, lost_after_s=1.0)
    flown(failsafe, 0.02, rotor_limit_s=1.1)
    assert failsafe.aborted == (Outcome.rotor_limit, "a rotor stood at its limit for 1 s at 0.0 s")


def test_a_law_that_failed_ends_the_task_for_good():
    failsafe = Failsafe(lands=False, lost_after_s=1.0)
    failsafe.abort(0.0, Outcome.law_failed, "law mine raised ValueError")
    assert flown(failsafe, HOLD_S - 0.1) == "stop"
    # although the target is in sight
    np.testing.assert_array_equal(flown(failsafe, HOLD_S + 1.0, HOLD_S), descend(0.4))
    assert failsafe.aborted == (Outcome.law_failed, "law mine raised ValueError at 0.0 s")


def test_too_far_without_sight_is_too_long():
    failsafe = Failsafe(lands=False, lost_after_s=100.0, lost_after_m=1.0)
    for k in range(6):
        order = failsafe.filter(0.04 * k, "coasting", reading(), LAWS, BASIS, moved_m=0.3)
        assert (order is LAWS) is (k < 4)  # .3 m after each but the first
    assert (
        failsafe.aborted is not None
        and failsafe.aborted[1] == "coasting for 1 m of the way at 0.2 s"
    )
