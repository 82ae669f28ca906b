"""The safety monitors, one by one: what ends a run whatever its task."""

import pytest

import vstestbed as vs
from tests.tasks.frames import back_from_target, frame, times
from vstestbed.core.geometry import Pose
from vstestbed.core.outcome import Outcome
from vstestbed.loop.judge import BLOCKED_SCALE, FAR_M, Collision, Divergence, LimitReached, PlaneCrossed, safety_monitors
from vstestbed.robots.base import Supervisor
from vstestbed.robots.flight import Failsafe
from vstestbed.tasks.stop import Stop


def verdicts(monitor, seconds, from_s=0.0, **given):
    """What a monitor says of the same frame at 25 Hz, (time [s], verdict) where it says something."""
    said = [(t, monitor.update(frame(t, **given))) for t in times(seconds, from_s)]
    return [(t, verdict) for t, verdict in said if verdict]


class TestCollision:
    def test_a_touch_is_one(self):
        monitor = Collision(Supervisor())
        assert monitor.update(frame()) is None
        assert monitor.update(frame(contact="forearm and floor")) == (Outcome.collided, "contact of forearm and floor")

    @pytest.mark.parametrize(("lands", "collides"), [(True, False), (False, True)])
    def test_feet_may_touch_in_a_landing(self, lands, collides):
        monitor = Collision(Failsafe(lands=lands, lost_after_s=1.0))
        assert monitor.touches(frame(feet="left and floor").truth) == ("left and floor" if collides else "")
        assert (monitor.update(frame(feet="left and floor")) is not None) is collides
        assert monitor.touches(frame(feet="left and floor", contact="hub and floor").truth) == "hub and floor"

    def test_it_says_why_the_task_had_been_given_up(self):
        failsafe = Failsafe(lands=True, lost_after_s=1.0, aborted=(Outcome.overturned, "tilted at 3.0 s"))
        assert Collision(failsafe).update(frame(contact="forearm and floor"))[1] == "contact of forearm and floor, after tilted at 3.0 s"


class TestDivergence:
    def test_beyond_far_off(self):
        monitor = Divergence()
        assert monitor.update(frame(T_world_camera=back_from_target(FAR_M - 0.1))) is None
        outcome, reason = monitor.update(frame(T_world_camera=back_from_target(FAR_M + 0.1)))
        assert outcome is Outcome.diverged and reason == "the camera is more than 200 m away from the target"

    def test_it_is_the_distance_from_the_target(self):
        """Both far from the world's origin, near each other."""
        far = Pose(xyz=(0, 500, 0)).T
        assert Divergence().update(frame(T_world_camera=far @ back_from_target(1.0), T_world_target=far)) is None


class TestPlaneCrossed:
    @pytest.mark.parametrize(("distance_m", "crossed"), [(0.01, False), (1.0, False), (0.0, True), (-0.01, True)])
    def test_behind_the_front(self, distance_m, crossed):
        monitor = PlaneCrossed()
        assert monitor.update(frame(T_world_camera=back_from_target(0.5))) is None
        verdict = monitor.update(frame(T_world_camera=back_from_target(distance_m)))
        assert (verdict is not None) is crossed
        assert verdict is None or verdict == (Outcome.target_lost, "the camera crossed the plane of the target")

    TURNED = Pose(rpy_deg=(0, 180, 0)).T

    def test_a_start_behind_the_front_has_crossed_nothing(self):
        for given in ({"T_world_camera": back_from_target(-0.1)}, {"T_world_target": self.TURNED}):
            outcome, reason = PlaneCrossed().update(frame(**given))
            assert outcome is Outcome.target_lost and reason.startswith("the camera starts behind the plane of the target")

    def test_a_target_that_turns_its_back_was_not_crossed(self):
        monitor = PlaneCrossed()
        assert monitor.update(frame()) is None
        assert monitor.update(frame(T_world_target=self.TURNED))[1].startswith("the target turned its back")


class TestLimitReached:
    @pytest.mark.parametrize("limit", ["joint_limit", "singular"])
    def test_after_a_second_of_nearly_nothing(self, limit):
        t, verdict = verdicts(LimitReached(), 1.5, limit=limit, scale=BLOCKED_SCALE / 2)[0]
        assert t == pytest.approx(1.0)
        assert verdict == (Outcome[limit], f"for 1 s {Outcome[limit].value}")

    @pytest.mark.parametrize(("limit", "scale"), [("joint_limit", 2 * BLOCKED_SCALE), ("speed", 0.0), ("", 1.0)])
    def test_what_goes_on_slowly_or_meets_its_speed_limit_is_not_stopped(self, limit, scale):
        assert not verdicts(LimitReached(), 3.0, limit=limit, scale=scale)

    def test_a_moment_of_motion_in_between(self):
        monitor = LimitReached()
        assert not verdicts(monitor, 0.8, limit="singular", scale=0.0)
        assert not verdicts(monitor, 0.84, from_s=0.84)
        assert not verdicts(monitor, 1.8, from_s=0.88, limit="singular", scale=0.0)

    def test_it_lasts_a_second_and_leaves_less_than_a_fiftieth(self):
        """In numbers, not by the constants' names."""
        for scale, ends in ((0.019, True), (0.021, False)):
            assert bool(verdicts(LimitReached(), 1.5, limit="singular", scale=scale)) is ends
        assert not verdicts(LimitReached(), 0.96, limit="singular", scale=0.0)
        assert verdicts(LimitReached(), 1.04, limit="singular", scale=0.0)


@pytest.mark.parametrize(("name", "left_out"), [("arm_ibvs", set()), ("car_pbvs", {PlaneCrossed})])  # landmarks have no front
def test_each_run_has_the_monitors_that_apply(name, left_out):
    collision = Collision(Supervisor())
    monitors = safety_monitors(vs.load(name).target, collision, Stop())
    assert monitors[0] is collision
    assert [type(m) for m in monitors] == [c for c in (Collision, Divergence, PlaneCrossed, LimitReached) if c not in left_out]


@pytest.mark.parametrize(("stop", "crossed"), [(Stop(lost_after_s=None), True), (Stop(lost_after_s=None, lost_after_m=None), False)])
def test_where_no_loss_ends_a_run_the_plane_may_be_crossed(stop, crossed):
    monitors = safety_monitors(vs.load("arm_ibvs").target, Collision(Supervisor()), stop)
    assert any(isinstance(monitor, PlaneCrossed) for monitor in monitors) is crossed
