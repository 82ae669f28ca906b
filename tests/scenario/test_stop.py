"""The judge: each outcome from the evidence that calls for it, with the reason that a person reads."""

from dataclasses import replace

import pytest
from vstestbed.scenario.progress_check import Pace

from vstestbed.core.outcome import Outcome
from vstestbed.loop.judge import Band, Evidence, Judge
from vstestbed.tasks.stop import Converged, Stop

STOP = Stop(duration_s=10, converged=Converged(error_px=0.2, hold_s=0.5), lost_after_s=1.0)
FINE = Evidence(
    t=0.0,
    lost=False,
    held="",
    all_seen=True,
    error_px=5.0,
    command_size=0.1,
    scale=1.0,
    limit="",
    distance=1.0,
    behind=False,
    contact=False,
)


def judged(evidence, seconds):
    """The verdict on the same evidence at 25 Hz for so long, and when it fell."""
    judge = Judge(STOP)
    for k in range(int(seconds * 25) + 1):
        if verdict := judge.verdict(replace(evidence, t=k / 25)):
            return (*verdict, k / 25)
    return None


def test_a_run_under_way_goes_on():
    assert judged(FINE, 9.9) is None


def test_the_goal_must_be_held():
    outcome, _, t = judged(replace(FINE, error_px=0.1), 5)
    assert outcome is Outcome.converged
    assert t == pytest.approx(0.52, abs=0.021)  # hold_s at the next frame


def test_a_goal_with_a_marker_out_of_sight_is_not_reached():
    assert judged(replace(FINE, error_px=0.1, all_seen=False), 9.9) is None


@pytest.mark.parametrize(
    ("change", "outcome", "words"),
    [
        ({"contact": True}, Outcome.collided, "touched"),
        ({"distance": 201.0}, Outcome.diverged, "200 m"),
        ({"behind": True}, Outcome.target_lost, "crossed the plane"),
        ({"lost": True, "held": "too few markers in sight"}, Outcome.target_lost, "too few markers in sight for 1 s, from the start on"),
        ({"lost": True, "held": "the depth of the markers in sight cannot be told"}, Outcome.target_lost, "depth of the markers"),
        ({"limit": "joint_limit", "scale": 0.0}, Outcome.joint_limit, "joint"),
        ({"limit": "singular", "scale": 0.01}, Outcome.singular, "singular"),
        ({"command_size": 0.0}, Outcome.local_minimum, "5 px"),
    ],
)
def test_each_end_has_its_evidence(change, outcome, words):
    found, reason, t = judged(replace(FINE, **change), 9)
    assert found is outcome
    assert words in reason
    assert t < 2.1  # nothing takes longer than the two seconds of rest


def test_a_target_that_was_seen_is_not_called_never_seen():
    judge = Judge(STOP)
    judge.verdict(FINE)
    verdicts = [judge.verdict(replace(FINE, t=t / 25, lost=True, held="too few markers in sight")) for t in range(1, 40)]
    _, reason = next(v for v in verdicts if v)
    assert reason == "too few markers in sight for 1 s"


def test_time_runs_out():
    assert judged(FINE, 10.1)[0] is Outcome.timed_out


@pytest.mark.parametrize(
    ("goal", "words"),
    [
        (Converged(error_px=0.2), "zero at an RMS error of 5 px"),
        (Converged(position_m=0.05, rotation_deg=4), "zero 0.01 m and 9.17 deg from the goal by the robot's own estimate"),
        (Converged(error_px=0.2, position_m=0.005), "RMS error of 5 px, 0.01 m and 9.17 deg from the goal by the robot's own estimate"),
    ],
)
def test_rest_away_from_the_goal_is_told_in_what_is_measured(goal, words):
    judge = Judge(Stop(converged=goal))
    at_rest = replace(FINE, command_size=0.0, position_m=0.01, rotation_rad=0.16)
    verdicts = [judge.verdict(replace(at_rest, t=k / 25)) for k in range(60)]
    outcome, reason = next(v for v in verdicts if v)
    assert outcome is Outcome.local_minimum and words in reason


class TestABand:
    BAND = Band(0.1, 4.0, (Pace("the vehicle", 0.8, 0.64),))

    def ended(self, speed, off):
        """The verdict on ten seconds at a speed, so far off its task."""
        judge = Judge(STOP, self.BAND)
        for k in range(251):
            if verdict := judge.verdict(replace(FINE, t=k / 25, off_m=off(k / 25), ways=(speed * k / 25,))):
                return verdict
        return None

    def test_kept_at_its_speed_it_is_completed(self):
        assert self.ended(0.8, lambda t: 0.05)[0] is Outcome.completed

    @pytest.mark.parametrize("speed", [0.0, 0.3, -0.8])
    def test_within_the_band_and_too_slow_or_backwards_it_is_not(self, speed):
        outcome, reason = self.ended(speed, lambda t: 0.05)
        assert outcome is Outcome.timed_out
        assert f"the vehicle made {speed:.2f} m/s in the 2 s before 4 s; 0.8 m/s were ordered" in reason

    def test_the_reason_is_what_came_first(self):
        assert "out of its band" in self.ended(0.8, lambda t: 0.2)[1]
        assert "made 0.30 m/s" in self.ended(0.3, lambda t: 0.2 if t > 6 else 0.05)[1]
