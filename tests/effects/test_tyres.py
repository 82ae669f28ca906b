"""Tyres with slip: the brush against its formula, the way that the force takes, a spring at rest,
the friction circle.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.effects.wheels import LOW_SPEED, TyreForces, Tyres

LOAD, MU, DT = 150.0, 0.8, 0.002


def steady(
    tyres: Tyres, sliding: tuple[float, float], speed: float, friction: float = MU
) -> tuple[float, float]:
    """The force after a long way with a held slip [N]."""
    u = (0.0, 0.0)
    for _ in range(round(20 * tyres.relaxation_m / (speed * DT))):
        u = tyres.deflected(u, sliding, speed, friction, DT)
    return tyres.force(u, sliding, speed, friction, LOAD)


def test_the_slope_at_zero_is_the_cornering_stiffness() -> None:
    tyres = Tyres(stiffness=8.0)
    _, across = steady(tyres, (0.0, 1e-4), 1.0)
    assert -across / 1e-4 == pytest.approx(8.0 * LOAD, rel=1e-3)


@pytest.mark.parametrize("slip", [0.02, 0.1, 0.25, 0.5])
def test_a_held_slip_has_the_force_of_the_brush(slip: float) -> None:
    """Pacejka's polynomial of a brush with parabolic pressure: 3 mu F_z theta s (1 - theta s +
    (theta s)^2 / 3) up to theta s = 1.
    """
    theta = 8.0 / (3 * MU)
    x = theta * slip
    brush = 3 * MU * LOAD * x * (1 - x + x * x / 3) if x < 1 else MU * LOAD
    assert math.hypot(
        *steady(Tyres(stiffness=8.0), (0.6 * slip, 0.8 * slip), 1.0)
    ) == pytest.approx(brush, rel=1e-6)


def test_the_force_is_against_the_sliding() -> None:
    along, across = steady(Tyres(), (0.03, 0.04), 1.0)
    assert along < 0 and across == pytest.approx(along * 4 / 3)


@pytest.mark.parametrize("sigma", [0.1, 0.4])
@pytest.mark.parametrize("speed", [0.7, 3.0])
def test_a_step_of_slip_takes_the_relaxation_length(sigma: float, speed: float) -> None:
    """63 % of the force after the way sigma, at any speed."""
    tyres, slip, u = Tyres(relaxation_m=sigma), 1e-4, (0.0, 0.0)
    steps = round(sigma / (speed * DT / 10))
    for _ in range(steps):
        u = tyres.deflected(u, (0.0, slip * speed), speed, MU, DT / 10)
    way = steps * speed * DT / 10
    force = -tyres.force(u, (0.0, slip * speed), speed, MU, LOAD)[1] / (
        tyres.stiffness * LOAD * slip
    )
    assert force == pytest.approx(1 - math.exp(-way / sigma), rel=1e-3)


def test_at_rest_it_is_a_spring() -> None:
    tyres = Tyres(stiffness=8.0, relaxation_m=0.2)
    u = tyres.deflected((0.0, 0.0), (0.0, 1e-3), 0.0, MU, 0.5)
    assert -tyres.force(u, (0.0, 0.0), 0.0, MU, LOAD)[1] == pytest.approx(
        8.0 * LOAD / 0.2 * 0.5e-3, rel=1e-2
    )


def test_a_spring_that_slid_turns_at_once() -> None:
    tyres = Tyres()
    u = tyres.deflected((0.0, 0.0), (0.0, 1.0), 0.0, MU, 5.0)  # 5 m aside
    assert -tyres.force(u, (0.0, 0.0), 0.0, MU, LOAD)[1] == pytest.approx(MU * LOAD)
    most = 3 * MU * tyres.relaxation_m / tyres.stiffness
    assert tyres.deflected(u, (0.0, -1.0), 0.0, MU, most)[1] == pytest.approx(0.0, abs=1e-12)


def test_the_force_is_never_more_than_friction() -> None:
    rng, tyres = np.random.default_rng(0), Tyres()
    for u_x, u_y, s_x, s_y, speed in rng.uniform(-1, 1, (200, 5)).tolist():
        assert math.hypot(
            *tyres.force((u_x, u_y), (s_x, s_y), abs(speed), MU, LOAD)
        ) <= MU * LOAD * (1 + 1e-12)


def test_the_damper_is_gone_at_speed() -> None:
    assert Tyres().force((0.0, 0.0), (0.0, 0.1), LOW_SPEED, MU, LOAD) == (0.0, 0.0)
    assert Tyres().force((0.0, 0.0), (0.0, 0.01), 0.0, MU, LOAD)[1] < 0


def test_the_rear_may_be_softer() -> None:
    assert Tyres(stiffness=8, rear_stiffness=6).rear == Tyres(stiffness=6)
    assert Tyres().rear == Tyres()


@pytest.mark.parametrize("which", ["stiffness", "rear_stiffness"])
def test_a_patch_too_stiff_for_the_step_is_refused(which: str) -> None:
    with pytest.raises(ParameterError, match=r"relaxation_m.*at least 0\.1 m at a stiffness of 20"):
        Tyres(**{which: 20.0}, relaxation_m=0.05)


def test_a_wheel_in_the_air_has_no_force_and_lands_with_a_patch_at_rest() -> None:
    # of no vehicle: what a wheel without load does asks for none
    forces = TyreForces.__new__(TyreForces)
    forces._deflection = [(1e-3, -1e-3)] * 4
    assert forces._wheel(2, 0.0, [0.0, 1.0], [0.1] * 6, 1e-3) == (0.0,) * 6
    assert forces._deflection == [(1e-3, -1e-3)] * 2 + [(0.0, 0.0), (1e-3, -1e-3)]
