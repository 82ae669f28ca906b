"""Arms by their files: 20 random starts each from rendered pictures, and what friction, torque
limits and latency do to one.

    python -m pytest -s -m study tests/long/test_arms.py

Jaco (dm-control): `ibvs` 20 of 20 in 4.9 to 6.9 s, at worst .25 px, 2.0 mm, .18 deg; `pbvs` 20 of
20 in 4.8 to 6.9 s, at worst .25 px, 2.8 mm, .24 deg. Panda (dm_robotics_panda): `ibvs` 20 of 20 in
5.6 to 8.0 s, at worst .27 px, 2.0 mm, .17 deg; `pbvs` 20 of 20 in 6.2 to 8.5 s, at worst .15 px,
1.5 mm, .15 deg. No frame was lost.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import vstestbed as vs
from tests.robots.arms import NEEDS_PANDA, is_installed
from vstestbed.core.geometry import Pose
from vstestbed.core.named_files import place_of_file
from vstestbed.robots import ROBOTS
from vstestbed.scenario.load import seeded

pytestmark = pytest.mark.study
JACO = "package:dm_control/third_party/kinova/jaco_arm.xml"
UR5E = {
    "mujoco_menagerie/universal_robots_ur5e/ur5e.xml": "attachment_site",
    "package:robosuite/models/assets/robots/ur5e/robot.xml": "right_hand",
}
"""Files of the UR5e, where one may have them, with their flanges; the first one in the folder from
which the tests are run.
"""
LAWS = {"ibvs": {"kind": "ibvs", "gain": 0.8}, "pbvs": {"kind": "pbvs", "gain": 0.8}}


def arrivals(scenario: vs.Scenario, seeds: int) -> int:
    """How many of the seeds end converged, with under .3 px, 3 mm and .3 deg of true error."""
    there = 0
    for seed in range(seeds):
        m: dict[str, Any] = vs.run(seeded(scenario, seed)).summary()
        error = (
            m["final_error_px"],
            1e3 * m["final_position_error_m"],
            m["final_rotation_error_deg"],
        )
        print(
            scenario.name,
            scenario.law.kind,
            seed,
            m["outcome"],
            m["time_to_converge_s"],
            "s",
            np.round(error, 3),
            flush=True,
        )
        there += m["outcome"] == "converged" and error[0] < 0.3 and error[1] < 3 and error[2] < 0.3
    return there


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", ["arm_jaco", pytest.param("arm_panda", marks=NEEDS_PANDA)])
def test_an_arm_arrives_from_twenty_starts(name: str, law: str) -> None:
    assert arrivals(vs.load(name, {"law": LAWS[law]}), 20) >= 19


@pytest.mark.skipif(
    not any(map(is_installed, UR5E)),
    reason=f"no UR5e on this machine: none of {', '.join(UR5E)} is there",
)
@pytest.mark.parametrize("law", LAWS)
def test_a_ur5e_arrives(law: str, tmp_path: Path) -> None:
    """With robosuite's copy, 5 starts each: see the guide."""
    file = next(file for file in UR5E if is_installed(file))
    file = file if file.startswith("package:") else str(Path(file).absolute())
    goal_deg, start_deg = (-27, -90, 125, -125, -90, -27), [-20, -96, 122, -118, -84, -15]
    robot = {
        "kind": "mjcf",
        "file": file,
        "flange": UR5E.get(file, "attachment_site"),
        "speed_limits": [3.14] * 6,
    }
    robot |= {"start": {"nominal": {"q_deg": start_deg}, "random": {"q_deg": 8}}}
    arm = ROBOTS.members["mjcf"](**{k: v for k, v in robot.items() if k != "kind"})
    T = arm.flange_pose(np.radians(goal_deg)) @ Pose(xyz=(0, 0, 0.08)).T @ Pose(xyz=(0, 0, 0.6)).T
    pose = Pose.of(T)
    scenario = {
        "robot": robot,
        "camera": {"kind": "perspective", "fovy_deg": 60, "mount": {"xyz": [0, 0, 0.08]}},
        "target": {
            "kind": "square",
            "side": 0.2,
            "pose": {"xyz": list(pose.xyz), "rpy_deg": list(pose.rpy_deg)},
        },
        "law": LAWS[law],
        "goal": {"T_camera_target": {"xyz": [0, 0, 0.6]}},
        "stop": {"duration_s": 30, "converged": {"error_px": 0.3}},
        "world": {"floor_z": -1.0},
    }
    scenario["target"]["marker"] = {"kind": "disc", "radius": 0.012}
    (tmp_path / "ur5e.yaml").write_text(yaml.safe_dump(scenario))
    assert arrivals(vs.load(tmp_path / "ur5e.yaml"), 5) == 5


Copy = Callable[..., str]


@pytest.fixture
def jaco(tmp_path: Path) -> Copy:
    """A copy of the Jaco's file with other joints: friction times as much, a torque limit [Nm],
    velocity servos of its own.
    """

    def copy(
        friction: float = 1.0, torque: float | None = None, weightless_kv: float | None = None
    ) -> str:
        folder = Path(
            shutil.copytree(
                place_of_file(JACO).parent, tmp_path / f"{friction}_{torque}_{weightless_kv}"
            )
        )
        text, limit = (
            (folder / "jaco_arm.xml").read_text(),
            f' actuatorfrcrange="-{torque} {torque}"' if torque else "",
        )
        for loss in (2, 1):
            assert f'frictionloss="{loss}"' in text
            text = text.replace(
                f'frictionloss="{loss}"', f'frictionloss="{loss * friction}"{limit}'
            )
        if weightless_kv:
            servos = "".join(
                f'<velocity name="servo_{i}" joint="joint_{i}" kv="{weightless_kv}"/>'
                for i in range(1, 7)
            )
            text = text.replace("<body name=", '<body gravcomp="1" name=').replace(
                "</mujoco>", f"<actuator>{servos}</actuator></mujoco>"
            )
        (folder / "jaco_arm.xml").write_text(text)
        return str(folder / "jaco_arm.xml")

    return copy


def ended(**settings: Any) -> tuple[str, dict[str, Any]]:
    """Outcome and figures of arm_jaco without picture noise."""
    m: dict[str, Any] = vs.run(
        vs.load("arm_jaco", {"detector": {"kind": "oracle"}} | settings)
    ).summary()
    print(
        settings,
        m["outcome"],
        {k: m[k] for k in ("time_to_converge_s", "final_error_px", "feature_overshoot")},
        m["reason"],
        flush=True,
    )
    return m["outcome"], m


def test_friction_leaves_an_error_unless_the_servo_integrates(jaco: Copy) -> None:
    """A velocity servo moves a joint with friction F not at all under F/kv: the image error that
    stays goes with F.

    Measured after 30 s .59, 1.06, 1.86, 3.18 px for once to eight times the file's friction, .19 px
    without (converged): the ratio is 1.8, not 2, since MuJoCo's friction gives way slowly. The
    added servos integrate their command, and arrive with 100 times the friction.
    """
    own = {"robot.actuation": "file"}
    assert ended(**own, **{"robot.file": jaco(0.0, weightless_kv=460)})[0] == "converged"
    left = []
    for friction in (1.0, 2.0, 4.0, 8.0):
        outcome, m = ended(**own, **{"robot.file": jaco(friction, weightless_kv=460)})
        assert outcome == "timed_out"
        left.append(m["final_error_px"])
    assert np.array(left[1:]) / left[:-1] == pytest.approx([2, 2, 2], abs=0.35)
    for friction in (1.0, 100.0):
        assert ended(**{"robot.file": jaco(friction)})[0] == "converged"


def test_an_arm_too_weak_for_its_weight_sinks(jaco: Copy) -> None:
    """At the start the second joint carries 3.3 Nm. With 20 Nm nothing changes; with 4 Nm, 2.7 of
    them left for 4 kg m^2, the servos swing over their speed (overshoot .07); with 2 Nm the arm
    falls to the floor.
    """
    strong, m = ended(**{"robot.file": jaco(torque=20)})
    weak, n = ended(**{"robot.file": jaco(torque=4)})
    assert (
        strong == weak == "converged"
        and m["feature_overshoot"] < 0.01 < 0.04 < n["feature_overshoot"]
    )
    assert ended(**{"robot.file": jaco(torque=2)})[0] == "collided"


def test_latency_swings_from_gain_times_delay_of_one_over_e_and_diverges_at_half_pi() -> None:
    """de/dt = -g e(t - T) swings where g T > 1/e and grows where g T > pi/2. Here g = .8 1/s, and T
    is the pictures' latency and .06 s more (servos, and half a period of the picture): the bounds
    are .40 and 1.90 s of latency.

    Measured, latency and overshoot: 0 and .4 s none, .8 s .27, 1.2 s .66, 1.6 s 1.07 (converged
    after 5.9, 3.7, 6.9, 16.9, 58.2 s); with 2.0 s the swing grows until the time is out.
    """
    long = {"stop.duration_s": 60, "stop.lost_after_s": 5}
    over = {}
    for latency_s in (0.0, 0.4, 0.8, 1.2, 1.6, 2.0):
        outcome, m = ended(**{"camera.latency_s": latency_s}, **long)
        over[latency_s] = m["feature_overshoot"]
        assert (outcome == "converged") == (latency_s < 1.9)
    assert over[0.0] == over[0.4] == 0 and 0.1 < over[0.8] < over[1.2] < over[1.6] < over[2.0]
