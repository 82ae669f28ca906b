"""A craft's imperfections in MuJoCo: its forces and torques against closed form, and against a body
with real spinning rotors.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from tests.robots.craft import WEIGHT, Craft
from tests.robots.flying import QUIET, perfect
from vstestbed.effects.airframe import Downwash, GroundEffect, RotorDrag
from vstestbed.effects.rotors import ROTOR_M, X4_ROTOR, Battery, MotorSpread, RotorInertia
from vstestbed.robots.quadrotor import Quadrotor
from vstestbed.robots.rotors import X4

R, ARM, b = X4.rotor_radius_m, X4.arm_m, X4.thrust_coefficient
SPEEDS = np.array([900.0, 820.0, 880.0, 840.0])


def cheeseman_bennett(z: float) -> float:
    return 1 / (1 - (R / (4 * z)) ** 2)


class TestGround:
    @pytest.mark.parametrize("height", [0.2, 0.25, 0.4, 1.0])
    def test_the_thrust_at_hover_speed(self, height):
        craft = Craft(perfect(ground_effect=GroundEffect()), (0, 0, height))
        craft.plant.advance(1)
        gain = craft.up / WEIGHT
        craft.close()
        expected = cheeseman_bennett(height + ROTOR_M)
        # the gain's excess, far within 2 % of the thrust
        assert gain - 1 == pytest.approx(expected - 1, rel=0.02)

    def test_a_craft_that_hovers_there_turns_its_rotors_slower(self):
        craft = Craft(perfect(ground_effect=GroundEffect()), (0, 0, 0.3))
        craft.fly(3.0)
        lifted, z = b * craft.W.sum(), craft.data.qpos[2] + ROTOR_M
        craft.close()
        assert lifted * cheeseman_bennett(z) == pytest.approx(WEIGHT, rel=1e-3)
        assert lifted < 0.99 * WEIGHT

    @pytest.mark.parametrize(("yaw_deg", "axis"), [(0, 1), (90, 0)])
    def test_over_the_edge_of_a_pad_the_craft_is_tilted_away_from_it(self, yaw_deg, axis):
        """The pad's edge is just beyond the hubs at both sides: one of the others, behind or at the
        left, is over the pad.
        """
        top, edge = 1.0, 0.01
        craft = Craft(
            perfect(ground_effect=GroundEffect()),
            (0, 0, top + 0.25),
            (edge - 0.45, 0, top),
            yaw_deg,
        )
        craft.plant.advance(20)  # all rays anew
        torque, force = craft.data.qfrc_applied[3:6].copy(), craft.data.qfrc_applied[2]
        craft.close()
        T, on, off = (
            WEIGHT / 4,
            cheeseman_bennett(0.25 + ROTOR_M) - 1,
            cheeseman_bennett(top + 0.25 + ROTOR_M) - 1,
        )
        side = 0.75 * on + 0.25 * off  # three of the four points of each disc are over the pad
        assert force == pytest.approx(T * (on + off + 2 * side), rel=0.02)
        # the nose, or the right, goes down, away from the pad
        assert torque[axis] == pytest.approx(ARM * T * (on - off), rel=0.02)
        assert abs(torque[1 - axis]) < 1e-3 * torque[axis]


class TestDrag:
    def test_there_is_none_at_rest(self):
        craft = Craft(perfect(rotor_drag=RotorDrag()))
        craft.plant.advance(1)
        force = craft.data.qfrc_applied[:6].copy()
        craft.close()
        assert force == pytest.approx(np.zeros(6), abs=1e-9)

    def test_a_drift_decays_with_the_mass_over_k_times_the_speeds(self):
        bare = replace(X4, drag_area_m2=0.0)
        craft = Craft(perfect(parameters=bare, rotor_drag=RotorDrag()))
        craft.data.qvel[0] = v0 = 5.0
        seen = []
        for _ in range(1000):
            craft.plant.advance(1)
            # a rig keeps it level and at its height
            craft.data.qpos[3:7], craft.data.qvel[1:6] = (1, 0, 0, 0), 0.0
            craft.data.act[:] = craft.data.ctrl[:] = X4.hover
            seen.append(craft.data.qvel[0])
        craft.close()
        tau = X4.mass_kg / (0.62 * b / R * 4 * np.sqrt(X4.hover))
        assert -1.0 / np.log(seen[-1] / v0) == pytest.approx(tau, rel=0.005)

    def test_the_drag_in_a_wind_is_that_of_flapping_and_as_much_again(self):
        """By the model file's own derivation .43 N of flapping at 5 m/s; and the body keeps its
        share of the air's drag.
        """
        craft = Craft(perfect(rotor_drag=RotorDrag()))
        craft.model.opt.wind[0] = 5.0
        craft.plant.advance(1)
        force, torque = craft.data.qfrc_applied[0], craft.data.qfrc_applied[4]
        mujoco.mj_forward(craft.model, craft.data)
        whole = X4.mass_kg * craft.data.qacc[0]
        craft.close()
        assert force == pytest.approx(2 * 0.43, rel=0.02)
        assert torque == pytest.approx(force * ROTOR_M, rel=1e-6)
        assert whole - force == pytest.approx(0.55 * 0.5 * 1.184 * 0.10 * 25, rel=0.02)


ROTORS = """
<mujoco><option gravity="0 0 0" timestep="1e-4"/><worldbody><body name="base"><freejoint/>
<inertial pos="0 0 0" mass="4" diaginertia=".082 .082 .149"/>{}</body></worldbody>
<actuator>{}</actuator></mujoco>"""
ONE = """<body name="r{0}"><joint name="j{0}" axis="0 0 1"/>
<inertial pos="0 0 0" mass="1e-6" diaginertia="{1} {1} {2}"/></body>"""


class TestInertia:
    """Against MuJoCo's own mechanics of a body with four real rotors on hinges."""

    @staticmethod
    def real(rates: np.ndarray, gains: np.ndarray) -> np.ndarray:
        """Angular acceleration (3,) of a body with rates (3,) whose rotors have SPEEDS and gain
        speed (4,) [rad/s^2].
        """
        J = X4_ROTOR
        model = mujoco.MjModel.from_xml_string(
            ROTORS.format(
                "".join(ONE.format(i, J / 2, J) for i in range(4)),
                "".join(f'<motor name="m{i}" joint="j{i}"/>' for i in range(4)),
            )
        )
        data = mujoco.MjData(model)
        sense = np.array([1, -1, 1, -1])
        data.qvel[3:6], data.qvel[6:] = rates, sense * SPEEDS
        data.ctrl[:] = J * sense * gains
        mujoco.mj_forward(model, data)
        return data.qacc[3:6].copy()

    def lumped(self, rates: np.ndarray, gains: np.ndarray) -> np.ndarray:
        """The same of a craft with the block `rotor_inertia`."""
        craft = Craft(
            perfect(rotor_inertia=RotorInertia(), parameters=replace(X4, rotor_lag_s=0.117))
        )
        (on_base,) = craft.plant._actors.all
        craft.data.qvel[3:6], craft.data.act[:] = rates, SPEEDS**2
        orders = SPEEDS**2 + 2 * X4.rotor_lag_s * SPEEDS * gains  # dW/dt = 2 w dw/dt
        on_base.driven(tuple(orders.tolist()), 0.001)
        torque = on_base.force[3:6].copy()
        craft.close()
        inertia = np.array(X4.inertia)
        return (torque - np.cross(rates, inertia * rates)) / inertia

    def test_torques_are_those_of_rotors_that_really_spin(self):
        for rates, gains in (
            ((1, -2, 0.5), (0, 0, 0, 0)),
            ((0, 0, 0), (100, -50, 80, -20)),
            ((2, 1, -1), (50, 50, 0, 0)),
        ):
            rates, gains = np.array(rates, dtype=float), np.array(gains, dtype=float)
            np.testing.assert_allclose(
                self.lumped(rates, gains), self.real(rates, gains), rtol=0.005, atol=2e-3
            )


class TestBattery:
    def test_rotors_reach_their_order_times_the_voltage_squared(self):
        battery = Battery(charge=0.1)
        craft = Craft(perfect(battery=battery))
        craft.fly(1.0)
        reached, share = craft.data.ctrl.mean(), battery.share_at_start(X4)
        ordered = np.mean(craft.plant._memory.W)
        height, volts = craft.data.qpos[2], craft.plant.reading().voltage_v
        craft.close()
        assert share < 0.95
        assert reached / ordered == pytest.approx(share, rel=0.002)
        assert abs(height - 10) < 0.02  # it starts in trim
        current = battery.power((np.sqrt(X4.hover),) * 4, X4) / volts
        spent = current * 1.0 / 3600 / battery.capacity_ah
        assert volts == pytest.approx(
            battery.open_voltage(0.1 - spent) - battery.resistance_ohm * current, abs=2e-3
        )

    def test_an_empty_one_does_not_carry_it(self):
        # for a second and a half
        craft = Craft(perfect(battery=Battery(charge=0.05, capacity_ah=0.2)))
        craft.fly(3.0)
        sunk = craft.data.qvel[2]
        craft.close()
        assert sunk < -0.5


class TestMotors:
    def test_the_weaker_rotor_of_a_pair_turns_faster_by_as_much(self):
        craft = Craft(
            perfect(motors=MotorSpread(thrust=(1.04, 1.02, 0.96, 1.0), limit=(1, 1, 1, 1)))
        )
        craft.fly(6.0)
        front, right, back, left = np.mean(craft.fly(0.5, each=lambda: craft.W.copy()), axis=0)
        craft.close()
        assert front / back == pytest.approx(0.96 / 1.04, rel=0.005)
        assert right / left == pytest.approx(1.0 / 1.02, rel=0.005)
        assert front + back == pytest.approx(right + left, rel=0.002)  # no yaw torque
        assert b * (1.04 * front + 1.02 * right + 0.96 * back + left) == pytest.approx(
            WEIGHT, rel=0.005
        )

    def test_a_limit_of_its_own(self):
        craft = Craft(perfect(motors=MotorSpread(thrust=(1, 1, 1, 1), limit=(1, 0.8, 1, 1))))
        # a climb takes all rotors to their limits at first
        craft.fly(0.3, np.array([0, 0, 1.0, 0]))
        most = np.max(
            craft.fly(0.3, np.array([0, 0, 1.0, 0]), each=lambda: craft.data.ctrl.copy()), axis=0
        )
        craft.close()
        assert most[1] <= 0.8 * X4.limit + 1e-6


class TestVibration:
    def test_the_accelerometer_shows_tones_at_the_rotors_frequency_and_at_that_of_the_blades(self):
        craft = Craft(
            Quadrotor(
                realism="none",
                imu=QUIET,
                vibration={  # pyright: ignore[reportArgumentType] - a block
                    "accel_sigma_mps2": 0,
                    "gyro_sigma_radps": 0,
                },
            )
        )
        forces = np.array(
            craft.fly(2.0, each=lambda: craft.plant._sensors.read(craft.plant._steps).force)
        )
        speed = np.sqrt(craft.W.mean()) / (2 * np.pi)
        craft.close()
        spectrum = np.abs(
            np.fft.rfft((forces - forces.mean(0)) * np.hanning(len(forces))[:, None], axis=0)
        )
        peaks = np.fft.rfftfreq(len(forces), 0.001)[20 + spectrum[20:].argmax(axis=0)]
        assert peaks == pytest.approx([speed, speed, 2 * speed], abs=1.0)


def test_blocks_without_strength_change_nothing():
    off = Quadrotor(
        ground_effect=GroundEffect(strength=0),
        rotor_drag=RotorDrag(coefficient=0, body_share=1),
        downwash=Downwash(turbulence=0),
        motors=MotorSpread(thrust_sigma=0, limit_sigma=0),
    )
    ends = []
    for robot in (Quadrotor(), off):
        craft = Craft(robot, (0, 0, 0.4))
        craft.fly(0.5, np.array([0.5, 0, -0.1, 0.2]))
        ends.append(craft.data.qpos.copy())
        craft.close()
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-9)


def test_a_push_by_a_person_stays():
    """Both act at once: the push is in a field of its own."""
    craft = Craft(perfect(ground_effect=GroundEffect()), (0, 0, 0.3))
    craft.plant.push(np.array([3.0, 0, 0]), 0.2)
    craft.fly(0.1)
    pushed = craft.data.xfrc_applied.copy()
    craft.close()
    assert pushed.max() == 3.0 and np.count_nonzero(pushed) == 1
