"""A preset of imperfections fills what is not given, and nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.core.spec import spec
from vstestbed.robots.realism import Level, Realistic


@spec
class Play:
    """Backlash of a cart.

    Args:
        width_m: between its two ends [m]; e.g. `0.01`.
    """

    width_m: float = 0.0


@spec
class Cart(Realistic):
    """A robot with one imperfection.

    Args:
        play: its backlash.
    """

    play: Play | None = None
    presets: ClassVar[Mapping[Level, Mapping[str, object]]] = {"lab": {"play": Play(width_m=1e-3)}, "field": {"play": Play(width_m=1e-2)}}


@pytest.mark.parametrize(("level", "width_m"), [("lab", 1e-3), ("field", 1e-2)])
def test_a_preset_fills_what_is_not_given(level: Level, width_m: float) -> None:
    assert Cart(realism=level).play == Play(width_m=width_m)


def test_none_leaves_all_off() -> None:
    assert Cart().play is None


def test_what_is_given_stays_also_where_it_is_nothing() -> None:
    assert Cart(realism="field", play=Play(width_m=0.0)).play == Play(width_m=0.0)


def test_a_copy_is_the_same() -> None:
    cart = Cart(realism="lab")
    assert replace(cart) == cart


def test_a_block_is_left_out() -> None:
    assert Cart(realism="field", without=("play",)).play is None
    with pytest.raises(ParameterError, match=r"without must be blocks of `realism: field`, which has play, got 'plai'"):
        Cart(realism="field", without=("plai",))
