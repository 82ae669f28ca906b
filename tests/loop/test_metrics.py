"""Figures of made-up runs whose answers can be told by hand."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.loop.columns import Layout
from vstestbed.loop.log_file import Log
from vstestbed.loop.recording import Recording
from vstestbed.scenario.scenario import Scenario


@pytest.fixture
def scenario() -> Scenario:
    return vs.load(
        "ibvs_book",
        {"target.pose": {}, "stop.converged": {"error_px": 0.2, "hold_s": 0.2}, "seed": 7},
    )


def recording(
    scenario: Scenario,
    frames: int,
    outcome: vs.Outcome = vs.Outcome.converged,
    **columns: list[float],
) -> Recording:
    """A run of so many frames at 10 Hz; columns not given are zero, but for unit quaternions and
    unscaled commands.
    """
    names = Layout(scenario).columns
    table = np.zeros((frames, len(names)))
    given = {
        "t": np.arange(frames) / 10,
        "frame": np.arange(frames),
        "cam_qw": 1.0,
        "tgt_qw": 1.0,
        "scale": 1.0,
    } | columns
    for name, values in given.items():
        table[:, names.index(name)] = values
    return Recording(
        scenario,
        outcome,
        "because",
        Log(names, table),
        wall_time_s=2.0,
        time_ms={"law": 10.0},
        versions={"numpy": "2"},
    )


def test_the_clock_and_what_is_passed_on(scenario: Scenario):
    s = recording(scenario, 5, lost=[0, 1, 1, 0, 0]).summary()
    assert (s["scenario"], s["outcome"], s["success"], s["reason"], s["seed"]) == (
        "ibvs_book",
        "converged",
        True,
        "because",
        7,
    )
    assert (
        s["frames"],
        s["frames_lost"],
        s["sim_time_s"],
        s["wall_time_s"],
        s["real_time_factor"],
    ) == (5, 2, 0.4, 2.0, 0.2)
    assert s["time_ms"] == {"law": 2.0}  # a frame
    assert s["versions"] == {"numpy": "2"}


@pytest.mark.parametrize(
    ("error_px", "outcome", "at"),
    [
        ([9, 0.1, 5, 0.19, 0.1, 0.1], "converged", 0.3),  # the last unbroken stretch counts
        ([0.1] * 6, "converged", 0.0),
        ([9, 0.1, math.nan, 0.1, 0.1, 0.1], "converged", 0.3),  # a lost frame breaks it
        ([9, 5, 3, 1, 0.1, 0.1], "timed_out", None),
    ],
)
def test_time_to_converge(
    scenario: Scenario, error_px: list[float], outcome: str, at: float | None
):
    assert (
        recording(scenario, 6, vs.Outcome[outcome], error_px=error_px).summary()[
            "time_to_converge_s"
        ]
        == at
    )


def test_finals(scenario: Scenario):
    s = recording(
        scenario,
        2,
        error_px=[5, 0.125],
        position_error_m=[1, 0.25],
        rotation_error_rad=[1, math.pi / 6],
    ).summary()
    assert (s["final_error_px"], s["final_position_error_m"]) == (0.125, 0.25)
    assert s["final_rotation_error_deg"] == pytest.approx(30, rel=1e-14)
    assert (
        recording(scenario, 2, vs.Outcome.target_lost, error_px=[5, math.nan]).summary()[
            "final_error_px"
        ]
        is None
    )


def test_path(scenario: Scenario):
    # From 2 m back to 3 m, then to the goal at 1 m, with turns of 30 and 10 degrees about z on the
    # way.
    half = np.radians([0, 15, 5])
    turn = {"cam_qw": np.cos(half).tolist(), "cam_qz": np.sin(half).tolist()}
    s = recording(scenario, 3, cam_z=[-2, -3, -1], position_error_m=[1, 2, 0], **turn).summary()
    assert s["path_length_m"] == pytest.approx(3, rel=1e-14)
    assert s["path_ratio"] == pytest.approx(3, rel=1e-14)
    assert s["max_retreat_m"] == pytest.approx(1, rel=1e-14)
    assert s["max_rotation_deg"] == pytest.approx(30, rel=1e-12)


def test_no_retreat_and_no_way_to_go(scenario: Scenario):
    s = recording(scenario, 2, cam_z=[-0.8, -0.9]).summary()
    assert s["max_retreat_m"] == 0  # nearer than the goal's 1 m all the time
    assert s["path_ratio"] is None  # it started at the goal


def test_image(scenario: Scenario):
    u_goal = [299.5, 699.5, 699.5, 299.5]
    v_goal = [299.5, 299.5, 699.5, 699.5]
    # All markers start 100 px left of their goals; marker 2 is 30 px below the line half-way,
    # marker 0 goes out to the left.
    columns = {}
    for i, (u, v) in enumerate(zip(u_goal, v_goal, strict=True)):
        columns[f"u_true_{i}"], columns[f"v_true_{i}"] = [u - 100, u - 50, u], [v, v, v]
    columns["v_true_2"] = [v_goal[2], v_goal[2] + 30, v_goal[2]]
    columns["u_true_0"] = [u_goal[0] - 100, -20.5, u_goal[0]]
    s = recording(scenario, 3, **columns).summary()
    # Marker 0's detour: 20.5 + 199.5 px beyond its start, which is where its line ends.
    assert s["max_feature_excursion_px"] == pytest.approx(220, rel=1e-12)
    assert s["min_border_margin_px"] == pytest.approx(-20, rel=1e-12)  # the picture begins at -.5
    columns["u_true_0"][1] = math.nan  # behind the camera for a frame
    s = recording(scenario, 3, **columns).summary()
    assert s["max_feature_excursion_px"] == pytest.approx(30, rel=1e-12)
    # 199.5 px from the left edge's -.5, marker 3's start
    assert s["min_border_margin_px"] == pytest.approx(200, rel=1e-12)


def test_peaks_and_limits(scenario: Scenario):
    s = recording(
        scenario,
        4,
        act_vx=[0, 0.3, 0, 0],
        act_vy=[0, -0.4, 0, 0],
        act_wz=[0, 0, -2, 1],
        scale=[1, 0.5, 1, 1],
    ).summary()
    assert s["peak_speed_mps"] == pytest.approx(0.5, rel=1e-14)
    assert (s["peak_rate_radps"], s["saturated_fraction"]) == (2.0, 0.25)


def test_a_command_scaled_by_rounding_alone_is_not_saturated(scenario: Scenario):
    s = recording(scenario, 4, scale=[1 - 1e-12, 0.9995, 0.9985, 0.99]).summary()
    assert s["saturated_fraction"] == 0.5  # under .999


def test_a_run_without_frames_has_a_summary(scenario: Scenario):
    s = recording(scenario, 0, vs.Outcome.interrupted).summary()
    assert (s["frames"], s["sim_time_s"], s["success"]) == (0, 0.0, False)
    for name in (
        "final_error_px",
        "time_to_converge_s",
        "path_length_m",
        "path_ratio",
        "peak_speed_mps",
        "saturated_fraction",
    ):
        assert s[name] is None, name
    json.dumps(s, allow_nan=False)


def test_every_promised_name_is_there(scenario: Scenario):
    promised = """
        scenario outcome success reason seed sim_time_s frames frames_lost time_to_converge_s
        final_error_px final_position_error_m final_rotation_error_deg path_length_m path_ratio
        max_retreat_m max_rotation_deg max_feature_excursion_px min_border_margin_px
        peak_speed_mps peak_rate_radps saturated_fraction wall_time_s real_time_factor time_ms
        versions"""
    for frames in (0, 3):
        assert set(promised.split()) <= set(recording(scenario, frames).summary())


def test_a_task_without_an_end_tells_its_worst_error_once_settled():
    pursuit = vs.load("car_pursuit", {"goal.settle_s": 0.2})
    assert (
        recording(
            pursuit, 5, vs.Outcome.completed, task_error_m=[1, 0.5, -0.25, 0.125, 0]
        ).summary()["worst_task_error_m"]
        == 0.25
    )
    assert "worst_task_error_m" not in recording(vs.load("ibvs_book"), 5).summary()
