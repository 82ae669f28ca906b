"""The floor reaches as far as a craft can fly: its range finder meets it, and its feet."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.robots.flight import FlightReading, descend
from vstestbed.robots.quadrotor import STANDING_M
from vstestbed.sim.base import Plant
from vstestbed.sim.build import build_plant

PLACES = [(3.0, 3.0), (50.0, -120.0), (-990.0, 3.0)]


def craft(x: float, y: float, height: float, floor_z: float = 0.0) -> Plant:
    s = vs.load(
        "quadrotor_hover",
        {
            "robot.start.nominal": {"xyz": [x, y, height]},
            "world.floor_z": floor_z,
            "detector": "oracle",
        },
    )
    return build_plant(s.scene)[0]


@pytest.fixture
def opened() -> Callable[..., Plant]:
    made: list[Plant] = []

    def build(*given: float) -> Plant:
        made.append(craft(*given))
        return made[-1]

    yield build
    for plant in made:
        plant.close()


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("floor_z", [0.0, -0.7])
def test_the_range_finder_meets_the_floor(
    place: tuple[float, float], floor_z: float, opened: Callable[..., Plant]
):
    reading = opened(*place, 2.0, floor_z).reading()
    assert isinstance(reading, FlightReading)
    # Five standard deviations of the range finder, whose site is 3 cm from the centre at the most.
    assert reading.range_m == pytest.approx(2.0 - floor_z, abs=0.05 + 0.03)


@pytest.mark.parametrize("place", PLACES)
def test_a_craft_that_sets_down_knows_it(place: tuple[float, float], opened: Callable[..., Plant]):
    plant = opened(*place, 0.5)
    for _ in range(100):
        plant.apply(descend(0.4))
        plant.advance(round(0.04 / plant.step_s))
        reading = plant.reading()
        assert isinstance(reading, FlightReading) and reading.estimate is not None
        if reading.estimate.stands:
            break
    assert reading.estimate.stands
    truth = plant.truth()
    height = truth.T_world_camera[2, 3]
    assert truth.feet and not truth.contact
    assert height == pytest.approx(STANDING_M, abs=0.02)


def test_the_far_floor_is_no_part_of_any_picture(opened: Callable[..., Plant]):
    model = opened(0.0, 0.0, 2.0)._stage.model  # type: ignore[attr-defined] - not of the ideal plant
    ground = model.geom("ground")
    # the floor itself is endless to contacts
    assert ground.contype == 0 and ground.conaffinity == 0
    assert np.flatnonzero(model.geom_group == ground.group[0]).tolist() == [ground.id]
