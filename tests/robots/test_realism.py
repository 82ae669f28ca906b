"""A preset of imperfections fills what is not given, and nothing else; another one replaces what it
has filled, and nothing else.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar, Literal

import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError
from vstestbed.core.registry import brief_mapping
from vstestbed.core.spec import spec
from vstestbed.effects.joints import CurrentLoops
from vstestbed.robots.realism import Level, Realistic


@spec
class Play:
    """Backlash of a cart.

    Args:
        width_m: between its two ends [m]; e.g. `0.01`.
        stiffness_npm: of the ends [N/m]; e.g. `1000`.
        seed: of what is drawn [1].
    """

    width_m: float = 0.0
    stiffness_npm: float = 100.0
    seed: int = 0


LAB, FIELD = Play(width_m=1e-3, stiffness_npm=500.0), Play(width_m=1e-2, stiffness_npm=300.0)


@spec
class Cart(Realistic):
    """A robot with two imperfections, of which the field alone has the second.

    Args:
        play: its backlash.
        lag_of_drive_s: its drive's lag [s]; e.g. `0.1`.
        name: what no preset fills.
    """

    kind: Literal["cart"] = "cart"
    play: Play | None = None
    lag_of_drive_s: float | None = None
    name: str = ""
    presets: ClassVar[Mapping[Level, Mapping[str, object]]] = {
        "lab": {"play": LAB},
        "field": {"play": FIELD, "lag_of_drive_s": 0.2},
    }


def made(**given: Any) -> Cart:
    """A cart of blocks as a file has them, which the constructor takes, too."""
    return Cart(**given)


@pytest.mark.parametrize(
    ("level", "play", "lag"), [("none", None, None), ("lab", LAB, None), ("field", FIELD, 0.2)]
)
def test_a_preset_fills_what_is_not_given(
    level: Level, play: Play | None, lag: float | None
) -> None:
    cart = Cart(realism=level)
    assert (cart.play, cart.lag_of_drive_s, cart.realism) == (play, lag, level)


def test_what_is_given_stays_also_where_it_is_nothing() -> None:
    assert Cart(realism="field", play=None).play is None
    assert Cart(realism="field", lag_of_drive_s=None) == replace(
        Cart(realism="field"), lag_of_drive_s=None
    )
    assert Cart(realism="field", lag_of_drive_s=0.0).lag_of_drive_s == 0.0


def test_some_fields_of_a_block_have_the_others_from_the_preset() -> None:
    assert made(realism="field", play={"stiffness_npm": 7.0}).play == Play(
        width_m=1e-2, stiffness_npm=7.0
    )
    assert made(play={"stiffness_npm": 7.0}).play == Play(stiffness_npm=7.0)
    # a whole one
    assert Cart(realism="field", play=Play(stiffness_npm=7.0)).play == Play(stiffness_npm=7.0)


def test_a_copy_is_the_same() -> None:
    cart = Cart(realism="lab")
    assert replace(cart) == cart
    assert replace(cart, name="b").play is cart.play


LEVELS: tuple[Level, ...] = ("none", "lab", "field")
GIVEN: list[dict[str, Any]] = [
    {},
    {"play": {"stiffness_npm": 7.0}},
    {"lag_of_drive_s": 0.3, "name": "b"},
    {"play": {"width_m": 0.5, "stiffness_npm": 5.0}},
]


def test_another_level_replaces_what_the_former_has_filled_alone() -> None:
    for former, now, given in itertools.product(LEVELS, LEVELS, GIVEN):
        before = made(realism=former, **given)
        assert before.at_level(now) == made(realism=now, **given)
        if now != former and not given:
            with pytest.raises(
                ParameterError,
                match=f"realism fills nothing here, where every effect is given as at {former}",
            ):
                replace(before, realism=now)


def test_off_stays_off_at_another_level() -> None:
    assert all(
        made(realism="field", **given | {"play": None}).at_level("lab").play is None
        for given in GIVEN
    )


def test_its_short_text_has_what_the_preset_has_not() -> None:
    for level, given in itertools.product(LEVELS, GIVEN):
        cart = made(realism=level, **given)
        brief = brief_mapping(cart)
        assert made(**brief) == cart
        assert brief == {"kind": "cart"} | ({} if level == "none" else {"realism": level}) | given
    assert brief_mapping(Cart(realism="field", play=None)) == {
        "kind": "cart",
        "realism": "field",
        "play": None,
    }


def test_no_other_level() -> None:
    with pytest.raises(
        ParameterError, match=r"Cart.realism must be one of 'none', 'lab' or 'field', got 'labb'"
    ):
        made(realism="labb")


def test_the_arm_has_it_in_python_as_in_a_file() -> None:
    arm = vs.robots.Puma560(realism="lab", gears=None)
    assert arm.gears is None
    assert arm.drives == CurrentLoops(bandwidth_hz=500.0)
    field = vs.robots.Puma560(
        realism="field",
        drives={"delay_s": 0.002},  # pyright: ignore[reportArgumentType] - a block as YAML has it
    )
    assert field.drives == CurrentLoops(bandwidth_hz=200.0, delay_s=0.002)
    ideal = replace(vs.robots.Puma560(realism="lab"), payload={"mass_kg": 1}).idealised()
    assert (ideal.realism, ideal.gears) == ("none", None)
    assert ideal.geometry_error == arm.geometry_error
