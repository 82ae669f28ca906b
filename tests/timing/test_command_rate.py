"""Setpoints at a rate of their own reach the actuators of every kind of robot."""

import itertools

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.base import Plant
from vstestbed.sim.build import build_plant


def plant_of(s: Scenario) -> Plant:
    setpoints = s.scene.setpoints(interpolator=s.timing.interpolator(*s.clock))
    return build_plant(s.scene, setpoints=setpoints)[0]


def mean_ramp(u: np.ndarray, k: int, every: int, steps: int) -> np.ndarray:
    return u * min(1.0, (k // every * every + every / 2) / steps)


@pytest.mark.parametrize(("hz", "every"), [(500, 1), (100, 5)])
def test_an_arms_servos_and_the_free_camera_get_a_ramp(hz: int, every: int):
    for name, more in (
        ("arm_ibvs", {"robot.actuation": "ideal"}),
        ("ibvs_book", {"camera.rate_hz": 25}),
    ):
        s = vs.load(
            name,
            more | {"detector": "oracle", "timing.command_hz": hz, "timing.interpolation": "ramp"},
        )
        plant, u, got = plant_of(s), 0.1 * np.array([1.0, -1, 2, 1, 1, -2]), []
        plant.apply(u)
        for k in range(25):
            twist = plant.truth().twist  # the camera is its own flange
            assert plant.advance(1)
            got.append(plant.truth().ctrl if s.robot.joints else twist)
            np.testing.assert_allclose(
                got[-1], mean_ramp(u, k, every, plant.steps_per_frame), atol=1e-12
            )
        assert len(np.unique(got, axis=0)) == 20 // every + 1
        plant.close()


@pytest.mark.parametrize(
    ("name", "hz", "u", "count"),
    [
        ("car_pbvs", 500, [0.5, 0.1], 4),  # its onboard controller, at 100 Hz, takes one of five
        ("car_pbvs", 50, [0.5, 0.1], 2),
        ("quadrotor_hover", 500, [0.3, -0.1, 0.1, 0.2], 20),
        ("quadrotor_hover", 100, [0.3, -0.1, 0.1, 0.2], 4),
        ("omni_ibvs", 250, [2.0, 1.0, -1.0, 3.0], 10),
    ],
)
def test_vehicles_and_craft_get_as_many_setpoints_as_are_sent(
    monkeypatch: pytest.MonkeyPatch, name: str, hz: int, u: list[float], count: int
):
    s = vs.load(
        name,
        {
            "detector": "oracle",
            "timing.command_hz": hz,
            "timing.interpolation": "smooth",
            "camera.rate_hz": 25,
        },
    )
    got, actuate = [], getattr(type(s.robot), "actuate", None)

    def overheard(self, state, setpoint, reading, dt):
        got.append(setpoint.copy())
        assert actuate is not None
        return actuate(self, state, setpoint, reading, dt)

    if s.robot.onboard:
        monkeypatch.setattr(type(s.robot), "actuate", overheard)
    plant = plant_of(s)
    plant.apply(np.array(u))
    for _ in range(plant.steps_per_frame):
        if not s.robot.onboard:
            got.append(plant.truth().ctrl.copy())
        assert plant.advance(1)
    plant.close()
    values = [got[0], *(b for a, b in itertools.pairwise(got) if not np.array_equal(a, b))]
    assert len(values) == count
    np.testing.assert_array_less(0, np.diff([v @ u for v in values]))  # on and on towards the order
    if name != "car_pbvs":  # the way is symmetric about its middle
        np.testing.assert_allclose(values[0] + values[-1], u, atol=1e-12)
