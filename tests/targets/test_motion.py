"""Motions of targets: closed forms, the random walk's statistics,
and that both plants follow them.
"""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.geometry import Pose, inverse, rotation_angle
from vstestbed.targets.base import Square
from vstestbed.targets.motion import Circle, Line, Lissajous, RandomWalk, Sinusoid, Still

RNG = np.random.default_rng(0)
TIMES = np.arange(0, 20, 0.04)


def places(motion, times=TIMES, seed=0):
    path = motion.path(np.random.default_rng(seed))
    return np.array([path(float(t))[:3, 3] for t in times])


def test_closed_forms():
    t = TIMES[:, None]
    assert np.allclose(places(Still()), 0)
    circle = places(Circle(radius_m=0.1, frequency_hz=0.2, phase_deg=90))
    assert np.allclose(np.linalg.norm(circle, axis=1), 0.1)
    assert np.allclose(circle[0], [0, 0.1, 0])
    speed = np.linalg.norm(np.diff(circle, axis=0), axis=1) / 0.04
    # chords are that much shorter than arcs
    assert np.allclose(speed, 2 * np.pi * 0.2 * 0.1, rtol=1e-3)
    line = places(Line(velocity_mps=(0.1, 0, -0.2), from_s=2, until_s=5))
    assert np.allclose(line, np.clip(t - 2, 0, 3) * [0.1, 0, -0.2])
    both = places(
        Lissajous(amplitude_m=(0.1, 0.2, 0), frequency_hz=(0.2, 0.3, 1), phase_deg=(0, 90, 0))
    )
    assert np.allclose(
        both, np.hstack([0.1 * np.sin(0.4 * np.pi * t), 0.2 * np.cos(0.6 * np.pi * t), 0 * t])
    )


def test_a_sinusoid_also_turns():
    path = Sinusoid(amplitude=Pose(xyz=(0, 0, 0.1), rpy_deg=(0, 0, 20)), frequency_hz=0.25).path(
        RNG
    )
    assert np.allclose(path(1.0)[:3, 3], [0, 0, 0.1])  # a quarter of its period of 4 s
    assert np.degrees(rotation_angle(path(1.0)[:3, :3])) == pytest.approx(20)
    assert np.allclose(path(2.0), np.eye(4))


class TestRandomWalk:
    WALK = RandomWalk(rms_m=(0.1, 0.05, 0.0), corner_hz=0.5)

    def test_its_seed_draws_it_whatever_the_times_asked_for(self):
        forwards, later = places(self.WALK, seed=3), places(self.WALK, TIMES[::-1], seed=3)[::-1]
        assert np.array_equal(forwards, later)
        assert not np.allclose(forwards, places(self.WALK, seed=4))

    def test_it_has_the_spread_and_the_speed_that_it_says(self):
        x = places(self.WALK, np.arange(10, 400, 0.1))
        # 400 s hold some 600 independent places: their deviation is known within 3 %.
        assert np.std(x, axis=0) == pytest.approx([0.1, 0.05, 0.0], rel=0.12)
        fine = places(self.WALK, np.arange(10, 100, 0.01))
        speed = np.diff(fine, axis=0) / 0.01
        assert np.std(speed[:, 0]) == pytest.approx(0.1 * np.pi, rel=0.15)

    def test_it_starts_at_rest_and_never_jumps(self):
        x = places(self.WALK, np.arange(0, 5, 0.001))
        assert np.allclose(x[0], 0)
        # 1 ms: speeds change by under .1 m/s in a step, the law's noise allows .02
        assert np.abs(np.diff(x, 2, axis=0)).max() < 1e-4

    def test_exact_steps_keep_the_stationary_variance(self):
        F, chol = self.WALK.exact_step(0.07)
        P = np.diag([1.0, np.pi**2])
        assert np.allclose(F @ P @ F.T + chol @ chol.T, P)


@pytest.mark.parametrize("robot", ["free", "puma560"])
def test_both_plants_move_the_target(robot):
    motion = {
        "kind": "lissajous",
        "amplitude_m": [0.03, 0.02, 0.01],
        "frequency_hz": [0.5, 0.7, 0.3],
    }
    setting = {"detector": "oracle", "target.motion": motion, "stop.duration_s": 0.4}
    if robot == "free":
        setting["robot"] = {
            "kind": "free",
            "start": {"nominal": {"xyz": [0.6, 0, 0.7], "rpy_deg": [0, 90, 0]}},
        }
    r = vs.run(vs.load("arm_ibvs", setting))
    pose, path = r.scenario.target.pose.T, r.scenario.target.motion.path(RNG)
    wanted = np.array([(pose @ path(t))[:3, 3] for t in r["t"]])
    assert np.allclose(np.column_stack([r[f"tgt_{c}"] for c in "xyz"]), wanted, rtol=0, atol=1e-12)


def test_what_is_seen_is_where_the_target_is():
    """Rendered pixels of a target that moves, against the projection of its path."""
    motion = {"kind": "circle", "radius_m": 0.1, "frequency_hz": 1.0}
    r = vs.run(vs.load("arm_ibvs", {"target.motion": motion, "stop.duration_s": 0.2}))
    off = [
        np.hypot(r[f"u_{i}"] - r[f"u_true_{i}"], r[f"v_{i}"] - r[f"v_true_{i}"]).max()
        for i in range(4)
    ]
    assert max(off) < 0.4  # as for a target that stands still


def test_a_random_walk_belongs_to_the_seed():
    motion = {"kind": "random_walk", "rms_m": [0.1, 0.1, 0.0]}
    setting = {"detector": "oracle", "target.motion": motion, "stop.duration_s": 0.4}
    runs = [vs.run(vs.load("arm_ibvs", setting | {"seed": seed})) for seed in (1, 1, 2)]
    assert np.array_equal(runs[0]["tgt_y"], runs[1]["tgt_y"])
    assert not np.allclose(runs[0]["tgt_y"], runs[2]["tgt_y"])


def test_its_start_is_on_its_path():
    target = Square(pose=Pose(xyz=(1, 2, 3)), side=0.2, motion=Circle(radius_m=0.1, frequency_hz=1))
    assert np.allclose((inverse(target.pose.T) @ target.T_world_start)[:3, 3], [0.1, 0, 0])
