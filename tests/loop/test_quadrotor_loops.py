"""The quadrotor in closed loop with what it sees,
by the oracle where pictures are not the matter.
"""

from dataclasses import replace

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.outcome import Outcome
from vstestbed.robots.rotors import X4
from vstestbed.sim.plant import MujocoPlant

ORACLE = {"detector.kind": "oracle", "noise.pixel_sigma_px": 0.1}


def run(name: str, **given: object):
    """A run by the oracle."""
    return vs.run(
        vs.load(name, ORACLE | {key.replace("__", "."): value for key, value in given.items()})
    )


def test_it_hovers_from_the_first_instant():
    r = run(
        "quadrotor_hover",
        robot__start__nominal__xyz=[0, 0, 5],
        robot__start__nominal__yaw_deg=90,
        stop__duration_s=1.0,
    )
    # rotors at rest would let it fall .6 m in the .35 s that they take to turn
    assert np.abs(r["cam_z"] - 5).max() < 0.02
    assert r["ctrl_rotor_front"][0] == pytest.approx(X4.hover)
    assert r["speed_rotor_left"][0] == pytest.approx(np.sqrt(X4.hover))


def test_a_step_by_rendered_pictures():
    goal = {
        "goal.T_camera_target.xyz": [0, 0, 2.39],
        "stop.converged.error_px": 2.0,
        "stop.converged.hold_s": 0.2,
        "law.gain": 0.8,
    }
    r = vs.run(
        vs.load(
            "quadrotor_hover",
            goal | {"robot.start.nominal.xyz": [0.3, -0.2, 2.2], "robot.start.nominal.yaw_deg": 75},
        )
    )
    assert r.outcome is Outcome.converged
    # a gyro bias of 3e-3 rad/s is on its way out: .35 deg at 2.5 m, and 2 px
    assert r.summary()["final_position_error_m"] < 0.08


@pytest.mark.study
def test_without_derotation_the_lean_is_taken_for_an_error():
    """The first second of a large step: the craft leans forward,
    and its points seem to run ahead.
    """
    level, raw = (
        run("quadrotor_aggressive", derotation=how, stop__duration_s=8.0)
        for how in ("exact", "none")
    )
    over = [float(r.summary()["feature_overshoot"]) for r in (level, raw)]
    assert over[1] > 1.5 * over[0]  # measured 2.5 to 6 over 20 starts


@pytest.mark.study
def test_feedforward_takes_no_lean_for_a_target_that_moves():
    """What the craft rolls and pitches does not show in a view that is turned level; its rates must
    not be taken out of it.
    """
    # the estimate of a standing target's speed is fed back at once
    quick = {"kind": "kalman_cv", "bandwidth_hz": 5.0}
    r = run("quadrotor_hover", law__feedforward=quick, stop__duration_s=8.0)
    assert set(r["supervisor"]) == {0}
    # rocked, rotors at their limits, when rates were taken out
    assert np.degrees(np.hypot(r["est_roll"], r["est_pitch"])).max() < 5
    assert np.hypot(r["cam_x"][-1], r["cam_y"][-1]) < 0.25


def test_blind_it_holds_sinks_and_stands():
    # Points 3 m to the side, and a wall before them from .6 s on.
    wall = {
        "pose": {"xyz": [1.9, 0, 1], "rpy_deg": [0, 90, 0]},
        "width": 4,
        "height": 8,
        "from_s": 0.6,
    }
    start = {
        "robot.start.nominal.xyz": [3, 0, 0.9],
        "robot.start.nominal.yaw_deg": 0,
        "stop.lost_after_s": 0.4,
    }
    goal = {"goal.T_camera_target": {"xyz": [-3, 0, 0.79]}}
    r = vs.run(
        vs.load(
            "quadrotor_hover",
            ORACLE | start | goal | {"world.plates": [wall], "stop.duration_s": 12},
        )
    )
    assert r.outcome is Outcome.target_lost and "set down" in r.reason
    assert list(dict.fromkeys(r["supervisor"])) == [0, 1, 2, 3]
    assert r["cam_z"][-1] == pytest.approx(0.172, abs=0.01)  # on its feet
    assert r["speed_rotor_front"][-1] < 100
    assert np.degrees(np.hypot(r["est_roll"], r["est_pitch"])).max() < 10


def test_feet_on_the_ground_without_a_landing_are_a_collision():
    start = {
        "robot.start.nominal.xyz": [0, 0, 0.3],
        "goal.T_camera_target.xyz": [0, 0, -0.2],
        "law.gain": 1.0,
    }
    r = vs.run(
        vs.load(
            "quadrotor_hover",
            ORACLE | start | {"detector.field_of_view": "unlimited", "stop.duration_s": 6},
        )
    )
    assert r.outcome is Outcome.collided


@pytest.mark.study
def test_without_a_word_it_holds():
    """Pictures lost for seconds on end: an order is flown for half a second,
    then the craft holds.
    """
    far = {
        "robot.start.nominal.xyz": [6, 0, 3],
        "law.gain": 0.6,
        "detector.field_of_view": "unlimited",
        "seed": 2,
    }
    r = vs.run(
        vs.load(
            "quadrotor_aggressive",
            ORACLE | far | {"timing.drop_probability": 0.98, "stop.duration_s": 12},
        )
    )
    assert np.diff(r["t"]).max() > 3.5
    way = np.hypot(np.diff(r["cam_x"]), np.diff(r["cam_y"]))
    # 2 m/s for .5 s, and what it takes to stop; without it 5.8 m in one gap.
    assert way.max() < 2.0 * (0.5 + 0.8)


def test_before_its_first_order_it_holds():
    """A first picture that takes .6 s: meanwhile wind blows, and the craft's own loops lean into
    it.
    """
    wind = {"world.wind.mean_mps": [8, 0, 0], "camera.latency_s": 0.6, "stop.duration_s": 0.7}
    r = vs.run(vs.load("quadrotor_gust", ORACLE | wind))
    # it heads along y, so it rolls; towards 5.6 degrees
    assert np.degrees(r["est_roll"][r["t"] < 0.55][-1]) < -2


@pytest.mark.study
def test_a_path_is_flown_to_its_end_and_in_time():
    """Who stops on the way has not flown it, nor has who waits at its beginning, to which the path
    comes back.
    """
    short = {
        "stop.duration_s": 6,
        "goal.settle_s": 1,
        "robot.start.nominal": {"xyz": [-1.5, -1.5, 2.5], "yaw_deg": 0},
    }
    r = vs.run(vs.load("quadrotor_path", ORACLE | short))
    assert r.outcome is Outcome.timed_out and "on the way" in r.reason
    waits = vs.run(
        vs.load(
            "quadrotor_path",
            ORACLE
            | short
            | {"robot.max_speed_mps": 0.01, "goal.speed_mps": 2, "goal.turn_degps": 90},
        )
    )
    assert waits.outcome is Outcome.timed_out and "out of its band" in waits.reason
    assert waits["task_error_m"].max() > 1


def test_one_seed_one_flight():
    scenario = replace(vs.load("quadrotor_gust", ORACLE | {"stop.duration_s": 1.0}), seed=3)
    a, b = vs.run(scenario), vs.run(scenario)
    np.testing.assert_array_equal(a.table, b.table)
    assert np.abs(a["wind_x"]).max() > 0


HIGH = {
    "detector.field_of_view": "unlimited",
    "robot.start.nominal.yaw_deg": 90,
    "stop.lost_after_s": 2.0,
}


@pytest.mark.study
def test_a_blow_that_overturns_it_ends_the_task_and_it_sets_down(monkeypatch):
    """At 1 s something hits a leg: the craft rolls over; it levels, sinks and stands before the run
    ends.
    """
    blows = []
    truth = MujocoPlant.truth

    def struck(plant: MujocoPlant):
        if not blows and plant._stage.data.time > 1.0:
            blows.append(plant._stage.data.time)
            plant._stage.data.qvel[3] += 9.0  # rad/s about its x axis
        return truth(plant)

    monkeypatch.setattr(MujocoPlant, "truth", struck)
    start = {
        "robot.start.nominal.xyz": [0, 0, 4],
        "goal.T_camera_target.xyz": [0, 0, 3.89],
        "stop.duration_s": 40,
    }
    r = vs.run(vs.load("quadrotor_hover", ORACLE | HIGH | start))
    assert r.outcome is Outcome.overturned, r.reason
    assert "set down" in r.reason
    tilt = np.degrees(np.hypot(r["est_roll"], r["est_pitch"]))
    assert tilt.max() > 60
    assert tilt[-25:].max() < 5
    assert r["cam_z"][-1] == pytest.approx(0.172, abs=0.01)


@pytest.mark.study
def test_a_draught_that_the_rotors_cannot_carry_ends_the_task_and_it_sets_down():
    """For 5 s the air falls with up to 20 m/s: drag and weight are more than four rotors at 1000
    rad/s lift.
    """
    start = {
        "robot.start.nominal.xyz": [0, 0, 20],
        "goal.T_camera_target.xyz": [0, 0, 19.89],
        "stop.duration_s": 90,
    }
    draught = {
        "world.wind": {"gusts": [{"from_s": 0.5, "duration_s": 5, "velocity_mps": [0, 0, -20]}]}
    }
    r = vs.run(vs.load("quadrotor_hover", ORACLE | HIGH | start | draught))
    assert r.outcome is Outcome.rotor_limit, r.reason
    assert "set down" in r.reason
    assert max(r[f"speed_rotor_{name}"].max() for name in ("front", "left", "back", "right")) > 990
    assert r["cam_z"][-1] == pytest.approx(0.172, abs=0.01)
