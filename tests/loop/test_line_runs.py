"""Vehicles that follow lines, rendered and with real wheels: recovery, bends, loss of the line,
what is refused.
"""

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.outcome import Outcome

QUICK = {"camera.width": 320, "camera.height": 240}
"""A quarter of the pixels: what is tested here is the loop."""
BEND = {
    "kind": "track",
    "pieces": [
        {"length_m": 0.5},
        {"turn_deg": 90, "radius_m": 2},
        {"turn_deg": -90, "radius_m": 2},
        {"length_m": 9},
    ],
}


def run(name, **settings):
    return vs.run(vs.load(name, QUICK | {k.replace("__", "."): v for k, v in settings.items()}))


@pytest.mark.parametrize(("name", "settled_s"), one_quick(("car_line", 2.5), ("omni_line", 2.0)))
def test_it_recovers_from_30_cm_and_20_degrees(name, settled_s):
    recording = (
        run(name, robot__wheels="planar", stop__duration_s=4.5)
        if name == "omni_line"
        else run(name, stop__duration_s=4.5)
    )
    assert recording.outcome is Outcome.completed
    assert recording["task_error_m"][0] == pytest.approx(0.3, abs=1e-6)
    # turned away from the line
    assert np.degrees(recording["base_heading"][0]) == pytest.approx(20, abs=0.1)
    assert np.abs(recording["task_error_m"][recording["t"] > settled_s]).max() < 0.05


@pytest.mark.parametrize(("name", "bound"), one_quick(("omni_line", 0.02), ("car_line", 0.03)))
def test_a_bend_of_2_m_and_another_the_other_way(name, bound):
    # The car cuts where one bend meets the other, 2 k m^2 / 9 = 18 mm; its steering takes .5 s from
    # stop to stop.
    start = {"nominal": {"x": 0, "y": 0, "heading_deg": 0}}
    # the car finds the line in pictures
    more = {"robot__wheels": "planar", "detector": "oracle"} if name == "omni_line" else {}
    recording = run(
        name, robot__start=start, target__route=BEND, goal__settle_s=0, stop__duration_s=9.5, **more
    )
    assert recording.outcome is Outcome.completed and not recording["lost"].any()
    assert recording.summary()["worst_task_error_m"] < bound
    speed = np.hypot(np.diff(recording["base_x"]), np.diff(recording["base_y"])) * 25
    assert speed[50:].mean() == pytest.approx(0.8, rel=0.02)


def test_over_the_line_but_not_along_it_is_no_success():
    """Ice on which the wheels spin: it stands over the line, within its band."""
    start = {"nominal": {"x": 0, "y": 0, "heading_deg": 0}}
    stuck = run(
        "car_line",
        detector="oracle",
        world__floor_friction=0.004,
        robot__start=start,
        stop__duration_s=5,
    )
    assert np.abs(stuck["task_error_m"]).max() < 0.05
    assert stuck.outcome is Outcome.timed_out
    assert (
        "the vehicle, along its line, made 0.0" in stuck.reason
        and "0.8 m/s were commanded" in stuck.reason
    )


def test_against_the_routes_direction_it_is_the_same_line():
    start = {"nominal": {"x": 9, "y": 0.05, "heading_deg": 185}}
    recording = run(
        "car_line",
        detector="oracle",
        target__route={"kind": "straight", "length_m": 10},
        robot__start=start,
        stop__duration_s=6,
    )
    assert recording.outcome is Outcome.completed, recording.reason
    assert recording["base_x"][-1] < 5


def test_where_the_paint_ends_the_line_is_lost():
    recording = run(
        "car_line", target__route={"kind": "straight", "length_m": 2.0}, stop__duration_s=6
    )
    assert recording.outcome is Outcome.target_lost and recording["base_x"][-1] < 2.5


def test_the_oracle_sees_the_same_points():
    pixels, truth = (
        run("omni_line", robot__wheels="planar", detector=d, stop__duration_s=1.0)
        for d in ("lines", "oracle")
    )
    # Both start alike; the first picture's points differ by the detector's error alone.
    for i in (0, 1):
        assert pixels[f"u_{i}"][0] == pytest.approx(truth[f"u_{i}"][0], abs=0.5)
    assert (
        truth.outcome is Outcome.completed or truth["task_error_m"][-1] < truth["task_error_m"][0]
    )


def test_refuses():
    for name, settings, words in (
        ("car_line", {"law": "pursuit"}, "may not be of kind line with law pursuit"),
        ("car_line", {"detector": "blobs"}, "with stripe use detector lines or oracle"),
        (
            "car_line",
            {
                "target": {
                    "kind": "points",
                    "at": [[1, 0, 0], [2, 0, 0]],
                    "pose": {"xyz": [0, 0, 0]},
                }
            },
            "needs a line on the floor",
        ),
        (
            "omni_ibvs",
            {"target": {"kind": "lines", "route": {"kind": "circle"}}, "detector": "lines"},
            "lines on the floor have none",
        ),
        ("car_line", {"target.look_m": [0.6, 0.9]}, "outside the 640 x 480 picture"),
        ("car_line", {"camera.mount.rpy_deg": [0, 0, 0]}, "top of its picture ahead"),
    ):
        with pytest.raises((ParameterError, ScenarioError), match=words):
            vs.load(name, settings)
