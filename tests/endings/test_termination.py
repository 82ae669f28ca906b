"""Termination: each outcome from the frames that call for it, with the reason that a person reads;
which of several counts.
"""

from dataclasses import replace

import pytest

import vstestbed as vs
from tests.tasks.frames import back_from_target, first_verdict, frame, times
from vstestbed.core.outcome import Outcome
from vstestbed.endings import Termination
from vstestbed.robots.base import Supervisor
from vstestbed.robots.flight import OFF, SINKS, Failsafe
from vstestbed.tasks.monitor import TaskMonitor
from vstestbed.tasks.stop import Converged, Stop

STOP = Stop(duration_s=10, converged=Converged(error_px=0.2, hold_s=0.5), lost_after_s=1.0)
SETUP = vs.load("arm_ibvs").setup


def judged(seconds, supervisor=None, stop=STOP, **given):
    """The verdict (outcome, reason) on the same frame at 25 Hz for so long, and when it fell; None
    to go on.
    """
    supervisor = supervisor or Supervisor()
    setup = replace(SETUP, stop=stop)
    monitor = TaskMonitor(setup, 1, supervisor)
    ends = Termination(monitor, setup, supervisor)
    found = first_verdict(monitor, ends, (frame(t, **given) for t in times(seconds)))
    return None if found is None else (*found[0], found[1])


def test_a_run_under_way_goes_on():
    assert judged(9.9) is None


def test_the_goal_must_be_held():
    outcome, _, t = judged(5, rms_px=0.1)
    assert outcome is Outcome.converged
    assert t == pytest.approx(0.52, abs=0.021)  # hold_s at the next frame


def test_a_goal_with_a_marker_out_of_sight_is_not_reached():
    assert judged(9.9, rms_px=0.1, all_seen=False) is None


def test_each_end_has_its_evidence():
    for given, outcome, words in (
        ({"contact": "hub and floor"}, Outcome.collided, "contact of hub and floor"),
        ({"T_world_camera": back_from_target(201.0)}, Outcome.diverged, "200 m"),
        (
            {"T_world_camera": back_from_target(-0.1)},
            Outcome.target_lost,
            "starts behind the plane",
        ),
        ({"limit": "joint_limit", "scale": 0.0}, Outcome.joint_limit, "joint"),
        ({"limit": "singular", "scale": 0.01}, Outcome.singular, "singular"),
        ({"speed_mps": 0.0}, Outcome.local_minimum, "5 px"),
    ):
        found, reason, t = judged(9, **given)
        assert found is outcome
        assert words in reason
        assert t < 2.1  # nothing takes longer than the two seconds of rest


def test_time_runs_out():
    assert judged(10.1)[0] is Outcome.timed_out


class TestOrder:
    """Of several outcomes in one frame: given up by the supervisor, reached, the safety monitors in
    their order, missed.
    """

    AT_ONCE = Stop(duration_s=10, converged=Converged(error_px=0.2, hold_s=0.0), lost_after_s=0.0)
    LAST = Stop(duration_s=0.04)

    @pytest.mark.parametrize(
        ("stop", "given", "outcome"),
        [
            (
                AT_ONCE,
                {
                    "rms_px": 0.1,
                    "contact": "hub and floor",
                    "T_world_camera": back_from_target(201.0),
                },
                Outcome.converged,
            ),
            (
                AT_ONCE,
                {
                    "contact": "hub and floor",
                    "T_world_camera": back_from_target(201.0),
                    "lost": True,
                },
                Outcome.collided,
            ),
            (AT_ONCE, {"T_world_camera": back_from_target(-201.0), "lost": True}, Outcome.diverged),
            (
                AT_ONCE,
                {"T_world_camera": back_from_target(-0.1), "limit": "singular", "scale": 0.0},
                Outcome.target_lost,
            ),
            (LAST, {}, Outcome.timed_out),
        ],
    )
    def test_the_first_of_them_counts(self, stop, given, outcome):
        assert judged(0.04, stop=stop, **given)[0] is outcome


class TestARobotThatGaveUp:
    WHY = (Outcome.target_lost, "too few markers in sight for 1 s")

    def test_the_run_goes_on_until_it_stands(self):
        moving, standing = Supervisor(aborted=self.WHY), Supervisor(aborted=self.WHY, _stands=True)
        assert judged(9.9, supervisor=moving) is None
        assert judged(1.0, supervisor=standing) == (
            Outcome.target_lost,
            f"{self.WHY[1]}; the robot stands",
            0.0,
        )

    def test_out_of_sight_is_said_before_out_of_time(self):
        outcome, reason, t = judged(10.1, supervisor=Supervisor(aborted=self.WHY))
        assert outcome is Outcome.target_lost and t == pytest.approx(10.0)
        assert reason == f"{self.WHY[1]}; the robot was still moving when the time ran out"

    def test_without_pictures_it_decides_by_the_clock(self):
        supervisor = Supervisor()
        setup = replace(SETUP, stop=STOP)
        ends = Termination(TaskMonitor(setup, 1, supervisor), setup, supervisor)
        truth = frame().truth
        assert ends.without_picture(9.9, truth) is None
        assert ends.without_picture(10.0, truth) == (Outcome.timed_out, "10 s were not enough")
        assert (
            ends.without_picture(1.0, frame(contact="forearm and floor").truth)[0]
            is Outcome.collided
        )
        supervisor.aborted = self.WHY
        assert ends.without_picture(9.9, truth) is None
        supervisor._stands = True
        assert ends.without_picture(9.9, truth) == (
            Outcome.target_lost,
            f"{self.WHY[1]}; the robot stands",
        )


class TestACraftThatGaveUp:
    WHY = (Outcome.overturned, "tilted")

    def craft(self, **given) -> Failsafe:
        return Failsafe(lands=False, lost_after_s=1.0, aborted=self.WHY, **given)

    def test_the_run_goes_on_until_it_is_down(self):
        assert judged(9.9, supervisor=self.craft()) is None
        outcome, reason, t = judged(9.9, supervisor=self.craft(off_at=5.0, mode=OFF))
        assert outcome is Outcome.overturned and reason == "tilted; the craft set down"
        # half a second with its rotors off, at the next frame
        assert t == pytest.approx(5.52, abs=0.021)

    def test_not_beyond_the_end_of_the_time(self):
        outcome, reason, t = judged(10.1, supervisor=self.craft())
        assert (
            outcome is Outcome.overturned
            and "was still on its way down when the time ran out" in reason
        )
        assert t == pytest.approx(10.0)

    def test_a_touch_ends_it_at_once_with_both_reasons(self):
        outcome, reason, t = judged(1.0, supervisor=self.craft(), contact="hub and floor")
        assert outcome is Outcome.collided and reason == "contact of hub and floor, after tilted"
        assert t == 0.0

    def test_its_feet_may_touch_while_it_sinks_and_not_before(self):
        assert judged(1.0, supervisor=self.craft(), feet="left and floor")[0] is Outcome.collided
        assert judged(1.0, supervisor=self.craft(mode=SINKS), feet="left and floor") is None

    def test_a_target_out_of_sight_is_its_supervisors_matter(self):
        """It sets down first; a verdict would leave it in the air."""
        flying = Failsafe(lands=False, lost_after_s=1.0)
        assert judged(9.9, supervisor=flying, lost=True, rest_reason="nothing in sight") is None
