"""Line following over whole laps at .8 m/s, rendered, on real wheels, from the written start and
from random ones (-s shows them).
"""

import pytest

import vstestbed as vs

pytestmark = pytest.mark.study


@pytest.mark.parametrize("name", ["car_line", "omni_line"])
def test_a_lap_within_5_cm(name):
    recording = vs.run(vs.load(name))
    worst = recording.summary()["worst_task_error_m"]
    print(
        name, f"worst {worst:.4f} m, {recording.summary()['real_time_factor']:.1f} times real time"
    )
    assert recording.outcome.name == "completed" and worst < 0.02  # 12 mm and 4 mm were measured


@pytest.mark.parametrize("name", ["car_line", "omni_line"])
def test_random_starts_come_to_the_line(name):
    ended = []
    for seed in range(10):
        m = vs.run(vs.load(name, {"stop.duration_s": 12}, seed=seed)).summary()
        print(name, seed, m["outcome"], m["worst_task_error_m"])
        ended.append(m["outcome"])
    assert ended.count("completed") >= 9


@pytest.mark.parametrize(
    ("look_m", "mount", "worst_m"),
    [((-0.25, 0.05), None, 0.02), ((0.0, 0.3), [1.25, 0, 0.35], 0.5)],
)
def test_what_a_camera_at_the_front_costs(look_m, mount, worst_m):
    at = (
        {"camera.mount": {"xyz": mount, "rpy_deg": [-150, 0, -90]}, "law.gain": 1.15}
        if mount
        else {}
    )
    start = {"robot.start": {"nominal": {"x": 0, "y": 0, "heading_deg": 0}}, "goal.settle_s": 0}
    m = vs.run(
        vs.load("car_line", start | at | {"target.look_m": list(look_m), "stop.duration_s": 30})
    ).summary()
    print(look_m, m["outcome"], m["worst_task_error_m"])
    assert m["worst_task_error_m"] < worst_m
    assert mount is None or m["worst_task_error_m"] > 0.1  # ten times the other's
