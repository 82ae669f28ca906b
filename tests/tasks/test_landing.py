"""Landing: when the reference comes down, and how a touch-down is judged."""

from dataclasses import replace

import numpy as np
import pytest

import vstestbed as vs
from tests.tasks.frames import frame
from vstestbed.core.errors import ScenarioError
from vstestbed.core.geometry import Pose, inverse
from vstestbed.core.outcome import Outcome
from vstestbed.features.observation import Observation
from vstestbed.robots.flight import DOWN_S, Failsafe
from vstestbed.tasks.landing import DEEPEST, LandingMonitor

SCENARIO = vs.load("quadrotor_land")
TASK = SCENARIO.goal


class TestReference:
    def seen(self, t: float, xyz: tuple[float, float, float], turn_deg: float = 0.0) -> Observation:
        nothing = np.zeros((4, 2))
        pose = Pose(xyz=xyz, rpy_deg=(0, 0, 45 + turn_deg)).T
        return Observation(t, nothing, nothing, np.ones(4), T_camera_target=pose)

    @pytest.mark.parametrize(
        ("xyz", "turn"), [((0.3, 0, 1.5), 0), ((0, 0, 2.2), 0), ((0, 0, 1.5), 30)]
    )
    def test_it_waits_while_the_craft_is_not_over_its_pad(self, xyz, turn):
        state = TASK.begin(SCENARIO.setup, SCENARIO.goal_views)
        for k in range(50):
            state, _ = TASK.reference(state, self.seen(0.04 * k, xyz, turn))
        assert state.share == 1.0

    def test_it_waits_while_the_pad_is_out_of_sight(self):
        state, nothing = TASK.begin(SCENARIO.setup, SCENARIO.goal_views), np.full((4, 2), np.nan)
        for k in range(50):
            state, _ = TASK.reference(
                state, Observation(0.04 * k, nothing, nothing, np.full(4, np.nan))
            )
        assert state.share == 1.0

    def test_it_comes_down_at_its_speed_and_goes_on_when_near(self):
        state, height = TASK.begin(SCENARIO.setup, SCENARIO.goal_views), 1.5
        for k in range(26):
            state, goal = TASK.reference(state, self.seen(0.04 * k, (0, 0, height * state.share)))
        # .25 m/s for a second
        np.testing.assert_allclose(goal.T_camera_target[:3, 3], [0, 0, 1.25], atol=1e-9)
        for k in range(26, 300):
            # off its pad, but too near to wait
            state, _ = TASK.reference(state, self.seen(0.04 * k, (0.3, 0, 0.2)))
        assert state.share == DEEPEST

    def test_how_near_is_over_its_pad(self):
        for xyz, turn, descends in (
            *(((0.14, 0, 1.5), 0, True), ((0.16, 0, 1.5), 0, False), ((0, -0.16, 1.5), 0, False)),
            *(
                ((0, 0, 1.75), 0, True),
                ((0, 0, 1.25), 0, True),
                ((0, 0, 1.85), 0, False),
                ((0, 0, 1.15), 0, False),
            ),
            *(((0, 0, 1.5), 14, True), ((0, 0, 1.5), 16, False)),
            # nearer than `commit_m` it waits for nothing
            *(((0.3, 0, 0.39), 0, True), ((0.3, 0, 0.4), 0, False)),
        ):
            state = TASK.begin(SCENARIO.setup, SCENARIO.goal_views)
            for t in (0.0, 0.04):
                state, goal = TASK.reference(state, self.seen(t, xyz, turn))
            assert (state.share < 1.0) is descends
            assert goal.T_camera_target[2, 3] == pytest.approx(1.49 if descends else 1.5)

    def test_the_first_frame_has_no_duration(self):
        state = TASK.begin(SCENARIO.setup, SCENARIO.goal_views)
        assert state.share == 1.0 and np.isnan(state.t)
        state, _ = TASK.reference(state, self.seen(7.0, (0, 0, 1.5)))
        assert state.share == 1.0 and state.t == 7.0

    @pytest.mark.parametrize("goal", ["told", "shown"])
    def test_it_comes_down_with_the_errors_of_the_calibration(self, goal):
        """At every height the view is the one that the robot would be given there, as the first one
        is.
        """
        scenario = vs.load("quadrotor_land", {"calibration": {"goal": goal, "depth_factor": 1.2}})
        state = scenario.goal.begin(scenario.setup, scenario.goal_views)
        state, first = scenario.goal.reference(state, self.seen(0.0, (0, 0, 1.5)))
        np.testing.assert_allclose(first.uv, scenario.goal_views[0].uv)
        np.testing.assert_allclose(first.depth, scenario.goal_views[0].depth)
        np.testing.assert_allclose(first.T_camera_target, scenario.goal_views[0].T_camera_target)
        # The estimate has the same error as the reference: it is over its pad, and comes down.
        at = Observation(
            0.04,
            np.zeros((4, 2)),
            np.zeros((4, 2)),
            np.ones(4),
            T_camera_target=first.T_camera_target,
        )
        state, lower = scenario.goal.reference(state, at)
        assert state.share == pytest.approx(1 - 0.25 * 0.04 / 1.5)
        exact = TASK.reference(state._replace(setup=SCENARIO.setup), self.seen(0.08, (9, 0, 2)))[1]
        np.testing.assert_allclose(lower.depth, 1.2 * exact.depth)


def craft(k: int, offset_m: float, sink_mps: float) -> np.ndarray:
    """T_world_craft (4, 4) at frame k of a descent at a speed that ends on the pad at frame 20."""
    return Pose(xyz=(offset_m, 0, 0.172 + sink_mps * 0.04 * (20 - k))).T


def touchdown(task) -> LandingMonitor:
    return LandingMonitor(task, SCENARIO.setup, Failsafe(lands=True, lost_after_s=1.0))


class TestTouchdown:
    def test_it_is_judged_by_place_and_speed(self):
        for offset_m, sink_mps, outcome, reason in (
            (0.1, 0.3, Outcome.landed, "touched down 10 cm from the pad's centre at 0.30 m/s"),
            (
                0.25,
                0.3,
                Outcome.collided,
                "touched down 25 cm from the pad's centre at 0.30 m/s: more than 20 cm",
            ),
            (
                0.1,
                0.6,
                Outcome.collided,
                "touched down 10 cm from the pad's centre at 0.60 m/s: more than 0.5 m/s",
            ),
        ):
            down = touchdown(TASK)
            for k in range(30):
                assert down.on_contact is None or k > 20
                down.moved(0.04 * k, craft(k, offset_m, sink_mps), np.eye(4), feet=k >= 20)
            assert down.offset_m == pytest.approx(offset_m)
            assert down.speed_mps == pytest.approx(sink_mps)
            assert down.on_contact == (outcome, reason)

    def test_speed_is_against_a_pad_that_moves(self):
        down = touchdown(TASK)
        for k in range(22):
            deck = Pose(xyz=(0.02 * k, 0, 0)).T  # half a metre a second
            down.moved(0.04 * k, deck @ craft(k, 0.1, 0.3), deck, feet=k >= 20)
        assert down.speed_mps == pytest.approx(0.3) and down.offset_m == pytest.approx(0.1)

    def test_its_bounds_are_within(self):
        """At the very distance and speed, from the frame before: exact in binary."""
        task = replace(TASK, pad_m=0.25, touch_mps=0.5)
        for offset, speed, outcome in (
            (0.25, 0.5, Outcome.landed),
            (0.25, 0.625, Outcome.collided),
            (0.3125, 0.5, Outcome.collided),
        ):
            down = touchdown(task)
            for t, height in ((0.0, 1.0), (0.5, 1.0 - 0.5 * speed)):
                down.moved(t, Pose(xyz=(offset, 0, height)).T, np.eye(4), feet=False)
            down.moved(1.0, Pose(xyz=(offset, 0, 0.5)).T, np.eye(4), feet=True)
            assert down.on_contact is not None and down.on_contact[0] is outcome

    def test_the_first_contact_counts(self):
        down = touchdown(TASK)
        for k in range(21):
            down.moved(0.04 * k, craft(k, 0.1, 0.3), np.eye(4), feet=k >= 20)
        down.moved(1.0, craft(20, 0.9, 0.3), np.eye(4), feet=True)  # it slides
        assert (
            down.offset_m == pytest.approx(0.1)
            and down.on_contact is not None
            and down.on_contact[0] is Outcome.landed
        )

    def test_two_frames_of_one_time_give_no_speed(self):
        down = touchdown(TASK)
        down.moved(0.0, craft(0, 0.1, 0.3), np.eye(4), feet=False)
        down.moved(0.04, craft(1, 0.1, 0.3), np.eye(4), feet=False)
        down.moved(0.04, craft(9, 0.1, 0.3), np.eye(4), feet=False)
        down.moved(0.08, craft(9, 0.1, 0.3), np.eye(4), feet=True)
        assert down.speed_mps == pytest.approx(0.3)


class TestMonitor:
    def landing(self, frames: int, off_at: float):
        """The monitor after a touch at frame 20, and its last answer; rotors went off at a time
        [s].
        """
        monitor = TASK.monitor(
            SCENARIO.setup, Failsafe(lands=True, lost_after_s=1.0, off_at=off_at)
        )
        assert isinstance(monitor, LandingMonitor)
        mount, pad = SCENARIO.camera.mount.T, np.eye(4)
        for k in range(frames):
            T_camera = craft(min(k, 20), 0.1, 0.3) @ mount
            seen = frame(
                0.04 * k,
                rms_px=0.0,
                T_world_camera=T_camera,
                T_world_target=pad,
                feet="left and floor" if k >= 20 else "",
            )
            monitor.measure(seen)
            verdict = monitor.reached(seen)
        return verdict

    def test_it_is_reached_when_the_craft_has_set_down(self):
        assert self.landing(40, off_at=1.0 + DOWN_S) is None  # touched, and not down yet
        assert self.landing(40, off_at=0.9) == (
            Outcome.landed,
            "touched down 10 cm from the pad's centre at 0.30 m/s",
        )

    def test_no_error_in_the_image_makes_a_landing(self):
        """Not for a frame at the goal view, whose error is zero all the way down."""
        assert self.landing(20, off_at=np.nan) is None
        assert not TASK.monitor(SCENARIO.setup, Failsafe(lands=True, lost_after_s=1.0)).near(
            frame(rms_px=0.0)
        )


def test_the_goal_pose_is_the_view_from_which_it_comes_down():
    (pose,) = SCENARIO.goal_poses
    np.testing.assert_array_equal(pose, TASK.above.T)
    assert (SCENARIO.target.T_world_start @ inverse(pose))[2, 3] > 1.0
    assert TASK.lands and TASK.bases == {"floating"} and TASK.view_fields == ("goal.above",)


def test_the_goal_is_where_the_craft_stands_on_its_pad():
    T = SCENARIO.goal_pose_at(20.0, 0)
    T_target_base = inverse(SCENARIO.camera.mount.T @ T)  # the target's z points down
    assert T_target_base[2, 3] == pytest.approx(-SCENARIO.robot.body.standing_m)
    T_target_camera = inverse(T)
    assert T_target_camera[:2, 3] == pytest.approx(0, abs=1e-12) and T_target_camera[2, 3] < 0


def test_without_a_pad_there_is_no_landing():
    with pytest.raises(
        ScenarioError,
        match=r"target\.pad: is missing: goal of kind landing needs one, e\.g\. \{side: 0\.9\}",
    ):
        vs.load("quadrotor_land", {"target.pad": None})
