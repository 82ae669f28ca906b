"""Why runs with dynamics end otherwise, or at other times, than ideal ones: each sentence of the
README, held against a run.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.geometry import Array
from vstestbed.laws.base import TwistLimits
from vstestbed.robots.arm import LIMIT_MARGIN
from vstestbed.robots.puma560 import JOINT_LIMITS
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies.comparison import Jobs, chosen, controllers

LIMITS = np.degrees(JOINT_LIMITS)
MARGIN = math.degrees(LIMIT_MARGIN)
ORACLE = {"detector": {"kind": "oracle"}}
"""The ends told of here are of the arm, not of its pictures."""


def of(comparison: str, law: str, task: str, amount: str, **cases: str) -> Scenario:
    """One run's scenario of a comparison."""
    whole = chosen([comparison], ORACLE if comparison == "canonical_arm" else {}, {})
    kept = {
        name: {chosen_: whole.cases[name][chosen_]}
        for name, chosen_ in {"law": law, **cases}.items()
    }
    (found,) = controllers(replace(whole, cases=kept, tasks={task: whole.tasks[task]}))
    assert found.starts is not None
    return found.starts[found.amounts.index(amount)]


def q_deg(r: vs.Recording) -> Array:
    return np.degrees(np.column_stack([r[f"q_joint_{i}"] for i in range(1, 7)]))


def test_points_retreat_into_joint_3_from_60_degrees_on():
    # The retreat is 1/cos(a/2) - 1 of a metre: .064 m at 40 degrees, .155 m at 60; joint 3 leaves
    # .15 m (an inverse kinematics of the goal moved back by .15 m stands .8 degrees before its
    # stop, and the arm keeps 1 degree).
    near = vs.run(of("canonical_arm", "points", "about the axis", "40 deg"))
    assert near.outcome is vs.Outcome.converged
    # Latency and servo lag make the camera overshoot the continuous law's retreat by a few mm.
    assert near.summary()["max_retreat_m"] == pytest.approx(
        1 / math.cos(math.radians(20)) - 1, abs=0.01
    )
    far = vs.run(of("canonical_arm", "points", "about the axis", "60 deg"))
    assert far.outcome is vs.Outcome.joint_limit
    assert q_deg(far)[-1, 2] == pytest.approx(LIMITS[2, 0] + MARGIN, abs=0.3)


def test_the_arm_at_full_stretch_stops_the_advance_that_takes_an_ideal_camera_through_the_target():
    ideal = vs.run(of("canonical", "points_desired", "about the axis", "160 deg"))
    assert ideal.outcome is vs.Outcome.target_lost and ideal["cam_z"].max() > -0.1
    arm = vs.run(of("canonical_arm", "points_desired", "about the axis", "160 deg"))
    # The wrist's centre is 2 x .43 m from the shoulder at most, .62 m before the target.
    assert arm["cam_x"].max() == pytest.approx(0.88, abs=0.02)
    assert arm.outcome is vs.Outcome.converged
    assert (
        vs.run(of("canonical_arm", "points_desired", "about the axis", "180 deg")).outcome
        is vs.Outcome.singular
    )


def test_the_partitioned_law_turns_joint_4_into_its_stop():
    whole = chosen(["realism"], {}, {})
    cases = {
        "world": {"dynamics": whole.cases["world"]["dynamics"]},
        "law": {"partitioned": whole.cases["law"]["partitioned"]},
    }
    made = Jobs(controllers(replace(whole, cases=cases)), 8)
    r = vs.run(made[7].scenario())
    assert r.outcome is vs.Outcome.joint_limit
    assert q_deg(r)[-1, 3] == pytest.approx(LIMITS[3, 0] + MARGIN, abs=0.3)


@pytest.mark.parametrize(("seed", "end"), [(7, LIMITS[3, 0] + MARGIN), (15, LIMITS[3, 1] - MARGIN)])
def test_the_partitioned_law_turns_joint_4_into_its_stop_from_two_random_starts(
    seed: int, end: float
):
    whole = chosen(["canonical_arm"], ORACLE, {})
    kept = {"law": {"partitioned": whole.cases["law"]["partitioned"]}}
    r = vs.run(
        Jobs(
            controllers(replace(whole, cases=kept, tasks={"random": whole.tasks["random"]})), None
        )[seed].scenario()
    )
    assert r.outcome is vs.Outcome.joint_limit
    assert q_deg(r)[-1, 3] == pytest.approx(end, abs=0.3)


def rate(latency_s: float) -> float:
    """How fast the position error of a position-based flight decays [1/s], between half a metre and
    a millimetre.
    """
    s = vs.load(
        "pbvs_book",
        ORACLE
        | {
            "law.gain": 0.5,
            "camera.rate_hz": 25,
            "camera.latency_s": latency_s,
            "robot.start.random": None,
            "stop.duration_s": 20,
        },
    )
    r = vs.run(s)
    e, t = r["position_error_m"], r["t"]
    part = (e < 0.5) & (e > 1e-3)
    return -float(np.polyfit(t[part], np.log(e[part]), 1)[0])


def test_latency_makes_a_slow_loop_quicker_as_theory_says():
    # z^(d+1) - z^d + g = 0 with g = gain dt = .02: z = .98 for d = 0, (1 + sqrt(1 - 4 g))/2 =
    # .97958 for one frame of delay.
    assert rate(0.0) == pytest.approx(-math.log(0.98) * 25, rel=1e-3)
    assert rate(0.04) == pytest.approx(-math.log((1 + math.sqrt(0.92)) / 2) * 25, rel=2e-3)


def reached(world: str, **more: object) -> Array:
    """When `points_mean` reaches its goal in a world of `realism` [s], seeds 0 to 3."""
    whole = chosen(["realism"], {}, {})
    cases = {
        "world": {world: whole.cases["world"][world] | more},
        "law": {"points_mean": whole.cases["law"]["points_mean"]},
    }
    runs = [vs.run(job.scenario()) for job in Jobs(controllers(replace(whole, cases=cases)), 4)]
    return np.array([r.summary()["time_to_converge_s"] for r in runs], dtype=float)


@pytest.mark.study
def test_friction_and_integrating_servos_act_as_twenty_milliseconds_of_latency():
    """Measured .09 s sooner, with a latency of 20 ms .11 s; one picture is .04 s."""
    stiff = reached("dynamics")
    servos, late = (
        reached("friction") - stiff,
        reached("dynamics", **{"camera.latency_s": 0.02}) - stiff,
    )
    assert (servos < 0).all()
    assert servos.mean() == pytest.approx(late.mean(), abs=0.04)


def test_noise_alone_makes_the_goal_later_but_ends_no_run():
    times = {}
    for sigma in (0.0, 0.1):
        s = vs.load(
            "arm_ibvs",
            ORACLE
            | {
                "robot": {
                    "kind": "free",
                    "start": {"nominal": {"xyz": [0.2, 0.05, 0.75], "rpy_deg": [0, 90, 0]}},
                }
            }
            | {"noise.pixel_sigma_px": sigma},
        )
        found = [vs.run(replace(s, seed=seed)) for seed in range(4 if sigma else 1)]
        assert all(r.outcome is vs.Outcome.converged for r in found)
        times[sigma] = np.mean([r.summary()["time_to_converge_s"] for r in found])
    # With noise of .1 px on top, .2 px for half a second asks for an error of about .12 px:
    # log(.2/.12)/gain = 1 s more.
    assert 0.3 < times[0.1] - times[0.0] < 2.5


def test_noise_takes_the_mean_matrix_off_its_minimum_at_a_half_turn_and_limits_make_that_harmless():
    whole = chosen(["canonical"], {"noise.pixel_sigma_px": 0.1, "stop.converged.error_px": 0.5}, {})
    kept = {"law": {"points_mean": whole.cases["law"]["points_mean"]}}
    task = {"about the axis": whole.tasks["about the axis"]}
    ends = {}
    for speed in (None, 1.0):  # the arm's joints turn its wrist at some 1 m/s at most
        made = replace(whole, cases=kept, tasks=task, set=whole.set | {"noise.pixel_sigma_px": 0.1})
        (found,) = controllers(made)
        assert found.starts is not None
        s = found.starts[found.amounts.index("180 deg")]
        limits = TwistLimits(speed_mps=speed, rate_radps=2.0) if speed else TwistLimits()
        ends[speed] = vs.run(replace(s, law=replace(s.law, limits=limits))).outcome  # pyright: ignore[reportArgumentType]
    # The matrix is nearly singular there: a tenth of a pixel orders metres a frame, through the
    # target's plane.
    assert ends == {None: vs.Outcome.target_lost, 1.0: vs.Outcome.converged}


@pytest.mark.study
@pytest.mark.parametrize(("law", "outcome"), [("pose", "joint_limit"), ("hybrid", "converged")])
def test_a_half_turn_has_two_ways_and_joint_6_room_for_one(law: str, outcome: str):
    whole = chosen(["canonical_arm"], {}, {})
    (found,) = controllers(
        replace(
            whole,
            cases={"law": {law: whole.cases["law"][law]}},
            tasks={"about the axis": whole.tasks["about the axis"]},
        )
    )
    assert found.starts is not None
    r = vs.run(found.starts[-1])
    assert r.outcome.name == outcome
    end = LIMITS[5, 1] - MARGIN if outcome == "joint_limit" else -13.985
    assert q_deg(r)[-1, 5] == pytest.approx(end, abs=0.3)
