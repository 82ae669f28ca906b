"""Elastic gears against the closed form of the two-mass joint: eigenfrequencies, damping, play; the
rotor has motor and encoder.
"""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.sim.two_mass import ROTOR, arm, frequency, inertia, plant_of, stage_of
from vstestbed.core.geometry import Array
from vstestbed.effects.base import RobotBody
from vstestbed.effects.joints import CURVES, ElasticJoints, Gears, StrainWave
from vstestbed.sim.scene.scene import Scene

K = 2000.0
"""[Nm/rad]: 8 Hz before a rotor that stands, 14 Hz before a free one."""


def loose(folder: Path, step_s: float | None = None, **gears: float | tuple[float, ...]) -> Scene:
    """The joint with elastic gears, its servos off."""
    stage = stage_of(arm(folder, gears=Gears(**{"stiffness_nmprad": (K, 0.0), **gears})), step_s)  # type: ignore[arg-type] - of dict values
    stage.model.actuator_gainprm[:], stage.model.actuator_biasprm[:] = 0.0, 0.0
    return stage


def swing(
    stage: Scene, seconds: float, wind: float = 0.001, locked: bool = False
) -> tuple[Array, Array]:
    """Times and angles of the spring, let go at a deflection [rad]."""
    model, data, at = stage.model, stage.data, stage.at
    if locked:
        model.dof_damping[at.motor_qvel[0]] = 1e9
    data.qpos[at.qpos[0]] = wind
    mujoco.mj_forward(model, data)
    out = []
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
        out.append((data.time, data.qpos[at.qpos[0]] - data.qpos[at.motor_qpos[0]]))
    stage.close()
    return tuple(np.array(out).T)  # type: ignore[return-value] - rows of an array


@pytest.mark.parametrize("locked", [False, True])
def test_its_eigenfrequency_is_that_of_two_masses(tmp_path: Path, locked: bool) -> None:
    theory = math.sqrt(K * (1 / inertia() + (0 if locked else 1 / ROTOR)))
    found = frequency(*swing(loose(tmp_path, damping_s=0.0), 2.0, locked=locked))
    assert found == pytest.approx(theory, rel=0.002)  # the bound is 1 %


def test_at_the_longest_step_it_is_one_per_cent_too_quick(tmp_path: Path) -> None:
    w = math.sqrt(K * (1 / inertia() + 1 / ROTOR))
    found = frequency(*swing(loose(tmp_path, step_s=0.5 / w, damping_s=0.0), 2.0))
    assert found == pytest.approx(w * (1 + 0.5**2 / 24), rel=0.001)


def test_it_decays_by_the_logarithmic_decrement(tmp_path: Path) -> None:
    w, damping_s = math.sqrt(K * (1 / inertia() + 1 / ROTOR)), 0.0008
    _, x = swing(loose(tmp_path, step_s=0.0005, damping_s=damping_s), 1.0)
    peaks = np.flatnonzero((x[1:-1] > x[:-2]) & (x[1:-1] > x[2:])) + 1
    found = math.log(x[peaks[0]] / x[peaks[8]]) / 8
    zeta = w * damping_s / 2
    assert found == pytest.approx(2 * math.pi * zeta / math.sqrt(1 - zeta**2), rel=0.02)


def test_its_lost_motion_is_the_play(tmp_path: Path) -> None:
    """The link is turned to and fro before a held rotor by a torque: the two rests are apart by the
    play and twice the wind-up.
    """
    play, torque = 0.2, 0.5
    stage = loose(tmp_path, damping_s=0.01, backlash_deg=(play, 0.0))
    model, data, at = stage.model, stage.data, stage.at
    model.dof_damping[at.motor_qvel[0]], model.dof_damping[at.qvel[0]] = 1e9, 20.0
    rests = []
    for sign in (1, -1):
        data.qfrc_applied[at.qvel[0]] = sign * torque
        mujoco.mj_step(model, data, 3000)
        rests.append(data.qpos[at.qpos[0]])
    stage.close()
    assert rests[0] - rests[1] == pytest.approx(math.radians(play) + 2 * torque / K, rel=1e-4)


def test_a_small_load_winds_the_gears_up_to_the_side_that_it_pulls(tmp_path: Path) -> None:
    """At the start the rotor is ahead of its link by T / k and half the play, also under 0.3 Nm;
    without a load by neither.
    """
    play = math.radians(0.2)
    for torque, expected in ((0.3, 0.3 / K + play / 2), (-0.3, -0.3 / K - play / 2), (0.0, 0.0)):
        stage = loose(tmp_path, backlash_deg=(0.2, 0.0))
        effect = next(e for e in stage.parts.robot.acting if isinstance(e, ElasticJoints))
        load = np.zeros(stage.model.nv)
        load[stage.at.qvel[0]] = torque
        stage.data.qpos[stage.at.motor_qpos] = stage.data.qpos[stage.at.qpos]
        effect.settle(
            RobotBody(stage.model, stage.data, stage.at, stage.model.opt.timestep, (), ()), load
        )
        rotor, link = stage.data.qpos[[stage.at.motor_qpos[0], stage.at.qpos[0]]]
        assert rotor - link == pytest.approx(expected, abs=1e-12)
        assert load[stage.at.motor_qvel[0]] == torque  # which then is the rotor's
        stage.close()


def test_within_its_play_the_link_is_free(tmp_path: Path) -> None:
    _, x = swing(
        loose(tmp_path, damping_s=0.0, backlash_deg=(0.4, 0.0)), 0.5, wind=math.radians(0.1)
    )
    assert np.ptp(x) == 0.0


@pytest.mark.parametrize(("torque", "part"), [(0.0, 0), (-1.0, 0), (5.0, 1), (-30.0, 2)])
def test_a_strain_wave_gear_bends_and_vibrates_in_stages(
    tmp_path: Path, torque: float, part: int
) -> None:
    """Size 14 before a held rotor: its torsion under a torque is the catalogue's, and the link
    swings about it at sqrt(k / M).
    """
    curve, gear = CURVES[14], StrainWave(sizes=(14, 0), rotor_kgm2=(0.5, 0.01))
    stage = stage_of(arm(tmp_path, gears=Gears(damping_s=0.0), strain_wave=gear), 0.0005)
    model, data, at = stage.model, stage.data, stage.at
    assert model.dof_armature[at.motor_qvel] == pytest.approx([0.5, 0.01])  # in place of the file's
    model.actuator_gainprm[:], model.actuator_biasprm[:] = 0.0, 0.0
    model.dof_damping[at.motor_qvel[0]], data.qfrc_applied[at.qvel[0]] = 1e9, torque
    (first, second), T, stiffness = curve.bends, abs(torque), (curve.k1, curve.k2, curve.k3)[part]
    in_third = second + (T - curve.t2) / curve.k3
    torsion = (T / curve.k1, first + (T - curve.t1) / curve.k2, in_third)[part]
    rest = math.copysign(torsion, torque)
    data.qpos[at.qpos[0]] = rest + 1e-5
    rows = []
    for _ in range(2000):
        mujoco.mj_step(model, data)
        rows.append((data.time, data.qpos[at.qpos[0]]))
    stage.close()
    t, q = np.array(rows).T
    assert q.mean() == pytest.approx(rest, abs=2e-7)
    assert frequency(t, q - rest) == pytest.approx(math.sqrt(stiffness / inertia()), rel=0.005)


def test_encoder_and_servo_are_on_the_rotors_side(tmp_path: Path) -> None:
    plant = plant_of(arm(tmp_path, axis="0 1 0", gears=Gears(stiffness_nmprad=(K, 0.0))))
    sag = 9.81 * 2.0 * 0.6 / K
    reading, truth = plant.reading(), plant.truth()
    assert truth.q == pytest.approx([0, 0], abs=1e-12)  # it starts where the scenario says
    assert reading.q == pytest.approx([-sag, 0], abs=1e-6)
    assert plant.advance(500)
    # at rest: servo and spring carry the load
    assert plant.truth().q == pytest.approx([0, 0], abs=1e-6)
    plant.close()


def test_it_moves_as_commanded_and_trembles(tmp_path: Path) -> None:
    still, soft = (
        plant_of(arm(tmp_path, gears=g)) for g in (None, Gears(stiffness_nmprad=(K, 0.0)))
    )
    shakes = []
    for plant in (still, soft):
        plant.apply(np.array([0.3, 0.0]))
        plant.advance(round(1.0 / plant.step_s))
        # behind by its lag, kv / kp = 1/40 s
        assert plant.truth().q[0] == pytest.approx(0.3 - 0.3 / 40, abs=0.012)
        plant.apply(np.zeros(2))
        plant.advance(round(0.15 / plant.step_s))
        speeds = []
        for _ in range(100):
            plant.advance(1)
            speeds.append(plant.truth().qd[0])
        shakes.append(np.ptp(speeds))
        plant.close()
    assert shakes[1] > 5 * shakes[0]


def test_dry_friction_winds_a_servo_up(tmp_path: Path) -> None:
    """A servo of the gains kp and kv that turns a joint of the friction F at w is behind by (F + kv
    w) / kp.

    Before it breaks away, friction of MuJoCo lets the joint creep: of the impedance d and the time
    constant c, under a torque T < F, at (1 - d)/d T / (M b), b = 2/(dmax c).
    """
    friction, w, kp, kv = 20.0, 0.02, 2000.0, 50.0
    stage = stage_of(arm(tmp_path), 0.001)
    model, data, at = stage.model, stage.data, stage.at
    model.dof_frictionloss[at.qvel[0]] = friction
    (d, dmax), (c, _) = model.dof_solimp[at.qvel[0], :2], model.dof_solref[at.qvel[0]]
    data.ctrl[at.ctrl] = (w, 0.0)
    log = []
    for _ in range(3000):
        mujoco.mj_step(model, data)
        log.append((data.time, data.act[0] - data.qpos[at.qpos[0]], data.qvel[at.qvel[0]]))
    stage.close()
    t, behind, rate = np.array(log).T
    assert behind[-1] == pytest.approx((friction + kv * w) / kp, rel=0.002)
    assert rate[-1] == pytest.approx(w, rel=0.002)
    creeps = (t > 0.25) & (t < 0.5)
    torque = kp * behind - kv * rate
    assert torque[creeps].max() < friction
    expected = (1 - d) / d * torque / (inertia() + ROTOR) / (2 / (dmax * c))
    assert rate[creeps] == pytest.approx(expected[creeps], rel=0.06)
