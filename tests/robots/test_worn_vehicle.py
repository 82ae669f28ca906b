"""Imperfections of vehicles as their robots have them: drawn wheels and floors, lag, presets, what
cannot be combined.
"""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.core.planar import GroundPose
from vstestbed.core.spec import spec
from vstestbed.effects.body import loosen, put
from vstestbed.effects.floor import UnevenFloor
from vstestbed.effects.wheels import WHEELS, Tyres, WheelSpread
from vstestbed.robots.base import Reading
from vstestbed.robots.car import Car, CarLimits
from vstestbed.robots.omni import Omni
from vstestbed.robots.realism import Level
from vstestbed.robots.vehicle import GroundBox, GroundStart, Vehicle

BOX = GroundStart(nominal=GroundPose(x=1.0), random=GroundBox(x=1.0, y=1.0, heading_deg=20.0))


class TestWheelSpread:
    def test_what_is_listed_counts_and_stays(self) -> None:
        listed = WheelSpread(errors=(0.0, 0.01, 0.0, -0.01))
        assert listed.drawn(np.random.default_rng(0)) == listed
        assert listed.factors == (1.0, 1.01, 1.0, 0.99)

    def test_errors_are_listed_or_drawn(self) -> None:
        with pytest.raises(ParameterError, match="must be none with sigma > 0"):
            WheelSpread(sigma=0.01, errors=(0.0, 0.01, 0.0, -0.01))

    def test_what_is_drawn_has_its_size(self) -> None:
        rng, spread = np.random.default_rng(0), WheelSpread(sigma=0.004)
        assert spread.factors == (1.0,) * 4
        drawn = np.array([spread.drawn(rng).factors for _ in range(500)]) - 1
        assert drawn.std() == pytest.approx(0.004, rel=0.05)  # of 2000 numbers: 1.6 %
        assert abs(drawn.mean()) < 3 * 0.004 / math.sqrt(2000)


@pytest.mark.parametrize("kind", [Car, Omni])
class TestDrawn:
    WORN: ClassVar[dict[str, object]] = {
        "wheel_spread": WheelSpread(sigma=0.01),
        "uneven_floor": UnevenFloor(rms_m=0.001),
    }

    def test_a_start_draws_the_start_alone(self, kind: type[Car | Omni]) -> None:
        worn = kind(start=BOX, **self.WORN)
        plain, with_wear = (
            kind(start=BOX).randomised(np.random.default_rng(3)),
            worn.randomised(np.random.default_rng(3)),
        )
        assert plain.start == with_wear.start
        assert (with_wear.wheel_spread, with_wear.uneven_floor) == (
            worn.wheel_spread,
            worn.uneven_floor,
        )

    def test_each_seed_has_its_wheels_and_its_floor(self, kind: type[Car | Omni]) -> None:
        one, again, other = (
            kind(**self.WORN).drawn(np.random.default_rng(seed)) for seed in (1, 1, 2)
        )
        assert one == again
        assert one.wheel_spread != other.wheel_spread and one.uneven_floor != other.uneven_floor

    @pytest.mark.parametrize("name", ["wheel_spread", "uneven_floor"])
    def test_each_is_the_same_without_the_other(self, name: str, kind: type[Car | Omni]) -> None:
        both, alone = (
            kind(**blocks).drawn(np.random.default_rng(1))
            for blocks in (self.WORN, {name: self.WORN[name]})
        )
        assert getattr(both, name) == getattr(alone, name)

    def test_a_seed_that_is_given_stays(self, kind: type[Car | Omni]) -> None:
        given = kind(uneven_floor=UnevenFloor(rms_m=0.001, seed=7))
        assert given.drawn(np.random.default_rng(1)) == given and not given.draws

    def test_nothing_is_drawn_where_nothing_is_worn(self, kind: type[Car | Omni]) -> None:
        rng, plain = np.random.default_rng(3), kind(start=BOX)
        before = rng.bit_generator.state
        assert plain.drawn(rng) is plain and not plain.draws
        assert rng.bit_generator.state == before


class TestDriveLag:
    def test_a_step_takes_the_time_constant(self) -> None:
        base = Omni(drive_lag_s=0.1)
        state, setpoint = base.begin(), np.array([1.0, 2.0, 3.0, -1.0])
        period = base.control_period_s
        assert period is not None
        for _ in range(round(0.1 / period)):
            state, ctrl = base.actuate(state, setpoint, Reading(np.zeros(4), np.zeros(4)), period)
        np.testing.assert_allclose(ctrl, setpoint * (1 - math.exp(-1)), rtol=1e-9)

    def test_a_ramp_is_followed_behind_by_the_time_constant(self) -> None:
        """The car's order rises by its acceleration; of a drive with lag it is late by drive_lag_s:
        a tau / r at the wheels.
        """
        car = Car(drive_lag_s=0.08, limits=CarLimits(speed_mps=3.0, acceleration_mps2=1.0))
        state, dt = car.begin(), 0.01
        for k in range(100):  # wheels that are as told: nothing for the integral
            told = min(3.0, (k + 1) * dt) / 0.15
            state, ctrl = car.actuate(
                state,
                np.array([3.0, 0.0]),
                Reading(np.zeros(7), np.array([0, 0, 0, told, told, 0, 0])),
                dt,
            )
        behind = state[0] / 0.15 - ctrl[0]
        # The lag acts from the period on in which it is told: half a period less than in continuous
        # time.
        assert behind == pytest.approx(1.0 / 0.15 * (0.08 - dt / 2), rel=0.01)

    def test_without_it_the_setpoint_is_the_control(self) -> None:
        assert Omni().onboard is None and Omni(drive_lag_s=0).onboard is None


class TestChanges:
    def test_none_without_imperfections(self) -> None:
        assert Car().body.changes == () and Omni().body.changes == ()
        assert Car(steering_play_deg=0.0, drive_lag_s=0.0).body.changes == ()

    def test_rolling_resistance_is_a_share_of_the_weight(self) -> None:
        """The torques at the radius brake by c m g in all."""
        for robot, mass, radius in (
            (Car(rolling_resistance=0.02), 60.0, 0.15),
            (Omni(rolling_resistance=0.02), 8.0, 0.05),
        ):
            torques = [
                value for _, _, _, field, value in robot.body.changes if field == "frictionloss"
            ]
            assert len(torques) == 4
            assert sum(torques) / radius == pytest.approx(0.02 * mass * 9.81)

    def test_play_is_in_radians(self) -> None:
        (change,) = Car(steering_play_deg=2.0).body.changes
        assert change == (loosen, "steering", math.radians(2.0))

    def test_tyres_that_slip_take_the_friction_of_the_contacts(self) -> None:
        assert Car(tyres=Tyres()).body.changes == tuple(
            (put, "geom", f"{name}_contact", "condim", 1) for name in WHEELS
        )


@pytest.mark.parametrize("level", ["lab", "field"])
def test_presets_fill_all_imperfections(level: Level) -> None:
    car, base = Car(realism=level), Omni(realism=level)
    for robot in (car, base):
        assert robot.wheel_spread and robot.drive_lag_s and robot.uneven_floor
    assert car.tyres and car.steering_play_deg and base.rolling_resistance
    assert Car(realism=level, drive_lag_s=0.0).drive_lag_s == 0.0


def test_odometry_goes_by_the_nominal_wheels() -> None:
    before, now = (
        Reading(np.zeros(7), np.zeros(7)),
        Reading(np.array([0, 0, 0, 1.0, 1.2, 0, 0]), np.zeros(7)),
    )
    worn = Car(wheel_spread=WheelSpread(errors=(0.0, 0.0, 0.01, -0.01)))
    np.testing.assert_array_equal(worn.odometry(before, now, 0.1), Car().odometry(before, now, 0.1))


@pytest.mark.parametrize(
    "wrong",
    [{"realism": "lab"}, {"rolling_resistance": 0.02}, {"uneven_floor": UnevenFloor(rms_m=0.001)}],
)
def test_planar_wheels_have_nothing_of_the_floor(wrong: dict[str, object]) -> None:
    with pytest.raises(ParameterError, match="must be rollers with"):
        Omni(wheels="planar", **wrong)
    assert Omni(wheels="planar", drive_lag_s=0.1).onboard


def test_a_motor_too_weak_for_the_rolling_resistance_is_refused() -> None:
    with pytest.raises(ParameterError, match="motor_torque_nm"):
        Car(rolling_resistance=0.3)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("wheel_spread", WheelSpread(sigma=0.01)),
        ("rolling_resistance", 0.02),
        ("drive_lag_s", 0.1),
        ("realism", "lab"),
    ],
)
def test_a_vehicle_whose_class_has_no_imperfect_wheels_refuses_them(
    field: str, value: object
) -> None:
    @spec
    class Kart(Vehicle):
        """A vehicle whose model knows no imperfection of its wheels."""

    with pytest.raises(ParameterError, match=f"^{field} "):
        Kart(**{field: value})
