"""Strain wave gears against their catalogue, and the two arms that have them: springs, rotors,
eigenfrequencies.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.linalg import eigh

import vstestbed as vs
from tests.robots.arms import NEEDS_PANDA
from tests.sim.two_mass import arm, frequency, inertia, stage_of
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import Array
from vstestbed.effects.joints import CURVES, Gears, StrainWave, Torsion
from vstestbed.robots.base import needed_step
from vstestbed.robots.chain import reader

RATIO_30 = {
    8: (Torsion(0.29, 0.75, 340, 440, 540), 8.5, 19),
    11: (Torsion(0.80, 2.0, 840, 1300, 1600), 9.5, 19),
    14: (Torsion(2.0, 6.9, 1900, 2400, 3400), 10.5, 31),
    17: (Torsion(3.9, 12, 3400, 4400, 6700), 11.5, 30),
    20: (Torsion(7.0, 25, 5700, 7100, 11000), 12.3, 38),
    25: (Torsion(14, 48, 10000, 13000, 21000), 14, 40),
    32: (Torsion(29, 108, 24000, 30000, 49000), 12.1, 38),
}
"""Another table of the catalogue, of ratio 30, which prints the torsion at t1 and t2 as well [1e-4
rad].
"""


def free_links(robot: Any, q: Array, displaced: Array) -> tuple[Array, Array]:
    """Times and link positions (T, n) of 1 s before rotors that are held at q, without weight,
    servos and friction.
    """
    stage = stage_of(robot)
    model, data, at = stage.model, stage.data, stage.at
    model.opt.gravity[:] = 0.0
    model.actuator_gainprm[:], model.actuator_biasprm[:], model.dof_frictionloss[:] = 0.0, 0.0, 0.0
    model.dof_damping[at.qvel], model.dof_damping[at.motor_qvel] = 0.0, 1e9
    data.qpos[at.motor_qpos], data.qpos[at.qpos] = q, q + displaced
    rows = []
    for _ in range(round(1.0 / model.opt.timestep)):
        mujoco.mj_step(model, data)
        rows.append((data.time, *data.qpos[at.qpos]))
    stage.close()
    found = np.array(rows)
    return found[:, 0], found[:, 1:]


ARMS = ["arm_jaco", pytest.param("arm_panda", marks=NEEDS_PANDA)]


@pytest.mark.parametrize("size", RATIO_30)
def test_the_torsion_at_the_stages_ends_is_the_catalogues(size: int) -> None:
    curve, first, second = RATIO_30[size]
    # printed with two digits
    assert 1e4 * np.array(curve.bends) == pytest.approx([first, second], rel=0.03)


def test_one_number_stands_for_all_joints() -> None:
    found = vs.load("arm_jaco", {"robot.strain_wave": {"sizes": 14, "rotor_kgm2": 0.2}}).robot
    assert found.strain_wave == StrainWave(sizes=(14,), rotor_kgm2=(0.2,))


def test_a_stiffness_of_the_preset_does_not_hide_it() -> None:
    given = {"robot.realism": "field", "robot.strain_wave": {"sizes": [20, 20, 20, 0, 0, 0]}}
    with pytest.raises(
        ScenarioError,
        match=(
            r"is given by realism field and by strain_wave;"
            r" works: robot.gears.stiffness_nmprad=\[\]"
        ),
    ):
        vs.load("arm_ibvs", given)
    found = vs.load("arm_ibvs", given | {"robot.gears.stiffness_nmprad": []}).robot.elastic
    assert found is not None and found.stiffest[0] == 29000
    own = vs.load(
        "arm_ibvs", given | {"robot.gears.stiffness_nmprad": [4e3, 4e3, 4e3, 0, 0, 0]}
    ).robot.elastic
    assert own is not None and own.stiffest[0] == 4e3


def test_the_table_grows_with_the_size() -> None:
    table = np.array(list(CURVES.values()))
    assert (
        (np.diff(table, axis=0) > 0).all()
        and (table[:, 0] < table[:, 1]).all()
        and (np.diff(table[:, 2:], axis=1) > 0).all()
    )


class TestMechanics:
    def test_torsion_and_stiffness_follow_the_stages(self, tmp_path: Path) -> None:
        found = arm(tmp_path, gears=Gears(), strain_wave=StrainWave(sizes=(20, 0))).elastic
        assert found is not None and found.stiffest == pytest.approx([29000, 0])
        for torque, stiffness in ((1.0, 16000), (-20.0, 25000), (60.0, 29000)):
            load, step = np.array([torque, 3.0]), np.array([1e-3, 0.0])
            assert found.springs(load)[0] == pytest.approx([stiffness, 0])
            compliance = (found.torsion(load + step) - found.torsion(load - step)) / 2e-3
            assert compliance == pytest.approx([1 / stiffness, 0], rel=1e-6)
        assert found.torsion(np.array([25.0, 0])) == pytest.approx([7 / 16000 + 18 / 25000, 0])
        assert found.torsion(np.array([-60.0, 0])) == pytest.approx(
            [-7 / 16000 - 18 / 25000 - 35 / 29000, 0]
        )

    def test_a_constant_stiffness_has_one_stage(self, tmp_path: Path) -> None:
        found = arm(tmp_path, gears=Gears(stiffness_nmprad=(2000, 0))).elastic
        assert found is not None
        assert found.torsion(np.array([-30.0, 5.0])) == pytest.approx([-0.015, 0])

    def test_without_gears_it_changes_nothing(self, tmp_path: Path) -> None:
        rigid, known = (
            arm(tmp_path),
            arm(tmp_path, strain_wave=StrainWave(sizes=(20,), rotor_kgm2=(1.0,))),
        )
        assert (
            known.elastic is None
            and known.servo_kp == rigid.servo_kp
            and needed_step(known) == np.inf
        )

    def test_added_servos_move_the_rotors_that_are_given(self, tmp_path: Path) -> None:
        given: dict[str, Any] = {"servo_kp": (), "servo_kv": (), "gears": Gears()}
        robot = arm(tmp_path, strain_wave=StrainWave(sizes=(14, 0), rotor_kgm2=(0.5, 0.2)), **given)
        assert robot.servo_kp == pytest.approx(
            [4500 * (inertia() + 0.5), 4500 * (0.001 + 0.2)], rel=1e-3
        )


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    for given, words in (
        (
            {"strain_wave": StrainWave(sizes=(21,)), "gears": Gears()},
            "must be one of 0, 8, 11, 14, 17, 20, 25, 32, 40",
        ),
        (
            {"strain_wave": StrainWave(sizes=(20, 20, 20)), "gears": Gears()},
            "must be one value for all joints, or 2",
        ),
        ({"gears": Gears()}, "gears.stiffness_nmprad is missing; or give the catalogue sizes"),
        (
            {"gears": Gears(backlash_deg=(0.1,)), "realism": "lab"},
            "gears.stiffness_nmprad is missing; or give the catalogue sizes",
        ),
    ):
        with pytest.raises(ParameterError, match=words):
            arm(tmp_path, **given)


def test_too_stiff_a_gear_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        ParameterError,
        match=r"strain_wave.sizes must be 0 \(rigid\) for roll: it vibrates at \d+ Hz",
    ):
        needed_step(arm(tmp_path, strain_wave=StrainWave(sizes=(0, 40)), gears=Gears()))
    with pytest.raises(
        ScenarioError, match=r"robot.strain_wave.sizes: must be 0 \(rigid\) for joint_\d"
    ):
        vs.load("arm_jaco", {"robot.realism": "lab", "robot.strain_wave": {"sizes": [14]}})


def test_a_joint_without_rotor_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        ParameterError,
        match=r"sizes must be 0 for swing, .* or its inertia in strain_wave.rotor_kgm2",
    ):
        needed_step(arm(tmp_path, rotor=0.0, strain_wave=StrainWave(sizes=(20, 0)), gears=Gears()))


class TestArms:
    @pytest.mark.parametrize("level", ["lab", "field"])
    @pytest.mark.parametrize("name", ARMS)
    def test_a_preset_gives_springs_where_sizes_are_known(self, name: str, level: str) -> None:
        robot = vs.load(name, {"robot.realism": level}).robot
        assert robot.elastic is not None and robot.strain_wave is not None
        known = [CURVES[size].k1 if size else 0.0 for size in robot.strain_wave.sizes]
        assert robot.elastic.stiffness == pytest.approx(known)
        assert needed_step(robot) > 0.0007
        assert "strain_wave" not in robot.presets[level]
        vs.testing.check_robot(robot)

    def test_a_preset_leaves_joints_rigid_whose_gears_are_not_known(self, tmp_path: Path) -> None:
        found = arm(tmp_path, realism="field").elastic
        assert found is not None and not found.stiffness.any()

    @pytest.mark.parametrize("name", ARMS)
    def test_the_links_vibrate_as_the_eigenvalues_say(self, name: str) -> None:
        """The slowest mode before held rotors, without weight, against det(K - w^2 M)."""
        robot = vs.load(name, {"robot.gears": {"damping_s": 0}}).robot
        soft, start = robot.elastic.stiffness > 0, robot.configuration()
        whole, own = reader().inertia_at(robot.file, robot.joints, tuple(start.tolist()))
        M = whole - np.diag(own)
        w2, modes = eigh(np.diag(robot.elastic.stiffness[soft]), M[np.ix_(soft, soft)])
        mode = np.zeros(len(start))
        mode[soft] = modes[:, 0] / np.abs(modes[:, 0]).max()
        t, q = free_links(robot, start, 5e-5 * mode)
        leading = np.abs(mode).argmax()
        assert frequency(t, q[:, leading] - start[leading]) == pytest.approx(
            math.sqrt(w2[0]), rel=0.01
        )

    @pytest.mark.study
    @pytest.mark.parametrize("level", ["lab", "field"])
    @pytest.mark.parametrize("name", ARMS)
    def test_it_arrives(self, name: str, level: str) -> None:
        for seed in range(5):
            m: dict[str, Any] = vs.run(vs.load(name, {"robot.realism": level}, seed=seed)).summary()
            print(name, level, seed, m["outcome"], m["time_to_converge_s"], m["final_error_px"])
            assert m["outcome"] == "converged"
