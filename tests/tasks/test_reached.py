"""Tasks with an end: reached when the scenario's conditions hold for long enough, missed in a local
minimum or when time is out.
"""

from dataclasses import replace

import numpy as np
import pytest

import vstestbed as vs
from tests.tasks.frames import GOAL, frame, observed, times
from vstestbed.core.geometry import Pose
from vstestbed.core.outcome import Outcome
from vstestbed.robots.base import Supervisor
from vstestbed.tasks.monitor import REST, TaskMonitor
from vstestbed.tasks.stop import Converged, Stop

SETUP = vs.load("arm_ibvs").setup
STOP = Stop(duration_s=10, converged=Converged(error_px=0.2, hold_s=0.5))


def monitor_of(stop=STOP, views=1):
    return TaskMonitor(replace(SETUP, stop=stop), views, Supervisor())


def first(monitor, frames, ask):
    """What a monitor says first, (verdict, time [s]); `ask`: `reached` or `missed`. None where it
    says nothing.
    """
    for each in frames:
        monitor.measure(each)
        said = {"reached": monitor.reached(each), "missed": monitor.missed(each)}
        if said[ask]:
            return said[ask], each.t
    return None


def test_reached_when_the_error_has_been_small_for_long_enough():
    verdict, t = first(monitor_of(), (frame(t, rms_px=0.1) for t in times(2.0)), "reached")
    assert verdict == (Outcome.converged, "RMS error under 0.2 px for 0.5 s")
    assert t == pytest.approx(0.52, abs=0.021)


@pytest.mark.parametrize(
    "given", [{"rms_px": 0.2}, {"rms_px": 0.1, "all_seen": False}, {"lost": True}]
)
def test_not_with_a_larger_error_nor_with_a_marker_out_of_sight(given):
    assert first(monitor_of(), (frame(t, **given) for t in times(3.0)), "reached") is None


def test_a_moment_outside_starts_the_hold_anew():
    frames = [frame(t, rms_px=0.3 if t == 0.4 else 0.1) for t in np.round(times(2.0), 9)]
    assert first(monitor_of(), frames, "reached")[1] == pytest.approx(0.96, abs=0.021)


def test_of_several_views_only_the_last_is_the_goal():
    monitor = monitor_of(views=2)
    assert first(monitor, (frame(t, rms_px=0.1) for t in times(2.0)), "reached") is None
    last = replace(GOAL, view=1)
    assert (
        first(monitor, (frame(t, rms_px=0.1, goal=last) for t in times(2.0)), "reached") is not None
    )


def test_near_by_the_robots_own_estimate():
    monitor = monitor_of(Stop(converged=Converged(position_m=0.05, rotation_deg=4, hold_s=0.0)))
    for xyz, turn, near in (
        ((0, 0, 1.04), 0, True),
        ((0, 0, 1.06), 0, False),
        ((0, 0, 1), 3.9, True),
        ((0, 0, 1), 4.1, False),
    ):
        each = frame(seen=observed(Pose(xyz=xyz, rpy_deg=(0, 0, turn)).T), rms_px=50.0)
        monitor.measure(each)
        assert (monitor.reached(each) is not None) is near
    monitor.measure(frame(seen=replace(observed(GOAL.T_camera_target), T_camera_target=None)))
    assert monitor.reached(frame()) is None  # not known, not near


AWAY = observed(GOAL.T_camera_target @ Pose(xyz=(0.01, 0, 0), rpy_deg=(0, 0, np.degrees(0.16))).T)
"""1 cm and 0.16 rad (9.17 deg) away from the goal."""


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        (Converged(error_px=0.2), "the commanded twist is zero at an RMS error of 5 px"),
        (
            Converged(position_m=0.05, rotation_deg=4),
            "zero 0.01 m and 9.17 deg from the goal by the robot's own estimate",
        ),
        (
            Converged(error_px=0.2, position_m=0.005),
            "RMS error of 5 px, 0.01 m and 9.17 deg from the goal by the robot's own estimate",
        ),
    ],
)
def test_rest_away_from_the_goal_is_told_in_what_is_measured(goal, words):
    (outcome, reason), t = first(
        monitor_of(Stop(converged=goal)),
        (frame(t, speed_mps=0.0, seen=AWAY) for t in times(2.4)),
        "missed",
    )
    assert outcome is Outcome.local_minimum and words in reason
    assert t == pytest.approx(2.0, abs=0.041)


@pytest.mark.parametrize(
    "given",
    [{"speed_mps": 2 * REST}, {"speed_mps": 0.0, "rms_px": 0.1}, {"speed_mps": 0.0, "lost": True}],
)
def test_rest_at_the_goal_or_for_want_of_markers_is_no_local_minimum(given):
    assert first(monitor_of(), (frame(t, **given) for t in times(4.0)), "missed") is None


@pytest.mark.parametrize(
    ("rest_after_s", "said"),
    [(0.5, (Outcome.local_minimum, 0.52)), (None, (Outcome.timed_out, 10.0))],
)
def test_how_long_a_rest_must_last(rest_after_s, said):
    monitor = monitor_of(replace(STOP, rest_after_s=rest_after_s))
    (outcome, _), t = first(monitor, (frame(t, speed_mps=0.0) for t in times(11.0)), "missed")
    assert (outcome, t) == (said[0], pytest.approx(said[1], abs=0.021))


def test_missed_when_time_is_out():
    assert first(monitor_of(), (frame(t) for t in times(11.0)), "missed") == (
        (Outcome.timed_out, "10 s were not enough"),
        10.0,
    )
