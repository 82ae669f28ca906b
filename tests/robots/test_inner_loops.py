"""Inner loops of arms against theory: poles, static displacement, a wanted wrench; what they do
with wrong models and limits.
"""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from tests.sim import two_mass
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, adjoint, inverse, log
from vstestbed.loop.plants import plant_of
from vstestbed.robots.arm import Arm
from vstestbed.robots.chain import reader
from vstestbed.robots.inner_loops import damping_of
from vstestbed.sim.base import Plant

SPEEDS = np.array([0.2, -0.1, 0.1, 0.3, -0.2, 0.1])  # [rad/s]


def arm(**changes: Any) -> vs.Scenario:
    return vs.load("arm_ibvs", {"detector": "oracle", "robot.actuation": "ideal"} | changes)


def plant(scenario: vs.Scenario) -> Plant:
    return plant_of(scenario, False, 0.0)[0]


class TestComputedTorque:
    @pytest.mark.parametrize("zeta", [1.0, 0.5])
    def test_errors_decay_with_the_poles_that_are_asked_for(self, zeta: float) -> None:
        # A step of the ordered speeds by v: e'' + 2 zeta w e' + w^2 e = 0 from e = 0, e' = v, in
        # each joint alike.
        w = 20.0
        with closing(
            plant(
                arm(
                    **{
                        "robot.controller": {
                            "kind": "computed_torque",
                            "bandwidth_radps": w,
                            "damping": zeta,
                        }
                    }
                )
            )
        ) as made:
            start = made.reading().q.copy()
            made.apply(SPEEDS)
            t, errors = [], []
            for k in range(300):
                made.advance(1)
                t.append((k + 1) * made.step_s)
                errors.append(start + SPEEDS * t[-1] - made.reading().q)
        times, e = np.array(t), np.array(errors) / SPEEDS
        wd = w * np.sqrt(max(1 - zeta**2, 1e-12))
        theory = np.exp(-zeta * w * times) * (np.sin(wd * times) / wd)
        # the torque holds for a millisecond, w h = 2 % of a radian
        assert np.abs(e - theory[:, None]).max() < 0.05 * theory.max()
        assert np.ptp(e, axis=1).max() < 1e-3 * theory.max()  # all joints alike
        h, q, speed, ref, sampled = 1e-3, 0.0, 0.0, 0.0, []
        for k in range(300):  # the same loop as it is sampled, by MuJoCo's semi-implicit step
            speed += h * (w * w * (ref - q) + 2 * zeta * w * (1 - speed))
            q, ref = q + h * speed, ref + h
            sampled.append((k + 1) * h - q)
        assert e[:, 0] == pytest.approx(np.array(sampled), abs=2e-4 * theory.max())

    def test_the_arm_holds_its_start_before_the_first_command(self) -> None:
        with closing(plant(arm(**{"robot.controller": "computed_torque"}))) as made:
            start = made.reading().q.copy()
            made.advance(500)
            assert np.abs(made.reading().q - start).max() < 1e-6

    @pytest.mark.parametrize(
        ("payload", "sags"),
        [({"mass_kg": 2.0}, False), ({"mass_kg": 2.0, "declared": False}, True)],
    )
    def test_a_payload_that_is_not_declared_makes_it_sag_by_gravity_over_stiffness(
        self, payload: dict[str, Any], sags: bool
    ) -> None:
        scenario = arm(
            **{
                "robot.controller": {"kind": "computed_torque", "bandwidth_radps": 20},
                "robot.payload": payload,
            }
        )
        robot = scenario.robot
        assert isinstance(robot, Arm)
        with closing(plant(scenario)) as made:
            start = made.reading().q.copy()
            made.advance(2000)
            off = made.reading().q - start
        if not sags:
            assert np.abs(off).max() < 1e-6
            return
        # M w^2 (q_ref - q) carries the load that the model lacks.
        names = robot.chain.names
        known = reader().dynamics(robot.file, robot.flange, names, None)
        whole = reader().dynamics(robot.file, robot.flange, names, (2.0, 0.0, 0.0, 0.1, 0.1))
        q, still = start + off, np.zeros(6)
        missing = whole.inverse(q, still, still) - known.inverse(q, still, still)
        assert off == pytest.approx(
            -np.linalg.solve(known.mass(q), missing) / 20**2, rel=0.02, abs=1e-5
        )

    def test_it_reaches_the_goal_with_friction_and_with_drives_that_lag(self) -> None:
        for changes in (
            {"robot.actuation": "industrial"},
            {"robot.actuation": "industrial", "robot.drives": {"bandwidth_hz": 200}},
        ):
            run = vs.run(
                arm(**changes, **{"robot.controller": "computed_torque", "stop.duration_s": 12})
            )
            assert run["position_error_m"][-1] < 0.01 * run["position_error_m"][0]


class TestImpedance:
    def pushed(self, force: Array, **given: Any) -> tuple[Array, Array]:
        """Displacement (6,) of the impedance's frame by a static push on the flange's body [m,
        rad], and the wrench in that frame.
        """
        scenario = arm(**{"robot.controller": {"kind": "impedance"} | given})
        robot, at = scenario.robot, vs.Pose(**given.get("at", {})).T
        with closing(plant(scenario)) as made:
            before = robot.flange_pose(made.reading().q) @ at
            made.push(force, 6.0)
            made.advance(5000)
            after = robot.flange_pose(made.reading().q) @ at
            data = made._stage.data  # type: ignore[union-attr] - it has one
            centre = data.xipos[made._stage.flange_body]  # type: ignore[union-attr] - as above; where the push acts
        R = after[:3, :3]
        moment = np.cross(centre - after[:3, 3], force)
        return log(inverse(before) @ after), np.concatenate([R.T @ force, R.T @ moment])

    # at the tip, at the flange
    @pytest.mark.parametrize("at", one_quick({"xyz": [0.0, 0.05, 0.15], "rpy_deg": [20, 0, 0]}, {}))
    def test_a_static_push_displaces_it_by_force_over_stiffness(self, at: dict[str, Any]) -> None:
        stiff = [800.0, 1500.0, 3000.0]
        moved, wrench = self.pushed(
            np.array([10.0, -5.0, 8.0]),
            at=at,
            stiffness_npm=stiff,
            stiffness_nmprad=[200, 200, 200],
        )
        assert moved[:3] == pytest.approx(wrench[:3] / stiff, rel=0.01, abs=2e-5)
        assert moved[3:] == pytest.approx(wrench[3:] / 200, rel=0.02, abs=2e-5)

    def test_modes_have_the_damping_that_is_asked_for(self) -> None:
        rng = np.random.default_rng(0)
        A = rng.normal(size=(6, 6))
        mass, K, zeta = A @ A.T + np.eye(6), np.diag(rng.uniform(10, 1000, 6)), 0.7
        D = damping_of(mass, K, zeta)
        block = np.block(
            [[np.zeros((6, 6)), np.eye(6)], [-np.linalg.solve(mass, K), -np.linalg.solve(mass, D)]]
        )
        poles = np.linalg.eigvals(block)
        assert -poles.real / np.abs(poles) == pytest.approx(np.full(12, zeta), abs=1e-8)
        assert pytest.approx(D.T) == D

    def test_it_needs_six_joints(self, tmp_path: Path) -> None:
        with pytest.raises(ParameterError, match=r"controller is for arms of six joints"):
            two_mass.arm(tmp_path, controller={"kind": "impedance"})


class Press(vs.LawBase):
    """Orders no motion, and a force along the camera's x axis."""

    kind = "press"
    inputs = ("xy", "depth")

    def step(
        self, state: Any, observation: vs.Observation, goal: vs.Goal, basis: Array
    ) -> tuple[Any, vs.Command]:
        return state, vs.Command(
            np.zeros(6), np.zeros(6), wrench=np.array([12.0, 0, 0, 0, 0, 0]), free=()
        )


class TestWantedWrench:
    def test_it_displaces_the_arm_as_a_push_of_the_same_force_would(self) -> None:
        scenario = arm(**{"robot.controller": {"kind": "impedance", "at": {"xyz": [0, 0, 0]}}})
        robot = scenario.robot
        assert isinstance(robot, Arm)
        with closing(plant(scenario)) as made:
            reading = made.reading()
            mount = vs.Mount.of(scenario.camera.mount.T)
            still = robot.allocate(np.zeros(6), reading, mount, 0.04)
            before = robot.flange_pose(reading.q)
            made.apply(robot.pressed(still, np.array([12.0, 0, 0, 0, 0, 0]), mount).setpoint)
            for _ in range(40):
                made.apply(robot.pressed(still, np.array([12.0, 0, 0, 0, 0, 0]), mount).setpoint)
                made.advance(100)
            moved = log(inverse(before) @ robot.flange_pose(made.reading().q))
        assert moved[:3] == pytest.approx([0.012, 0, 0], abs=1.2e-4)  # 12 N over 1000 N/m

    def test_a_wrench_in_the_cameras_frame_has_the_same_power_in_the_impedances(self) -> None:
        scenario = arm(
            **{
                "robot.controller": {
                    "kind": "impedance",
                    "at": {"xyz": [0.02, 0, 0.2], "rpy_deg": [10, 20, 0]},
                }
            }
        )
        robot, mount = (
            scenario.robot,
            vs.Mount.of(vs.Pose(xyz=(0, -0.1, 0.03), rpy_deg=(-30, 0, 5)).T),
        )
        assert isinstance(robot, Arm)
        reading = vs.Reading(robot.start_joints(), np.zeros(6))
        wrench, twist = (
            np.array([1.0, -2, 3, 0.4, 0.5, -0.6]),
            np.array([0.1, 0.2, -0.1, 0.3, -0.2, 0.1]),
        )
        ordered = robot.pressed(
            robot.allocate(np.zeros(6), reading, mount, 0.04), wrench, mount
        ).setpoint[-6:]
        of_frame = adjoint(inverse(robot.controller.at.T)) @ mount.to_flange @ twist  # type: ignore[attr-defined] - an impedance
        assert ordered @ of_frame == pytest.approx(wrench @ twist)

    def test_a_law_that_orders_one_of_stiff_servos_has_failed(self) -> None:
        scenario = arm()
        object.__setattr__(scenario, "law", vs.spec(Press)())  # not registered: a law of one's own
        run = vs.run(scenario)
        assert (
            run.outcome is vs.Outcome.law_failed
            and "needs an arm with `controller: impedance`" in run.reason
        )


def test_torques_stay_within_the_motors_limits_and_are_in_the_log() -> None:
    run = vs.run(
        arm(
            **{
                "robot.actuation": "industrial",
                "robot.controller": "impedance",
                "stop.duration_s": 1,
            }
        )
    )
    most = np.array([97.6, 186.4, 89.4, 24.2, 20.1, 21.3])
    tau = np.column_stack([run[f"tau_joint_{i}"] for i in range(1, 7)])
    # joint 2 carries the arm
    assert (np.abs(tau) <= most + 1e-9).all() and np.abs(tau[1:, 1]).min() > 5


def test_a_model_of_servos_has_no_place_beside_a_model_of_masses() -> None:
    with pytest.raises(ParameterError, match=r"gravity_error is for servos.*declared: false"):
        replace(vs.load("arm_ibvs").robot, controller={"kind": "impedance"}, gravity_error=0.1)
