"""What is done when the law cannot: held, sunk, rotors off, and why."""

import numpy as np
from vstestbed.loop.failsafe import FOLLOWS, HOLD_S, HOLDS, OFF, SINKS, Pilot

from vstestbed.core.outcome import Outcome
from vstestbed.loop.judge import Evidence, Judge
from vstestbed.robots.quadrotor import HOLD, ROTORS_OFF, descend
from vstestbed.tasks.stop import Stop

PLAIN = {"overturned": 0.0, "rotor_limit_s": 0.0, "stands": 0.0, "range": 3.0}
ORDER = np.array([0.5, 0.1, -0.2, 0.3])


def told(**given: float) -> dict[str, np.ndarray]:
    """The craft's instruments."""
    return {name: np.array([given.get(name, default)]) for name, default in PLAIN.items()}


def flown(pilot: Pilot, until: float, since: float = 0.0, lost: str = "", **given: float) -> np.ndarray:
    """The last order of a stretch of frames at 25 Hz."""
    order = ORDER
    for t in np.arange(since, until, 0.04):
        order = pilot.order(float(t), lost, told(**given), np.zeros(4) if lost else ORDER)
    return order


def test_it_follows_the_law():
    pilot = Pilot(lands=False, lost_after_s=1.0)
    np.testing.assert_array_equal(flown(pilot, 5.0), ORDER)
    assert pilot.mode == FOLLOWS and pilot.aborted is None


def test_lost_it_holds_then_sinks_then_stands():
    pilot = Pilot(lands=False, lost_after_s=1.0)
    np.testing.assert_array_equal(flown(pilot, 0.9, lost="nothing in sight"), HOLD)
    assert pilot.mode == HOLDS and not pilot.may_touch
    np.testing.assert_array_equal(flown(pilot, 3.0, 0.9, lost="nothing in sight"), descend(0.4))
    assert pilot.mode == SINKS and pilot.may_touch
    assert pilot.aborted is not None and pilot.aborted[0] is Outcome.target_lost
    np.testing.assert_array_equal(flown(pilot, 4.0, 3.0, lost="nothing in sight", stands=1.0), ROTORS_OFF)
    assert pilot.mode == OFF and pilot.down(4.0)


def test_seen_again_it_follows_again():
    pilot = Pilot(lands=False, lost_after_s=1.0)
    flown(pilot, 2.0, lost="nothing in sight")
    np.testing.assert_array_equal(flown(pilot, 2.1, 2.0), ORDER)
    assert pilot.aborted is None and pilot.mode == FOLLOWS


def test_seen_again_when_low_it_sets_down_all_the_same():
    pilot = Pilot(lands=False, lost_after_s=1.0)
    flown(pilot, 2.0, lost="nothing in sight")
    np.testing.assert_array_equal(flown(pilot, 2.1, 2.0, range=0.3), descend(0.4))


def test_overturned_it_gives_up_whatever_it_sees():
    pilot = Pilot(lands=False, lost_after_s=1.0)
    np.testing.assert_array_equal(flown(pilot, 0.1, overturned=1.0), HOLD)
    np.testing.assert_array_equal(flown(pilot, HOLD_S + 1.0, 0.1), descend(0.4))
    assert pilot.aborted is not None and pilot.aborted[0] is Outcome.overturned


def test_a_rotor_at_its_limit_for_too_long():
    pilot = Pilot(lands=False, lost_after_s=1.0)
    flown(pilot, 0.1, rotor_limit_s=0.9)
    assert pilot.aborted is None
    flown(pilot, 0.2, 0.1, rotor_limit_s=1.1)
    assert pilot.aborted is not None and pilot.aborted[0] is Outcome.rotor_limit


def test_only_a_landing_ends_with_rotors_off_in_sight_of_its_target():
    np.testing.assert_array_equal(flown(Pilot(lands=True, lost_after_s=1.0), 1.0, stands=1.0), ROTORS_OFF)
    np.testing.assert_array_equal(flown(Pilot(lands=False, lost_after_s=1.0), 1.0, stands=1.0), ORDER)


def evidence(**given: object) -> Evidence:
    """A frame in which all is well, but for what is given."""
    plain = {"t": 5.0, "lost": False, "held": "", "all_seen": True, "error_px": 9.0, "command_size": 1.0, "scale": 1.0, "limit": ""}
    return Evidence(**(plain | {"distance": 3.0, "behind": False, "contact": False, "flies": True} | given))


def test_the_judge_waits_until_the_craft_is_down():
    judge, why = Judge(Stop()), (Outcome.overturned, "tilted")
    assert judge.verdict(evidence(aborted=why)) is None
    verdict = judge.verdict(evidence(aborted=why, down=True))
    assert verdict is not None and verdict[0] is Outcome.overturned and "set down" in verdict[1]
    late = judge.verdict(evidence(aborted=why, t=30.0))
    assert late is not None and late[0] is Outcome.overturned and "on its way down" in late[1]
    touched = judge.verdict(evidence(aborted=why, contact=True))
    assert touched is not None and touched[0] is Outcome.collided and "tilted" in touched[1]
