"""Torques of motors at each physics step: the current loop's step response, delay and bandwidth;
cogging and ripple.
"""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.sim.two_mass import MASS, REACH, arm, plant_of, stage_of
from vstestbed.core.geometry import Array
from vstestbed.effects.joints import CurrentLoops, MotorTorques, Ripple
from vstestbed.sim.plant import settle
from vstestbed.sim.scene.scene import Scene

KP = 2000.0


def held(stage: Scene) -> MotorTorques:
    """The motors of an arm whose joints are held,
    so that the servo's torque is what the test says.
    """
    settle(stage)
    stage.model.dof_damping[:] = 1e9
    motors = stage.parts.robot.acting[0].actor(stage.body, np.random.default_rng(0))
    assert isinstance(motors, MotorTorques)
    motors.start()
    return motors


def torques(stage: Scene, motors: MotorTorques, wind: Array) -> Array:
    """Torque of the first motor in each step, as its servo's reference is wound up by so much
    [rad].
    """
    h, data, out = stage.model.opt.timestep, stage.data, []
    rest = data.act[0]
    for offset in wind:
        data.act[0] = rest + offset
        motors.act(0.0, h)
        assert motors.force is not None
        data.qfrc_applied[:] = motors.force
        out.append(motors.force[stage.at.motor_qvel[0]])
        mujoco.mj_step(stage.model, data)
    stage.close()
    return np.array(out)


@pytest.mark.parametrize("delay_s", [0.0, 0.003])
def test_the_torque_follows_a_step_with_lag_and_delay(tmp_path: Path, delay_s: float) -> None:
    T, h, step = 1 / (2 * math.pi * 100.0), 0.0005, 0.01
    stage = stage_of(
        arm(tmp_path, drives=CurrentLoops(bandwidth_hz=100.0, delay_s=delay_s)), step_s=h
    )
    found = torques(stage, held(stage), np.full(60, step))
    begin = round(delay_s / h)
    t = h * np.arange(61 - begin)
    # the integral of 1 - exp(-t / T): the mean torque of a step is its difference
    response = t + T * np.exp(-t / T)
    theory = np.concatenate([np.zeros(begin), KP * step * np.diff(response) / h])
    np.testing.assert_allclose(found, theory, atol=1e-3)


def test_at_its_bandwidth_the_torque_has_fallen_by_three_decibels(tmp_path: Path) -> None:
    f, h = 100.0, 0.00025
    stage = stage_of(arm(tmp_path, drives=CurrentLoops(bandwidth_hz=f)), step_s=h)
    t = h * np.arange(800)
    found = torques(stage, held(stage), 0.01 * np.sin(2 * math.pi * f * t))[400:]
    amplitude = 2 * abs(np.mean(found * np.exp(-2j * math.pi * f * t[400:])))
    assert amplitude / (KP * 0.01) == pytest.approx(math.sqrt(0.5), rel=0.01)


def test_the_servos_torque_stays_within_its_limits(tmp_path: Path) -> None:
    stage = stage_of(arm(tmp_path, drives=CurrentLoops(), torque_limits=(5.0, 5.0)), step_s=0.001)
    assert torques(stage, held(stage), np.full(30, 0.1))[-1] == pytest.approx(5.0)


def test_an_arm_with_quick_loops_moves_as_one_without(tmp_path: Path) -> None:
    ways = []
    for drives in (None, CurrentLoops(bandwidth_hz=1000.0)):
        plant = plant_of(arm(tmp_path, axis="0 1 0", drives=drives), step_s=0.0005)
        plant.apply(np.array([0.4, -0.3]))
        way = []
        for _ in range(20):
            plant.advance(20)
            way.append(plant.truth().q)
        ways.append(np.array(way))
        plant.close()
    assert np.abs(ways[0] - ways[1]).max() < 1e-4  # of 80 mrad


def test_cogging_is_a_torque_of_the_rotors_angle(tmp_path: Path) -> None:
    stage = stage_of(arm(tmp_path, ripple=Ripple(cogging_nm=(0.5, 0.0), cycles=(48.0,))))
    motors, at = held(stage), stage.at
    angles = np.linspace(0, 2 * np.pi / 48, 25)
    found = []
    for q in angles:
        stage.data.qpos[at.qpos[0]] = q
        motors.act(0.0, 0.002)
        found.append(motors.force[at.qvel[0]])
    stage.close()
    np.testing.assert_allclose(found, 0.5 * np.sin(48 * angles), atol=1e-9)


def test_ripple_is_a_share_of_the_torque(tmp_path: Path) -> None:
    stage = stage_of(arm(tmp_path, axis="0 1 0", ripple=Ripple(share=0.05, cycles=(100.0,))))
    motors, at = held(stage), stage.at
    stage.data.qpos[at.qpos[0]] = np.pi / 200  # sin = 1
    motors.act(0.0, 0.002)
    assert abs(motors.force[at.qvel[0]]) == pytest.approx(0.05 * MASS * 9.81 * REACH, rel=1e-6)
    stage.close()


def test_cogging_shakes_a_slow_motion_at_its_own_frequency(tmp_path: Path) -> None:
    speed, cycles = 0.2, 200.0
    plant = plant_of(arm(tmp_path, ripple=Ripple(cogging_nm=(1.0, 0.0), cycles=(cycles,))))
    plant.apply(np.array([speed, 0.0]))
    plant.advance(500)
    qd = []
    for _ in range(1000):
        plant.advance(1)
        qd.append(plant.truth().qd[0])
    plant.close()
    power = np.abs(np.fft.rfft(np.array(qd) - np.mean(qd)))
    peak = np.fft.rfftfreq(1000, plant.step_s)[np.argmax(power)]
    assert peak == pytest.approx(speed * cycles / (2 * np.pi), abs=0.5)
