"""Depth from motion: one frame of the filter against its equations, marker by marker, in plain
numbers.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from vstestbed.features.depth import Estimate
from vstestbed.vision.observe import FlowState, init_flow, update_flow

SETTINGS = Estimate(initial_m=2.0, forget_s=0.4)


def unit(v: tuple[float, float, float]) -> np.ndarray:
    return np.array(v) / np.linalg.norm(v)


def one_frame(
    theta: float, info: float, before: np.ndarray, ray: np.ndarray, twist: np.ndarray, dt: float
) -> tuple[float, float]:
    """The documented equations for one marker, with the noise of 3e-4 rad, range 50 and evidence 30
    written out.
    """
    v, w = twist[:3], twist[3:]
    m = (ray + before) / np.linalg.norm(ray + before)
    near = m @ v

    def advance(x: float) -> float:
        half = x + x * x * near * dt / 4
        return x + half * half * near * dt / 2

    theta = advance(theta)
    phi, y = m * near - v, (ray - before) / dt + np.cross(w, m)
    evidence, least = phi @ phi, 2 * (3e-4 / (dt * theta)) ** 2
    info = max(info, least) if not math.isnan(info) else least
    if evidence > least:
        info = info * math.exp(-dt / 0.4 * evidence / (evidence + 30 * least)) + evidence
        theta += phi @ (y - phi * theta) / info
    return advance(min(max(theta, 1 / 100), 25.0)), info


@pytest.mark.parametrize("speed", [1.0, 0.05, 5e-3, 1e-3], ids="{} m/s".format)
def test_one_frame_is_what_the_equations_say(speed: float) -> None:
    """At 1 mm/s a frame has less evidence than noise, and is skipped."""
    rng = np.random.default_rng(0)
    for theta, info in ((0.5, 0.0), (1.3, 1e-3), (0.2, 0.5)):
        before, ray = unit((0.1, -0.2, 1)), unit((0.1 + 0.02 * speed, -0.2, 1))
        twist = np.array([*speed * unit((1, 0.3, 0.4)), *rng.normal(0, 0.1, 3)])
        state = FlowState(np.array([theta]), np.array([info]), before[None], 1.0)
        found = update_flow(SETTINGS, state, 1.04, ray[None], twist)
        expected = one_frame(theta, info, before, ray, twist, 0.04)
        assert (found.inverse_range[0], found.information[0]) == pytest.approx(expected, rel=1e-9)
        assert found.t == 1.04 and (found.ray == ray).all()


def test_a_frame_at_the_edge_of_the_noise() -> None:
    """Evidence just under that of the noise changes nothing; just over, it does."""
    theta, dt = 0.5, 0.04
    least_speed = math.sqrt(2) * 3e-4 / (dt * theta)
    for factor, taught in ((0.95, False), (1.05, True)):
        twist = np.array([factor * least_speed, 0, 0, 0, 0, 0])
        state = FlowState(np.array([theta]), np.zeros(1), np.array([[0, 0, 1.0]]), 0.0)
        found = update_flow(SETTINGS, state, dt, unit((0.001, 0, 1))[None], twist)
        assert bool(abs(found.inverse_range[0] - theta) > 1e-4) is taught


@pytest.mark.parametrize(("way", "limit"), [(-1, 25.0), (1, 0.01)])
def test_the_range_stays_within_fifty_times_the_first_guess(way: int, limit: float) -> None:
    state = FlowState(np.array([0.5]), np.zeros(1), np.array([[0, 0, 1.0]]), 0.0)
    found = update_flow(
        SETTINGS, state, 0.001, unit((0.05 * way, 0, 1))[None], np.array([1.0, 0, 0, 0, 0, 0])
    )
    # it also moves a little nearer within the frame
    assert found.inverse_range[0] == pytest.approx(limit, rel=1e-3)


@pytest.mark.parametrize(
    ("z", "expected"), [(0.21, 0.21 / 2), (0.19, 1 / 2), (-0.5, 1 / 2), (1.0, 1 / 2)]
)
def test_a_marker_beside_the_camera_starts_with_the_depth_as_its_range(
    z: float, expected: float
) -> None:
    ray = np.array([[math.sqrt(1 - z * z), 0, z]])
    found = update_flow(SETTINGS, init_flow(1), 0.0, ray, np.zeros(6))
    assert (
        found.inverse_range[0] == pytest.approx(expected)
        and found.information[0] == 0
        and found.t == 0
    )


def test_a_frame_at_the_same_time_keeps_the_state_and_the_last_sight() -> None:
    state = FlowState(
        np.array([0.4, np.nan]), np.array([0.1, 0]), np.array([[0, 0, 1.0], [np.nan] * 3]), 2.0
    )
    seen = np.array([[np.nan] * 3, [0.6, 0, 0.8]])
    found = update_flow(SETTINGS, state, 2.0, seen, np.ones(6))
    assert found.inverse_range == pytest.approx([0.4, 0.4])
    assert found.information == pytest.approx([0.1, 0])
    assert (found.ray == [[0, 0, 1], [0.6, 0, 0.8]]).all()


def test_a_marker_that_is_lost_goes_on_by_the_motion_alone() -> None:
    state = FlowState(np.array([0.5]), np.array([0.2]), np.array([[0, 0, 1.0]]), 0.0)
    found = update_flow(
        SETTINGS, state, 0.1, np.full((1, 3), np.nan), np.array([0.3, 0, 1.0, 0, 0, 0])
    )
    # Straight ahead at 1 m/s: the range shrinks from 2 to 1.9 m.
    assert 1 / found.inverse_range[0] == pytest.approx(1.9, abs=1e-4)
    assert found.information[0] == pytest.approx(0.2)
    assert np.isnan(found.ray).all()
