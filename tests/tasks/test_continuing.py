"""Tasks without an end: kept within a tolerance once settled, at their speeds, until the time is
out.
"""

from dataclasses import replace

import numpy as np
import pytest

import vstestbed as vs
from tests.tasks.frames import first_verdict, frame, times
from vstestbed.core.geometry import inverse
from vstestbed.core.outcome import Outcome
from vstestbed.core.planar import pose_on_ground
from vstestbed.endings import Termination
from vstestbed.robots.base import Supervisor
from vstestbed.robots.flight import Failsafe
from vstestbed.tasks.continuing import ToleranceMonitor
from vstestbed.tasks.stop import Stop

CAR = vs.load(
    "car_line",
    {
        "target.route": {"kind": "straight", "length_m": 40},
        "goal.offset_m": 0.0,
        "goal.band_m": 0.1,
        "goal.settle_s": 4,
    },
)
STOP = Stop(duration_s=10)


def ended(speed, off, stop=STOP):
    """The verdict on a drive along a straight line at a speed [m/s], so far off the line at a time
    [m], and when it fell.
    """
    setup, supervisor = replace(CAR.setup, stop=stop), Supervisor()
    monitor = CAR.goal.monitor(setup, supervisor)
    assert isinstance(monitor, ToleranceMonitor)
    start, mount = CAR.target.route.at(1.0 if speed >= 0 else 20.0), CAR.camera.mount.T
    ahead, left = (
        np.array([np.cos(start[2]), np.sin(start[2]), 0]),
        np.array([-np.sin(start[2]), np.cos(start[2]), 0]),
    )
    line = CAR.target.T_world_start

    def at(t):
        place = np.array([start[0], start[1], start[2]]) + speed * t * ahead + off(t) * left
        return frame(t, T_world_camera=line @ pose_on_ground(place) @ mount, T_world_target=line)

    return first_verdict(
        monitor,
        Termination(monitor, setup, supervisor),
        (at(t) for t in times(stop.duration_s)),
    )


def test_kept_at_its_speed_it_is_completed():
    verdict, t = ended(0.8, lambda t: 0.05)
    assert verdict == (Outcome.completed, "within 0.1 m from 4 s on") and t == pytest.approx(10.0)


def test_before_it_has_settled_it_may_be_anywhere():
    assert ended(0.8, lambda t: 0.3 if t < 3.99 else -0.05)[0][0] is Outcome.completed


@pytest.mark.parametrize("speed", [0.0, 0.3, -0.8])
def test_within_the_band_and_too_slow_or_backwards_it_is_not(speed):
    (outcome, reason), _ = ended(speed, lambda t: 0.05)
    assert outcome is Outcome.timed_out
    commanded = CAR.law.cruise_mps
    assert (
        f"the vehicle, along its line, made {speed:.2f} m/s in the 2 s before 4 s;"
        f" {commanded:g} m/s were commanded" in reason
    )


def test_the_reason_is_what_came_first():
    assert ended(0.8, lambda t: 0.2)[0] == (
        Outcome.timed_out,
        "out of its band of 0.1 m at 4 s, 0.2 m off",
    )
    assert "made 0.30 m/s" in ended(0.3, lambda t: 0.2 if t > 6 else 0.05)[0][1]


def test_a_time_that_ends_before_it_may_settle_shows_nothing():
    (outcome, reason), t = ended(0.8, lambda t: 0.0, Stop(duration_s=3))
    assert (
        outcome is Outcome.timed_out
        and reason == "3 s ended before the 4 s in which it may settle"
        and t == pytest.approx(3.0)
    )


def test_a_craft_that_left_its_path_while_it_had_given_up_did_not_keep_it():
    """Blind for two seconds it sinks; it sees its target again, climbs back and flies on as if
    nothing had been.
    """
    scenario = vs.load("quadrotor_path", {"goal.settle_s": 1.0})
    stop, failsafe = (
        Stop(duration_s=scenario.goal.end_s + 1),
        Failsafe(lands=False, lost_after_s=1.0),
    )
    setup = replace(scenario.setup, stop=stop)
    monitor = scenario.goal.monitor(setup, failsafe)
    ends = Termination(monitor, setup, failsafe)

    def at(t, off_m):
        T = scenario.target.T_world_start @ inverse(scenario.goal.at(t)[0])
        T[2, 3] -= off_m
        return frame(t, T_world_camera=T, T_world_target=scenario.target.T_world_start)

    for t in times(stop.duration_s):
        blind = 3.0 <= t < 5.0
        failsafe.aborted = (Outcome.target_lost, "nothing in sight") if blind else None
        verdict = first_verdict(monitor, ends, [at(t, 1.0 if blind else 0.0)])
        if verdict:
            break
    (outcome, reason), ended_s = verdict
    assert ended_s == pytest.approx(stop.duration_s, abs=0.041)
    assert outcome is Outcome.timed_out and reason.startswith("out of its band of 0.15 m at 3 s")


def test_an_error_that_is_no_number_is_out_of_the_band():
    (outcome, reason), _ = ended(0.8, lambda t: np.nan if 5 < t < 5.5 else 0.0)
    assert outcome is Outcome.timed_out and "out of its band" in reason


def test_its_error_stands_in_the_log():
    setup = CAR.setup
    monitor = CAR.goal.monitor(setup, Supervisor())
    assert monitor.columns == ("task_error_m",)
    x, y, heading = CAR.target.route.at(5.0)[:3]
    place = np.array([x - 0.07 * np.sin(heading), y + 0.07 * np.cos(heading), heading])
    line = CAR.target.T_world_start
    seen = frame(
        T_world_camera=line @ pose_on_ground(place) @ CAR.camera.mount.T, T_world_target=line
    )
    assert monitor.measure(seen) == (pytest.approx(0.07),)


def test_a_way_that_ends_later_than_the_time_is_not_completed():
    scenario = vs.load("quadrotor_path", {"goal.settle_s": 0.0})
    end = scenario.goal.end_s
    for duration, outcome in ((end - 0.5, Outcome.timed_out), (end + 0.5, Outcome.completed)):
        setup = replace(scenario.setup, stop=Stop(duration_s=duration))
        monitor = scenario.goal.monitor(setup, Supervisor())
        last = frame(duration)
        monitor._error_m = 0.0  # on its path, all the time
        found, reason = monitor.missed(last)
        assert found is outcome
        assert (
            outcome is Outcome.completed
            or f"ended on the way: its end is reached at {end:.3g} s" in reason
        )


@pytest.mark.parametrize("name", ["car_pbvs", "arm_ibvs", "quadrotor_land"])
def test_a_task_with_an_end_has_no_tolerance(name):
    goal = vs.load(name).goal
    assert not goal.continuing and goal.tolerance_m is None and goal.settle_s == 0.0
    assert goal.metrics({}) == {}


def test_its_worst_error_is_from_the_time_to_settle_on():
    goal = CAR.goal
    log = {"t": np.array([0.0, 3.9, 4.0, 5.0]), "task_error_m": np.array([9.0, 5.0, -0.25, 0.1])}
    assert goal.metrics(log) == {"worst_task_error_m": 0.25}
    assert goal.metrics({name: column[:2] for name, column in log.items()}) == {
        "worst_task_error_m": None
    }
