"""The tests of safety, one by one: what ends a run whatever its task."""

from dataclasses import replace

import pytest

import vstestbed as vs
from tests.tasks.frames import back_from_target, frame, times
from vstestbed.core.geometry import Pose
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.endings import PlaneCrossed, Termination
from vstestbed.endings.blocked import BLOCKED_SCALE, Blocked
from vstestbed.endings.contact import Contact
from vstestbed.endings.divergence import FAR_M, Divergence
from vstestbed.robots.base import Supervisor
from vstestbed.robots.flight import Failsafe
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.monitor import TaskMonitor
from vstestbed.tasks.stop import Stop

SETUP = vs.load("arm_ibvs").setup


SAFETY = Contact, Divergence, PlaneCrossed, Blocked


class Safety:
    """The terms of safety alone, in the order of a run's."""

    def __init__(self, ends: Termination):
        self._terms = [term for term in ends.terms if isinstance(term, SAFETY)]
        assert len(self._terms) == len(SAFETY)

    def unsafe(self, frame: Frame) -> Verdict | None:
        return next(filter(None, [term.update(frame) for term in self._terms]), None)


def termination(
    supervisor: Supervisor | None = None, stop: Stop = SETUP.stop, one_sided: bool = True
) -> Safety:
    """Of a run with a square of markers, which are on its front only, or with landmarks, which have
    no front.
    """
    supervisor = supervisor or Supervisor()
    target = SETUP.target if one_sided else vs.load("car_pbvs").target
    setup = replace(SETUP, stop=stop)
    monitor = TaskMonitor(setup, 1, supervisor)
    return Safety(Termination(monitor, replace(setup, target=target), supervisor))


def verdicts(ends: Safety, seconds: float, from_s: float = 0.0, **given):
    """What is said of the same frame at 25 Hz, (time [s], verdict) where something is."""
    said = [(t, ends.unsafe(frame(t, **given))) for t in times(seconds, from_s)]
    return [(t, verdict) for t, verdict in said if verdict]


class TestCollision:
    def test_a_touch_is_one(self):
        ends = termination()
        assert ends.unsafe(frame()) is None
        assert ends.unsafe(frame(contact="forearm and floor")) == (
            Outcome.collided,
            "contact of forearm and floor",
        )

    @pytest.mark.parametrize(("lands", "collides"), [(True, False), (False, True)])
    def test_feet_may_touch_in_a_landing(self, lands, collides):
        ends = termination(Failsafe(lands=lands, lost_after_s=1.0))
        touch = ends.unsafe(frame(feet="left and floor"))
        assert touch == ((Outcome.collided, "contact of left and floor") if collides else None)
        assert ends.unsafe(frame(feet="left and floor", contact="hub and floor")) == (
            Outcome.collided,
            "contact of hub and floor",
        )

    def test_it_says_why_the_task_had_been_given_up(self):
        failsafe = Failsafe(
            lands=True, lost_after_s=1.0, aborted=(Outcome.overturned, "tilted at 3.0 s")
        )
        touch = termination(failsafe).unsafe(frame(contact="forearm and floor"))
        assert (
            touch is not None and touch[1] == "contact of forearm and floor, after tilted at 3.0 s"
        )


class TestDivergence:
    def test_beyond_far_off(self):
        ends = termination()
        assert ends.unsafe(frame(T_world_camera=back_from_target(FAR_M - 0.1))) is None
        far = ends.unsafe(frame(T_world_camera=back_from_target(FAR_M + 0.1)))
        assert far == (Outcome.diverged, "the camera is more than 200 m away from the target")

    def test_it_is_the_distance_from_the_target(self):
        """Both far from the world's origin, near each other."""
        far = Pose(xyz=(0, 500, 0)).T
        assert (
            termination().unsafe(
                frame(T_world_camera=far @ back_from_target(1.0), T_world_target=far)
            )
            is None
        )


class TestPlaneCrossed:
    @pytest.mark.parametrize(
        ("distance_m", "crossed"), [(0.01, False), (1.0, False), (0.0, True), (-0.01, True)]
    )
    def test_behind_the_front(self, distance_m, crossed):
        ends = termination()
        assert ends.unsafe(frame(T_world_camera=back_from_target(0.5))) is None
        verdict = ends.unsafe(frame(T_world_camera=back_from_target(distance_m)))
        assert (verdict is not None) is crossed
        assert verdict is None or verdict == (
            Outcome.target_lost,
            "the camera crossed the plane of the target",
        )

    TURNED = Pose(rpy_deg=(0, 180, 0)).T

    def test_a_start_behind_the_front_has_crossed_nothing(self):
        for given in ({"T_world_camera": back_from_target(-0.1)}, {"T_world_target": self.TURNED}):
            verdict = termination().unsafe(frame(**given))
            assert verdict is not None and verdict[0] is Outcome.target_lost
            assert verdict[1].startswith("the camera starts behind the plane of the target")

    def test_a_target_that_turns_its_back_was_not_crossed(self):
        ends = termination()
        assert ends.unsafe(frame()) is None
        verdict = ends.unsafe(frame(T_world_target=self.TURNED))
        assert verdict is not None and verdict[1].startswith("the target turned its back")

    def test_only_where_a_front_is_lost(self):
        for stop, one_sided, ends_run in (
            (Stop(lost_after_s=None), True, True),
            # where no loss ends a run the plane may be crossed
            (Stop(lost_after_s=None, lost_after_m=None), True, False),
            (Stop(), False, False),  # landmarks have no front
        ):
            crossed = termination(stop=stop, one_sided=one_sided).unsafe(
                frame(T_world_camera=back_from_target(-0.1))
            )
            assert (crossed is not None) is ends_run


class TestLimitReached:
    @pytest.mark.parametrize("limit", ["joint_limit", "singular"])
    def test_after_a_second_of_nearly_nothing(self, limit):
        t, verdict = verdicts(termination(), 1.5, limit=limit, scale=BLOCKED_SCALE / 2)[0]
        assert t == pytest.approx(1.0)
        assert verdict == (Outcome[limit], f"for 1 s {Outcome[limit].value}")

    @pytest.mark.parametrize(
        ("limit", "scale"), [("joint_limit", 2 * BLOCKED_SCALE), ("speed", 0.0), ("", 1.0)]
    )
    def test_what_goes_on_slowly_or_meets_its_speed_limit_is_not_stopped(self, limit, scale):
        assert not verdicts(termination(), 3.0, limit=limit, scale=scale)

    def test_a_moment_of_motion_in_between(self):
        ends = termination()
        assert not verdicts(ends, 0.8, limit="singular", scale=0.0)
        assert not verdicts(ends, 0.84, from_s=0.84)
        assert not verdicts(ends, 1.8, from_s=0.88, limit="singular", scale=0.0)

    def test_it_lasts_a_second_and_leaves_less_than_a_fiftieth(self):
        """In numbers, not by the constants' names."""
        for scale, stops in ((0.019, True), (0.021, False)):
            assert bool(verdicts(termination(), 1.5, limit="singular", scale=scale)) is stops
        assert not verdicts(termination(), 0.96, limit="singular", scale=0.0)
        assert verdicts(termination(), 1.04, limit="singular", scale=0.0)
