"""The battery against its source and against Ohm's law."""

from __future__ import annotations

import pytest

from vstestbed.effects.rotors import Battery, reference_voltage
from vstestbed.robots.rotors import X4

HOVER = (X4.hover**0.5,) * 4


@pytest.mark.parametrize(("charge", "volts"), [(1.0, 4.1029), (0.5, 3.8034), (0.0, 2.654)])
def test_the_voltage_of_a_cell_without_load(charge, volts):
    """Chen & Rincon-Mora 2006, equation of V_OC."""
    assert Battery(cells=1).open_voltage(charge) == pytest.approx(volts, abs=1e-3)


@pytest.mark.parametrize("power", [0.0, 100.0, 400.0])
def test_under_load_it_falls_by_resistance_times_current(power):
    battery = Battery(resistance_ohm=0.05)
    volts = battery.voltage(0.6, power)
    assert volts == pytest.approx(battery.open_voltage(0.6) - 0.05 * power / volts)


def test_more_than_it_can_give_takes_it_to_half_its_voltage():
    battery = Battery(resistance_ohm=1.0)
    assert battery.voltage(1.0, 1e4) == pytest.approx(0.5 * battery.open_voltage(1.0))


def test_an_hour_of_its_capacity_empties_it():
    battery = Battery(capacity_ah=2.0)
    assert battery.drained(1.0, 2.0, 3600.0) == pytest.approx(0.0)
    assert battery.drained(1.0, 1.0, 3600.0) == pytest.approx(0.5)
    assert battery.drained(0.1, 100.0, 3600.0) == 0.0


def test_the_power_at_hover_is_that_of_the_drag_torques():
    battery = Battery(efficiency=0.5, avionics_w=0.0)
    assert battery.power(HOVER, X4) == pytest.approx(
        2 * 4 * X4.drag_coefficient * X4.hover * HOVER[0]
    )


def test_where_it_was_calibrated_an_order_is_what_the_rotors_do():
    battery = Battery(charge=0.7, reference_charge=0.7)
    assert battery.share_at_start(X4) == pytest.approx(1.0)
    assert Battery(charge=0.2, reference_charge=0.7).share_at_start(X4) < 1.0
    assert reference_voltage(battery, X4) < battery.open_voltage(0.7)
