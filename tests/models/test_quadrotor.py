"""models/quadrotor.xml: rotors, drag, wind, feet and sensors against closed forms, the loops left
out.
"""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from vstestbed.robots.quadrotor import STANDING_M, Quadrotor
from vstestbed.robots.rotors import X4

MODELS = Path(__file__).parents[2] / "models"
G, AIR, DRAG_AREA = 9.81, 1.184, 0.100  # [m/s^2], [kg/m^3], Cd A [m^2] as the file says
NAMES = Quadrotor().body.actuators
STEPS = (0.0005, 0.001)


def compose(density: float = AIR, timestep: float = 0.001, gravity: float = G) -> mujoco.MjModel:
    """The craft in the world under `robot/`."""
    world = mujoco.MjSpec.from_file(str(MODELS / "world.xml"))
    craft = mujoco.MjSpec.from_file(str(MODELS / "quadrotor.xml"))
    for spec in (world, craft):
        spec.option.timestep, spec.option.density, spec.option.gravity = (
            timestep,
            density,
            [0, 0, -gravity],
        )
    world.attach(craft, prefix="robot/", frame=world.worldbody.add_frame())
    return world.compile()


def at(model: mujoco.MjModel, height: float, W: float = 0.0) -> mujoco.MjData:
    """Level at a height, its rotors turning at W = w^2 and told to go on so."""
    data = mujoco.MjData(model)
    data.qpos[:3] = [0, 0, height]
    data.act[:] = data.ctrl[:] = W
    mujoco.mj_forward(model, data)
    return data


def run(model: mujoco.MjModel, data: mujoco.MjData, duration: float) -> None:
    """Let time pass [s]."""
    for _ in range(round(duration / model.opt.timestep)):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)


@pytest.fixture(scope="module")
def vacuum() -> mujoco.MjModel:
    return compose(density=0)


@pytest.fixture(scope="module")
def air() -> mujoco.MjModel:
    return compose()


class TestFigures:
    def test_the_file_and_the_flight_stack_are_one(self, air):
        base = air.body("robot/base").id
        assert air.body_mass[base] == X4.mass_kg
        np.testing.assert_allclose(air.body_inertia[base], X4.inertia, rtol=1e-12)
        np.testing.assert_allclose(air.actuator_dynprm[:, 0], X4.rotor_lag_s, rtol=1e-12)
        np.testing.assert_allclose(air.actuator_ctrlrange, [[0, X4.limit]] * 4, rtol=1e-12)
        np.testing.assert_allclose(air.actuator_gear[:, 2], X4.thrust_coefficient, rtol=1e-12)
        np.testing.assert_allclose(
            air.actuator_gear[:, 5], np.array([-1, 1, -1, 1]) * X4.drag_coefficient, rtol=1e-12
        )
        assert [air.actuator(i).name for i in range(air.nu)] == [f"robot/{name}" for name in NAMES]
        places = [air.site(f"robot/{name}").pos[:2] for name in NAMES]
        np.testing.assert_allclose(
            places, X4.arm_m * np.array([[1, 0], [0, -1], [-1, 0], [0, 1]]), atol=1e-12
        )

    def test_the_lag_is_that_of_a_motor_with_efficiency_point_8(self):
        k_w0 = X4.drag_coefficient * 861
        # Three digits are written.
        assert 6.49e-5 / (k_w0 * (2 + 0.8 / 0.2)) == pytest.approx(X4.rotor_lag_s, rel=0.005)

    def test_looks_are_grey_and_what_encloses_the_lens_is_in_group_1(self, air):
        rgb = air.mat_rgba[:, :3]
        assert np.all(rgb.max(axis=1) - rgb.min(axis=1) < 0.18)
        data = at(air, 2.0)
        lens = data.site("robot/flange").xpos
        shown = [g for g in range(air.ngeom) if air.geom_bodyid[g] and air.geom_matid[g] >= 0]
        near = [g for g in shown if np.linalg.norm(data.geom_xpos[g] - lens) < 0.03]
        assert near and all(air.geom_group[g] == 1 for g in near)

    def test_the_range_finder_draws_no_ray(self, air):
        assert air.vis.rgba.rangefinder[3] == 0  # by default it is yellow, as a marker may be

    def test_nothing_but_legs_stands_below_the_lens(self, air):
        # A ray every 2 degrees of azimuth and colatitude, up to 80 degrees off the downward axis,
        # on the craft's own geoms.
        data = at(air, 50.0)
        groups = np.array([0, 0, 1, 0, 0, 0], dtype=np.uint8)
        hit, geom = set(), np.array([-1], dtype=np.int32)
        for theta in np.radians(np.arange(0, 80, 2)):
            for phi in np.radians(np.arange(0, 360, 2)):
                ray = np.array(
                    [np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), -np.cos(theta)]
                )
                mujoco.mj_ray(air, data, data.qpos[:3], ray, groups, 0, -1, geom)
                if geom[0] >= 0:
                    hit.add(air.geom(int(geom[0])).name.split("/")[1].split("_")[0])
                    assert np.degrees(theta) > 50  # the feet: atan(.22 / .16) less their own radius
        assert hit <= {"leg", "foot"}


class TestRotors:
    def test_861_rad_per_s_carry_the_weight(self, vacuum):
        data = at(vacuum, 2.0, 861.0**2)
        # Half a per cent is the claim; the printed figures give .01 %.
        assert data.qfrc_actuator[2] == pytest.approx(4 * G, rel=0.005)
        run(vacuum, data, 1.0)
        assert abs(data.qpos[2] - 2.0) < 0.5 * 0.0005 * G

    def test_full_speed_lifts_135_per_cent(self, vacuum):
        assert at(vacuum, 2.0, 1e6).qfrc_actuator[2] / (4 * G) == pytest.approx(1.35, abs=0.005)

    @pytest.mark.parametrize("i", range(4))
    def test_one_rotor(self, vacuum, i):
        """Thrust b w^2 up at its place, drag torque against its spin, 8.08 mm times the thrust."""
        data = at(vacuum, 2.0)
        data.act[i] = 500.0**2
        mujoco.mj_forward(vacuum, data)
        force, torque = data.qfrc_actuator[:3], data.qfrc_actuator[3:]
        thrust = 1.3234e-5 * 500**2
        np.testing.assert_allclose(force, [0, 0, thrust], atol=1e-9)
        x, y = [(0.315, 0), (0, -0.315), (-0.315, 0), (0, 0.315)][i]
        np.testing.assert_allclose(torque[:2], [y * thrust, -x * thrust], atol=1e-9)
        assert abs(torque[2]) / thrust == pytest.approx(8.08e-3, abs=5e-6)  # three digits
        # front and back spin anticlockwise and push the body clockwise
        assert np.sign(torque[2]) == (-1, 1, -1, 1)[i]

    @pytest.mark.parametrize("timestep", STEPS)
    def test_lag_is_of_first_order_at_any_step(self, timestep):
        model = compose(density=0, timestep=timestep)
        data = at(model, 50.0, 861.0**2)
        data.ctrl[:] = 1e6
        for k in range(1, 400):
            mujoco.mj_step(model, data)
            share = (data.act[0] - 861.0**2) / (1e6 - 861.0**2)
            # `filterexact` is exact: rounding.
            assert share == pytest.approx(1 - np.exp(-k * timestep / 0.117), abs=1e-9)

    def test_orders_beyond_full_speed_or_below_zero_are_cut(self, vacuum):
        data = at(vacuum, 50.0, 861.0**2)
        data.ctrl[:] = [3e6, -1e6, 1e6, 0]
        run(vacuum, data, 2.0)
        # exp(-2 / .117) = 4e-8 is left of the start.
        np.testing.assert_allclose(data.act, [1e6, 0, 1e6, 0], atol=1)


class TestMotorsOff:
    def test_free_fall(self, vacuum):
        data = at(vacuum, 100.0)
        run(vacuum, data, 1.5)
        # Semi-implicit Euler: g t dt / 2 low, 7.4 mm.
        assert data.qpos[2] - 100 == pytest.approx(-G * 1.5 * (1.5 + 0.001) / 2, abs=1e-9)
        # falling feels nothing
        np.testing.assert_allclose(data.sensor("robot/accelerometer").data, 0, atol=1e-9)

    @pytest.mark.parametrize("timestep", STEPS)
    def test_a_tumble_keeps_momentum_and_energy(self, timestep):
        """No gravity, no air: momentum exactly; spin and its energy but for the integrator, whose
        error is of first order in the step.
        """
        model = compose(density=0, timestep=timestep, gravity=0)
        data, J = at(model, 100.0), np.array([0.082, 0.082, 0.149])
        data.qvel[:] = [1, -2, 0.5, 3, 0.2, 2]

        def spin() -> np.ndarray:
            return data.body("robot/base").xmat.reshape(3, 3) @ (J * data.qvel[3:])

        def energy() -> float:
            return 0.5 * float(J @ data.qvel[3:] ** 2)

        mujoco.mj_forward(model, data)
        spin0, energy0 = spin(), energy()
        run(model, data, 2.0)
        np.testing.assert_allclose(data.qvel[:3], [1, -2, 0.5], atol=1e-12)
        # Measured over 2 s: 1.3 and 3.0 times the step, at .5, 1 and 2 ms alike.
        assert np.linalg.norm(spin() - spin0) < 2 * timestep * np.linalg.norm(spin0)
        assert energy() == pytest.approx(energy0, rel=4 * timestep)

    def test_energy_of_a_fall_without_air(self, vacuum):
        data = at(vacuum, 100.0)
        data.qvel[:] = [1, -2, 0.5, 3, 0.2, 2]
        mujoco.mj_energyPos(vacuum, data)
        mujoco.mj_energyVel(vacuum, data)
        before = data.energy.sum()
        run(vacuum, data, 1.5)
        mujoco.mj_energyPos(vacuum, data)
        mujoco.mj_energyVel(vacuum, data)
        # m g (g t dt / 2) = .29 J of 3932 J by the step, as in free fall.
        assert data.energy.sum() == pytest.approx(before, abs=0.4)


class TestAir:
    def test_a_fall_ends_at_its_terminal_speed(self, air):
        data = at(air, 1000.0)
        run(air, data, 15.0)
        terminal = np.sqrt(2 * 4 * G / (AIR * DRAG_AREA))
        # Cd A is written to 3 digits
        assert data.qvel[2] == pytest.approx(-terminal * np.tanh(G * 15 / terminal), rel=0.002)

    @pytest.mark.parametrize("wind", [(5, 0, 0), (-3, 4, 0), (0, 0, 6), (1, 2, 2)])
    def test_wind_pushes_as_drag_says(self, wind):
        model = compose()
        model.opt.wind[:] = wind
        data = at(model, 10.0, X4.hover)
        speed = np.linalg.norm(wind)
        force = 0.5 * AIR * DRAG_AREA * speed * np.array(wind)
        np.testing.assert_allclose(data.qfrc_passive[:3], force, rtol=0.002, atol=1e-6)
        # at the centre of mass: it does not turn the craft
        np.testing.assert_allclose(data.qfrc_passive[3:], 0, atol=1e-6)
        np.testing.assert_allclose(data.qacc[:3], force / 4, rtol=0.002, atol=1e-6)

    def test_five_metres_per_second_ask_for_two_degrees(self):
        lean = np.degrees(np.arctan(0.5 * AIR * DRAG_AREA * 25 / (4 * G)))
        assert lean == pytest.approx(2.2, abs=0.1)

    def test_drag_follows_the_air_not_the_ground(self):
        model = compose()
        model.opt.wind[:] = [4, 0, 0]
        data = at(model, 10.0, X4.hover)
        data.qvel[0] = 4
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qfrc_passive, 0, atol=1e-9)


class TestGround:
    def test_it_lands_on_its_feet_and_does_not_bounce(self, air):
        data = at(air, STANDING_M + 0.05)
        heights = []
        for _ in range(1500):
            mujoco.mj_step(air, data)
            heights.append(float(data.qpos[2]))
        low = int(np.argmin(heights))
        # Falls from 5 cm (1 m/s), gives way by 7 mm, comes back to rest: nothing above it.
        assert STANDING_M - heights[low] < 0.012
        assert max(heights[low:]) < heights[-1] + 1e-4
        assert heights[-1] == pytest.approx(STANDING_M, abs=0.0005)
        touching = {air.geom(int(g)).name for contact in data.contact for g in contact.geom}
        assert touching == {
            "floor",
            *(f"robot/foot_{side}" for side in ("front", "right", "back", "left")),
        }
        assert np.abs(data.qvel).max() < 1e-4

    def test_it_slides_no_farther_than_friction_lets_it(self, air):
        data = at(air, STANDING_M)
        run(air, data, 0.3)
        data.qvel[0] = 0.5
        run(air, data, 1.0)
        # v^2 / (2 mu g) = 16 mm, a little more on soft pyramids, less a foot's roll.
        assert 0.008 < data.qpos[0] < 0.025

    def test_on_its_back_it_lies_on_the_battery(self, air):
        data = at(air, 0.3)
        data.qpos[3:7] = [np.cos(1.2), np.sin(1.2), 0, 0]
        run(air, data, 2.0)
        assert data.qpos[2] == pytest.approx(0.08, abs=0.002)
        assert {air.geom(int(g)).name for contact in data.contact for g in contact.geom} == {
            "floor",
            "robot/battery",
        }

    def test_rotors_touch_a_wall(self, air):
        data = at(air, 0.30)
        # on edge, .315 + .165 m of rotor below the centre
        data.qpos[3:7] = [np.cos(np.pi / 4), np.sin(np.pi / 4), 0, 0]
        mujoco.mj_forward(air, data)
        assert {air.geom(int(g)).name for contact in data.contact for g in contact.geom} >= {
            "floor",
            "robot/disc_right",
        }


class TestSensors:
    def test_at_hover(self, vacuum):
        data = at(vacuum, 2.0, X4.hover)
        np.testing.assert_allclose(data.sensor("robot/accelerometer").data, [0, 0, G], atol=1e-6)
        np.testing.assert_allclose(data.sensor("robot/gyro").data, 0, atol=1e-12)
        # its own legs are left out
        assert data.sensor("robot/range").data[0] == pytest.approx(2.0, abs=1e-9)

    def test_in_body_axes(self, vacuum):
        data = at(vacuum, 3.0)
        data.qpos[3:7] = [np.cos(0.2), np.sin(0.2), 0, 0]
        data.qvel[:] = [0, 0, -1, 0.3, -0.2, 0.1]
        mujoco.mj_forward(vacuum, data)
        np.testing.assert_allclose(
            data.sensor("robot/velocity").data, [0, -np.sin(0.4), -np.cos(0.4)], atol=1e-12
        )
        np.testing.assert_allclose(data.sensor("robot/gyro").data, [0.3, -0.2, 0.1], atol=1e-12)
        assert data.sensor("robot/range").data[0] == pytest.approx(3.0 / np.cos(0.4), abs=1e-9)
