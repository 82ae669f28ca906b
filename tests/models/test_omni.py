"""models/omni.xml and omni_planar.xml: figures against their sources, weight on the rollers,
motions reached, slip on ice, rest.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.shortcuts import one_quick
from vstestbed.core.geometry import Pose
from vstestbed.core.planar import motion_between, moved, place_of
from vstestbed.robots.omni import PLATFORM, ROLLERS, SIDES, WHEELS, Omni

MODELS = Path(__file__).parents[2] / "models"
STEP = 0.002
MASS, G = 8.0, 9.81
DRY, ICE = 1.0, 0.05
MOTIONS = [
    (0.5, 0.0, 0.0),
    (-0.3, 0.0, 0.0),
    (0.0, 0.5, 0.0),
    (0.0, 0.0, 1.0),
    (0.3, 0.2, 0.5),
    (0.2, -0.3, -0.8),
    (0.05, 0.0, 0.0),
]


@cache
def compose(wheels: str, friction: float = DRY) -> mujoco.MjModel:
    """The base on the world's floor with the options that it wants, no contact more slippery than
    `friction` allows.
    """
    world = mujoco.MjSpec.from_file(str(MODELS / "world.xml"))
    base = mujoco.MjSpec.from_file(
        str(MODELS / {"rollers": "omni.xml", "planar": "omni_planar.xml"}[wheels])
    )
    world.option.timestep = STEP
    world.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    world.option.impratio = 10
    world.option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    world.attach(base, prefix="robot/", frame=world.worldbody.add_frame())
    for geom in world.geoms:
        geom.friction[0] = min(geom.friction[0], friction)
    return world.compile()


def mass_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """M (nv, nv), by its action on unit vectors."""
    M = np.zeros((model.nv, model.nv))
    for i, unit in enumerate(np.eye(model.nv)):
        mujoco.mj_mulM(model, data, M[i], unit)
    return M


@dataclass
class Drive:
    """The base in its world, with eyes for what no robot knows."""

    model: mujoco.MjModel
    data: mujoco.MjData

    @classmethod
    def at_rest(cls, wheels: str, friction: float = DRY) -> "Drive":
        """On its wheels, settled."""
        model = compose(wheels, friction)
        drive = cls(model, mujoco.MjData(model))
        drive.run(0.3)
        return drive

    def order(self, motion) -> None:
        self.data.ctrl[:] = PLATFORM.W @ np.asarray(motion, dtype=float)

    def run(self, duration: float) -> None:
        mujoco.mj_step(self.model, self.data, round(duration / STEP))
        mujoco.mj_kinematics(self.model, self.data)

    @property
    def pose(self) -> np.ndarray:
        """(x, y, heading)."""
        body = self.data.body("robot/base")
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = body.xmat.reshape(3, 3), body.xpos
        return place_of(T)

    @property
    def motion(self) -> np.ndarray:
        """(vx, vy, wz) of the frame on the floor, in its own axes."""
        v = np.zeros(6)
        site = self.model.site("robot/flange").id
        mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_SITE, site, v, 1)
        return v[[3, 4, 2]]

    @property
    def wheels(self) -> np.ndarray:
        """Angles of the wheels."""
        return np.array([self.data.joint(f"robot/{name}").qpos[0] for name in WHEELS])

    def load(self) -> float:
        """Sum of the normal forces of all contacts [N]."""
        force, total = np.zeros(6), 0.0
        for i in range(self.data.ncon):
            mujoco.mj_contactForce(self.model, self.data, i, force)
            total += force[0]
        return total

    def mean_motion(self, motion, duration: float = 1.0) -> np.ndarray:
        """The constant motion that leads from where it is to where it gets in this time, once it is
        under way.
        """
        self.order(motion)
        self.run(0.5)  # ten times the speed loop's delay of 40 ms
        before = self.pose
        self.run(duration)
        return motion_between(before, self.pose, duration)


@pytest.fixture(params=["rollers", "planar"])
def wheels(request) -> str:
    return request.param


class TestFigures:
    def test_mass_and_inertia_of_both(self):
        inertia = []
        for kind in ("rollers", "planar"):
            model = compose(kind)
            data = mujoco.MjData(model)
            mujoco.mj_forward(model, data)
            root = model.body("robot/base").id
            assert model.body_subtreemass[root] == pytest.approx(MASS, abs=1e-12)
            np.testing.assert_allclose(data.subtree_com[root][:2], 0, atol=1e-12)
            yaw = 5 if kind == "rollers" else 2
            inertia.append(mass_matrix(model, data)[yaw, yaw] - model.dof_armature[yaw])
        assert inertia[0] == pytest.approx(inertia[1], rel=1e-12)

    def test_wheels_stand_where_the_kinematics_have_them(self, wheels):
        model = compose(wheels)
        for name, place in zip(WHEELS, PLATFORM.places, strict=True):
            np.testing.assert_allclose(
                model.body(f"robot/{name}").pos, [*place, PLATFORM.wheel_radius_m], atol=1e-12
            )

    def test_rollers_are_nine_a_wheel_and_of_the_right_hand(self):
        model = compose("rollers")
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        for name, side in zip(WHEELS, SIDES, strict=True):
            axes = [data.joint(f"robot/{name}_roller{i}").xaxis for i in range(ROLLERS)]
            np.testing.assert_allclose(
                axes[0] * np.sign(axes[0][0]), np.array([1, side, 0]) / np.sqrt(2), atol=1e-12
            )
            # 45 degrees to the axle
            np.testing.assert_allclose(np.abs([a[1] for a in axes]), np.sqrt(0.5), atol=1e-12)
        with pytest.raises(KeyError):
            model.joint(f"robot/front_left_roller{ROLLERS}")

    def test_a_wheel_of_barrels_is_round_to_a_tenth_of_a_millimetre(self):
        b, _, a = compose("rollers").geom("robot/front_left_roller0").size[[0, 1, 2]]
        d = -compose("rollers").body("robot/front_left_roller0").pos[2]
        phi = np.linspace(-np.pi / ROLLERS, np.pi / ROLLERS, 1001)
        H = d * np.cos(phi) + np.sqrt(b**2 + (a**2 - b**2) * np.sin(phi) ** 2 / 2)
        assert H[500] == pytest.approx(PLATFORM.wheel_radius_m, abs=1e-9)
        # a is written to the micrometre
        assert H[0] == pytest.approx(PLATFORM.wheel_radius_m, abs=1e-7)
        assert np.ptp(H) < 0.1e-3

    def test_gears_of_the_planar_one_are_the_kinematics(self):
        model = compose("planar")
        # written with five decimals
        np.testing.assert_allclose(model.actuator_gear[:, [0, 1, 5]], PLATFORM.W, atol=5e-5)
        np.testing.assert_array_equal(model.actuator_gear[:, 2:5], 0)

    def test_the_planar_one_carries_its_wheels_spin(self):
        rollers, planar = compose("rollers"), compose("planar")
        data = mujoco.MjData(rollers)
        mujoco.mj_forward(rollers, data)
        dof = rollers.joint("robot/front_left").dofadr[0]
        reflected = PLATFORM.W.T @ PLATFORM.W * mass_matrix(rollers, data)[dof, dof]
        np.testing.assert_allclose(reflected - np.diag(np.diag(reflected)), 0, atol=1e-12)
        # x and y share their mean; all written to three digits.
        want = [*[(reflected[0, 0] + reflected[1, 1]) / 2] * 2, reflected[2, 2]]
        np.testing.assert_allclose(planar.dof_armature, want, rtol=5e-3)

    def test_servos(self, wheels):
        model = compose(wheels)
        assert [model.actuator(i).name for i in range(model.nu)] == [
            f"robot/{name}" for name in WHEELS
        ]
        np.testing.assert_array_equal(
            model.actuator_ctrlrange,
            np.tile([-PLATFORM.wheel_speed_radps, PLATFORM.wheel_speed_radps], (4, 1)),
        )
        np.testing.assert_array_equal(model.actuator_forcerange, np.tile([-2.0, 2.0], (4, 1)))

    def test_only_rollers_and_chassis_can_touch_and_only_the_floor(self):
        model = compose("rollers")
        floor = model.geom("floor").id
        can = {
            model.geom(i).name for i in range(model.ngeom) if model.geom_contype[i] and i != floor
        }
        assert can == {"robot/chassis"} | {
            f"robot/{name}_roller{i}" for name in WHEELS for i in range(ROLLERS)
        }
        assert not model.geom_conaffinity[np.arange(model.ngeom) != floor].any()
        assert not compose("planar").geom_contype[1:].any()

    def test_colours_are_no_markers(self, wheels):
        rgb = compose(wheels).mat_rgba[:, :3]
        assert np.all(np.ptp(rgb, axis=1) < 0.18)


def test_its_ends_are_what_scenarios_are_checked_against(wheels):
    """By the compiled boxes round all geoms; the rollers' reach depends by .6 mm on how the wheels
    stand.
    """
    model = compose(wheels)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    own = np.flatnonzero(model.geom_bodyid > 0)
    R = data.geom_xmat[own].reshape(-1, 3, 3)
    middle = data.geom_xpos[own] + np.einsum("nij,nj->ni", R, model.geom_aabb[own, :3])
    half = np.einsum("nij,nj->ni", np.abs(R), model.geom_aabb[own, 3:])
    assert ((middle - half)[:, 0].min(), (middle + half)[:, 0].max()) == pytest.approx(
        Omni().ends_m, abs=1.5e-3
    )
    assert Omni().top_speed_mps == pytest.approx(PLATFORM.wheel_speed_radps / PLATFORM.W[0, 0])


class TestView:
    """A camera of 136 degrees (f = 200 px on 1000 x 1000) at (.2, .1, .3) of the base sees nothing
    of it.
    """

    RPY = pytest.mark.parametrize(
        "rpy_deg",
        [(-90, 0, -90), (-45, 0, -90), (0, 0, 0)],
        ids=["forward", "forward and up", "up"],
    )

    @RPY
    def test_nothing_stands_before_the_camera(self, wheels, rpy_deg):
        model = compose(wheels)
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        T = Pose(xyz=(0.2, 0.1, 0.3), rpy_deg=rpy_deg).T
        # Rays through the picture's frame and a grid inside it.
        u, v = (
            a.ravel() / 200
            for a in np.meshgrid(np.linspace(-500, 500, 41), np.linspace(-500, 500, 41))
        )
        rays = np.stack([u, v, np.ones_like(u)], axis=1) @ T[:3, :3].T
        geom, hit = np.zeros(1, dtype=np.int32), set()
        for ray in rays / np.linalg.norm(rays, axis=1, keepdims=True):
            if mujoco.mj_ray(model, data, T[:3, 3], ray, None, 1, -1, geom) >= 0:
                hit.add(model.geom(int(geom[0])).name)
        assert hit <= {"floor"}


class TestWeight:
    def test_at_rest(self):
        drive = Drive.at_rest("rollers")
        drive.run(1.0)
        # Static equilibrium: what is left of settling after 1.3 s.
        assert drive.load() == pytest.approx(MASS * G, rel=1e-3)
        assert drive.data.ncon == 4

    @pytest.mark.parametrize("motion", [(0.5, 0.0, 0.0), (0.0, 0.5, 0.0), (0.3, 0.2, 0.5)])
    def test_on_the_way(self, motion):
        drive = Drive.at_rest("rollers")
        drive.order(motion)
        drive.run(0.5)
        loads = []
        for _ in range(500):
            drive.run(STEP)
            loads.append(drive.load())
        # The mean over a second, since a base that does not rise is carried; single values bounce
        # as rollers take over.
        assert np.mean(loads) == pytest.approx(MASS * G, rel=0.01)


class TestMotions:
    @pytest.mark.parametrize("motion", MOTIONS)
    def test_are_reached(self, wheels, motion):
        got, motion = Drive.at_rest(wheels).mean_motion(motion), np.array(motion)
        # Measured: single motions .1 %, combined .6 % (rollers: wheels disagree and slip; planar:
        # proportional loops against the centripetal force, .9 %). Asked: 3 %. In print's kinematics
        # sideways motions would be 2 % short.
        asked = motion != 0
        np.testing.assert_allclose(got[asked], motion[asked], rtol=0.012)
        # What is not asked for: 2 mm/s and 2 mrad/s, or it would not go straight.
        np.testing.assert_allclose(got[~asked], 0, atol=2e-3)

    def test_a_mix_with_a_larger_slip(self):
        # 40 random mixes: median .5 %, nine in ten under 1.1 %
        motion = np.array([0.3, -0.2, -0.3])
        got = Drive.at_rest("rollers").mean_motion(motion)
        assert 0.008 < np.abs(got / motion - 1).max() < 0.016  # 1.3 % in yaw

    @pytest.mark.parametrize(
        "motion", [(0.5, 0.0, 0.0), (0.0, 0.5, 0.0), (0.0, 0.0, 1.0), (0.3, 0.2, 0.5)]
    )
    def test_ripple(self, motion):
        drive = Drive.at_rest("rollers")
        drive.order(motion)
        drive.run(0.5)
        seen = []
        for _ in range(500):
            drive.run(STEP)
            seen.append(drive.motion)
        asked = np.array(motion) != 0
        ripple = np.std(seen, axis=0)[asked] / np.abs(motion)[asked]
        # Measured .2 % forward, 1.3 % sideways (kappa), up to 1.9 % in yaw, where the point of
        # contact wanders along the rollers.
        assert ripple.max() < (0.005 if motion[1:] == (0.0, 0.0) else 0.03)
        assert np.ptp(seen, axis=0).max() > 0  # it is a wheel of rollers, not a formula

    @pytest.mark.parametrize("motion", [(0.5, 0.0, 0.0), (0.0, 0.5, 0.0)])
    def test_a_straight_line_is_straight(self, motion):
        drive = Drive.at_rest("rollers")
        drive.order(motion)
        drive.run(4.0)
        way, heading = drive.pose[:2], drive.pose[2]
        along = np.array(motion[:2]) / 0.5
        assert way @ along > 1.9
        # Wheels and rollers are symmetric: 1 mm and 1 mrad in 2 m leave room for rounding that
        # contacts amplify.
        assert abs(way @ [-along[1], along[0]]) < 1e-3
        assert abs(heading) < 1e-3

    def test_the_planar_actuators_feel_the_wheels_speeds(self):
        drive = Drive.at_rest("planar")
        drive.order((0.3, -0.2, 0.5))
        drive.run(0.317)
        mujoco.mj_forward(drive.model, drive.data)
        # gears: five decimals
        np.testing.assert_allclose(
            drive.data.actuator_velocity, PLATFORM.W @ drive.motion, atol=1e-4
        )

    @pytest.mark.parametrize("motion", [(0.3, 0.0, 0.0), (0.0, 0.0, 1.5)])
    def test_both_start_alike(self, motion):
        axis, late = int(np.argmax(np.abs(motion))), {}
        for kind in ("rollers", "planar"):
            drive = Drive.at_rest(kind)
            drive.order(motion)
            drive.run(0.5)
            late[kind] = 0.5 - drive.pose[axis] / motion[axis]
        # How much later the base is than its orders: kv / kp = 40 ms, and as much by choice for the
        # planar one.
        assert late["rollers"] == pytest.approx(0.040, abs=0.003)
        assert late["planar"] == pytest.approx(0.040, abs=0.004)


class TestSlip:
    @staticmethod
    def dash(friction: float, motion) -> tuple[np.ndarray, np.ndarray]:
        """A second from rest: where the base got to, and where its encoders say, read at 25 Hz."""
        drive = Drive.at_rest("rollers", friction)
        start = told = drive.pose
        angles = drive.wheels
        drive.order(motion)
        for _ in range(25):
            drive.run(0.04)
            told, angles = (
                moved(told, PLATFORM.W_inverse @ (drive.wheels - angles) / 0.04, 0.04),
                drive.wheels,
            )
        return drive.pose - start, told - start

    def test_on_a_dry_floor_a_gentle_start_is_told_truly(self):
        true, told = self.dash(DRY, (0.3, 0.0, 0.0))
        # .3 m/s in 60 ms is 5 m/s^2, half of what friction 1 gives: measured 1 mm of 288.
        assert told[0] == pytest.approx(true[0], rel=0.01)

    @pytest.mark.parametrize(
        ("motion", "axis", "share"),
        [((0.9, 0.0, 0.0), 0, (1.0, 1.3)), ((0.0, 0.8, 0.0), 1, (0.7, 1.0))],
    )
    def test_on_ice_the_wheels_spin_and_the_encoders_do_not_know(self, motion, axis, share):
        true, told = self.dash(ICE, motion)
        # 40 ms late, as commanded
        assert told[axis] == pytest.approx(0.96 * motion[axis], rel=0.01)
        # A spinning wheel's rollers take all friction along their axles, of which cos 45 degrees is
        # forward or sideways. What spins rollers up, and their bearings, take a part f = .15 to .18
        # of it across: with the other half forward, against it sideways.
        ideal = ICE * G / np.sqrt(2) * 0.96**2 / 2
        assert share[0] * ideal < true[axis] < share[1] * ideal

    def test_ice_takes_long_to_get_going(self):
        drive = Drive.at_rest("rollers", ICE)
        drive.order((0.5, 0.0, 0.0))
        drive.run(0.5)
        assert drive.motion[0] < 0.25
        drive.run(3.0)
        assert drive.motion[0] == pytest.approx(0.5, rel=0.03)


class TestRest:
    def test_it_stays(self, wheels):
        drive = Drive.at_rest(wheels)
        before = drive.pose
        drive.run(5.0)
        np.testing.assert_allclose(drive.pose, before, atol=1e-6)

    @pytest.mark.parametrize("seed", one_quick(*range(3)))
    def test_it_stays_where_it_stopped_between_rollers(self, seed):
        drive = Drive.at_rest("rollers")
        rng = np.random.default_rng(seed)
        for _ in range(4):
            # four speeds that no motion has
            drive.data.ctrl[:] = rng.uniform(
                -PLATFORM.wheel_speed_radps, PLATFORM.wheel_speed_radps, 4
            )
            drive.run(0.3)
        drive.data.ctrl[:] = 0
        drive.run(1.5)
        before = drive.pose
        drive.run(5.0)
        # Asked: 1 mm. Measured .1 mm: wheels are held, while strained rollers give way slowly.
        assert np.linalg.norm(drive.pose[:2] - before[:2]) < 0.5e-3
        assert not drive.data.warning.number.any()
