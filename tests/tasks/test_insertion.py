"""Insertion: the way of the reference, when it waits, the verdicts on depth, force and a plug that
is stuck; the tool and its sensor.
"""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import Array, inverse
from vstestbed.features.observation import Observation
from vstestbed.loop.plants import plant_of
from vstestbed.robots.arm import Arm
from vstestbed.scenario.checks import check_depth
from vstestbed.sim.plant import MujocoPlant
from vstestbed.tasks.insertion import GoalInsertion

NEAR = {
    "robot.start.nominal.q_deg": [13.0, 34.0, -168.0, 18.4, 46.0, -13.0],
    "robot.controller": "velocity",
    "detector": "oracle",
}
"""A start 4 cm before the mouth, with the joints' own servos: a second a run."""


@pytest.fixture(scope="module")
def scenario() -> vs.Scenario:
    return vs.load("arm_insert", NEAR | {"goal.limit_n": 400, "goal.speed_mps": 0.01})


@pytest.fixture(scope="module")
def inserted(scenario: vs.Scenario) -> vs.Recording:
    return vs.run(scenario)


def tip_of(scenario: vs.Scenario, T_camera_target: Array) -> Array:
    """The tip of the plug in the target's frame (3,) [m] where the camera sees it at a
    pose (4, 4).
    """
    T_target_flange = inverse(T_camera_target) @ inverse(scenario.camera.mount.T)
    return (T_target_flange @ [0, 0, 0.2, 1])[:3]


class TestReference:
    def seen(self, T: Array, t: float, force: float = 0.0) -> Observation:
        axis = T[:3, 2]
        wrench = np.concatenate([-force * axis, np.zeros(3)])
        return Observation(t, np.zeros((4, 2)), np.zeros((4, 2)), np.zeros(4), T, wrench=wrench)

    def go(self, scenario: vs.Scenario, frames: int, **off: Any) -> tuple[Any, list[vs.Goal]]:
        """The reference of a camera that follows it exactly, or is off by a displacement; pressing
        from a way on.
        """
        goal = scenario.goal
        assert isinstance(goal, GoalInsertion)
        state, found = goal.begin(scenario.setup, scenario.goal_views), [scenario.goal_view]
        for k in range(frames):
            T = found[-1].T_camera_target.copy()
            T[:3, 3] += T[:3, :3] @ np.array(off.get("by", (0.0, 0.0, 0.0)))
            # the weight of the tool before
            force = off.get("force", 0.0) if state.way_m > 0.02 else 2.0
            state, view = goal.reference(state, self.seen(T, 0.04 * k, force))
            found.append(view)
        return state, found

    def test_the_first_view_has_the_tip_before_the_mouth_on_the_axis(
        self, scenario: vs.Scenario
    ) -> None:
        # depth 30, standoff 30 mm
        assert tip_of(scenario, scenario.goal_view.T_camera_target) == pytest.approx(
            [0, 0, -0.06], abs=1e-9
        )

    def test_it_waits_until_the_plug_has_been_in_line_and_then_goes_along_the_axis(
        self, scenario: vs.Scenario
    ) -> None:
        state, views = self.go(scenario, 200)
        tips = np.array([tip_of(scenario, view.T_camera_target) for view in views])
        assert np.abs(tips[:, :2]).max() < 1e-9
        t = 0.04 * np.arange(-1, 200)
        moving = np.flatnonzero(np.diff(tips[:, 2]) > 1e-9)
        # hold_s after its second frame
        assert t[moving[0] + 1] == pytest.approx(0.04 + 0.4, abs=0.041)
        assert np.diff(tips[moving[0] : moving[-1], 2]) == pytest.approx(0.01 * 0.04, abs=1e-9)
        # beyond the bottom, so that the plug presses
        assert tips[-1, 2] == pytest.approx(0.004, abs=1e-9)
        assert state.way_m == pytest.approx(0.064)

    def test_the_view_on_its_way_has_the_twist_of_a_camera_that_goes_along(
        self, scenario: vs.Scenario
    ) -> None:
        _, views = self.go(scenario, 40)
        a, b = views[-2], views[-1]
        assert a.moves and b.twist is not None
        # in the target's frame
        step = (inverse(b.T_camera_target)[:3, 3] - inverse(a.T_camera_target)[:3, 3]) / 0.04
        assert inverse(b.T_camera_target)[:3, :3] @ b.twist[:3] == pytest.approx(step, abs=1e-9)

    @pytest.mark.parametrize(
        "off", [{"by": (0.004, 0, 0)}, {"by": (0, 0, 0.02)}], ids=["beside the axis", "far behind"]
    )
    def test_it_does_not_begin_with_a_plug_out_of_line(
        self, scenario: vs.Scenario, off: dict[str, Any]
    ) -> None:
        state, _ = self.go(scenario, 100, **off)
        assert state.way_m == 0.0

    def test_it_stops_where_the_plug_presses_less_the_weight_of_the_tool(
        self, scenario: vs.Scenario
    ) -> None:
        # 20 N and the 2 N of before
        free, pressed = (self.go(scenario, 200, force=force)[0].way_m for force in (21.0, 23.0))
        assert free == pytest.approx(0.064) and pressed == pytest.approx(0.0204, abs=4e-4)


class TestVerdicts:
    def test_inserted_at_its_depth_and_touching_by_the_truth(
        self, inserted: vs.Recording, scenario: vs.Scenario
    ) -> None:
        assert inserted.outcome is vs.Outcome.inserted and inserted.outcome.success
        assert (
            inserted["insertion_m"][-1] == pytest.approx(0.03, abs=5e-4)
            and inserted["plug_force_n"][-1] > 0
        )
        assert inserted["plug_offset_m"][-1] < 0.001
        T = inverse(vs.Pose(xyz=(0.95, 0, 0.6), rpy_deg=(0, 90, 0)).T)
        camera = inserted.camera_poses()[-1].A
        tip = T @ camera @ inverse(scenario.camera.mount.T) @ [0, 0, 0.2, 1]
        assert inserted["insertion_m"][-1] == pytest.approx(tip[2] + 0.03, abs=1e-6)
        summary = inserted.summary()
        assert summary["judged_error"] < 5e-4
        assert summary["insertion_m"] == pytest.approx(0.03, abs=5e-4)
        assert summary["largest_force_n"] == inserted["plug_force_n"].max()

    def test_too_large_a_force_is_a_collision(self) -> None:
        run = vs.run(vs.load("arm_insert", NEAR | {"goal.limit_n": 50, "goal.speed_mps": 0.01}))
        assert run.outcome is vs.Outcome.collided and "over 50 N" in run.reason

    def test_beside_the_hole_it_is_stuck_or_presses_too_much(self) -> None:
        # The believed mount is 8 mm off: the nose meets the wall's front.
        beside = NEAR | {
            "calibration.mount_error": {"xyz": [0.008, 0, 0]},
            "goal.limit_n": 5000,
            "goal.jam_s": 1,
            "goal.speed_mps": 0.01,
        }
        run = vs.run(vs.load("arm_insert", beside))
        assert run.outcome is vs.Outcome.jammed and run["insertion_m"].max() < 0.012
        assert run["plug_offset_m"][run["insertion_m"] < -0.01][-1] == pytest.approx(
            0.008, abs=1.5e-3
        )

    def test_an_impedance_slides_in_where_servos_press_too_much(self) -> None:
        # The believed mount is 3 mm off, three times the clearance.
        off = NEAR | {"calibration.mount_error": {"xyz": [0.003, 0, 0]}}
        soft = vs.load("arm_insert").robot.controller
        yielding, stiff = (
            vs.run(vs.load("arm_insert", off | {"robot.controller": loop}))
            for loop in (soft, "velocity")
        )
        assert yielding.outcome is vs.Outcome.inserted and yielding["plug_force_n"].max() < 100
        assert stiff.outcome is vs.Outcome.collided and "over 200 N" in stiff.reason


class TestTool:
    def test_the_wrist_feels_the_weight_of_the_plug_and_what_it_presses_with(
        self, inserted: vs.Recording
    ) -> None:
        names = [f"wrist_{part}{axis}" for part in "fm" for axis in "xyz"]
        wrench = np.column_stack([inserted[name] for name in names])
        free = wrench[(inserted["plug_force_n"] == 0) & (inserted["t"] > 1)]
        weight = np.linalg.norm(free[:, :3], axis=1)
        # 0.2 kg; noise .1 N
        assert weight.mean() == pytest.approx(0.2 * 9.81, rel=0.05) and weight.std() < 0.2
        assert -wrench[-1, 2] > 20  # along the plug, towards the flange

    def test_at_rest_it_is_the_weight_of_the_plug_at_its_centre(
        self, scenario: vs.Scenario
    ) -> None:
        still = replace(scenario.robot, wrist={"noise_n": 0.0})
        with closing(plant_of(replace(scenario, robot=still), False, 0.0)[0]) as plant:
            assert isinstance(plant, MujocoPlant)
            plant.advance(300)
            wrench = plant.reading().wrench
            assert isinstance(still, Arm)
            down = still.flange_pose(plant.reading().q)[:3, :3].T @ [0, 0, -0.2 * 9.81]
        assert wrench[:3] == pytest.approx(down, rel=0.01, abs=0.02)
        # Of a capsule with its two half spheres, whose middle is half way between both, at 10 and
        # 190 mm.
        assert wrench[3:] == pytest.approx(np.cross([0, 0, 0.1], down), abs=0.01)

    def test_its_noise_is_that_of_the_block_and_drawn_from_the_seed(
        self, scenario: vs.Scenario
    ) -> None:
        noisy = replace(
            scenario,
            robot=replace(scenario.robot, wrist={"noise_n": 2.0}),
            stop=replace(scenario.stop, duration_s=1.0),
        )
        a, b = (vs.run(noisy.with_seed(seed))["wrist_fx"] for seed in (1, 2))
        assert np.std(a[5:]) == pytest.approx(2.0, rel=0.5) and not np.array_equal(a, b)

    def test_a_law_that_reads_the_wrench_needs_the_sensor(self) -> None:
        class Feeling(vs.ErrorLaw):
            kind = "feeling"
            inputs = ("xy", "depth", "wrench")

            def equations(self, view: Any, goal: Any) -> tuple[Array, Array]:
                raise NotImplementedError

        without, law = vs.load("arm_ibvs"), vs.spec(Feeling)()
        with pytest.raises(ParameterError, match=r"law needs robot\.wrist"):
            check_depth(without.robot, without.camera, without.detector, law)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"robot.tool": None}, "robot.tool: is missing"),
        ({"target.socket": None}, "target.socket: is missing"),
        (
            {"target.socket.radius": 0.009},
            "target.socket.radius: must be over robot.tool.radius = 0.01 m",
        ),
        ({"goal.depth_m": 0.05}, "goal.depth_m: must be at most target.socket.depth = 0.03 m"),
        ({"law": {"kind": "ibvs", "depth": "goal"}}, "law.depth: may not be goal"),
        ({"goal.tip_m": 0.25}, "goal.tip_m: must be robot.tool.length"),
    ],
)
def test_what_does_not_fit_is_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ScenarioError, match=words.replace(".", r"\.")):
        vs.load("arm_insert", change)


def test_the_hole_is_as_wide_as_it_says(scenario: vs.Scenario) -> None:
    # Rays from the axis outwards, half way down the hole: the inner sides touch the circle of its
    # radius.
    import mujoco

    with closing(plant_of(scenario, False, 0.0)[0]) as plant:
        assert isinstance(plant, MujocoPlant)
        stage, found = plant._stage, []
        T = stage.target_pose()
        start, geom = (T @ [0, 0, -0.015, 1])[:3], np.zeros(1, np.int32)
        for angle in np.linspace(0, 2 * math.pi, 100):
            way = T[:3, :3] @ [math.cos(angle), math.sin(angle), 0]
            found.append(mujoco.mj_ray(stage.model, stage.data, start, way, None, 1, -1, geom))
        bottom = mujoco.mj_ray(stage.model, stage.data, start, T[:3, 2].copy(), None, 1, -1, geom)
    assert (
        min(found) == pytest.approx(0.011, abs=1e-6)
        and max(found) < 0.011 / math.cos(math.pi / 32) + 1e-6
    )
    assert bottom == pytest.approx(0.015, abs=1e-6)
