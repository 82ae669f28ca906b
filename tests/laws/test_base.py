"""LawBase: a law of twenty lines runs in the loop; a law that breaks the contract is refused when
it is registered.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pytest

from vstestbed import load, run
from vstestbed.core.errors import ParameterError
from vstestbed.core.spec import spec
from vstestbed.features import Point
from vstestbed.features.depth import PnP
from vstestbed.laws import IBVS, LAWS, Command, LawBase
from vstestbed.laws.solve import least_squares
from vstestbed.testing import check_law


def bare() -> type:
    @LAWS.add
    @spec
    class Bare(LawBase):
        """The textbook law of image points, and nothing else."""

        kind: Literal["bare"] = "bare"
        gain: float = 1.0

        def step(self, state, observation, goal, basis):
            if not observation.seen.all():
                return state, Command.rest(basis, "a marker is hidden")
            point = Point()
            e = point.error(point.measure(observation.xy), point.measure(goal.xy))
            u = -self.gain * least_squares(
                point.interaction(observation.xy, observation.depth) @ basis, e
            )
            return state, self.limits.command(u, basis)

    return Bare


@pytest.mark.usefixtures("own_kinds")
def test_a_bare_law_runs_and_orders_what_ibvs_does() -> None:
    bare()
    common: dict[str, Any] = {
        "detector": "oracle",
        "robot.actuation": "ideal",
        "stop.duration_s": 2.0,
    }
    own = load("arm_ibvs", common | {"law": {"kind": "bare", "gain": 1.0}})
    assert (
        own.law.depth == PnP()
        and own.law.tasks == ("view",)
        and own.law.cruise_mps is None
        and own.law.rest_m == 0
    )
    made, bundled = run(own), run(replace(own, law=IBVS(gain=1.0)))  # pyright: ignore[reportArgumentType]
    for column in ("cmd_vx", "cmd_wz"):
        assert np.array_equal(made[column], bundled[column])


@pytest.mark.usefixtures("own_kinds")
def test_the_suite_finds_what_is_read_and_not_named(monkeypatch: pytest.MonkeyPatch) -> None:
    law = bare()
    monkeypatch.setattr(law, "inputs", ("xy",))
    words = (
        r"^bare reads observation\.depth, which its `inputs` do not name;"
        r" write inputs = \('xy', 'depth'\)$"
    )
    with pytest.raises(AssertionError, match=words):
        check_law(law())

    @LAWS.add
    @spec
    class Rays(LawBase):
        kind: Literal["rays"] = "rays"

        def step(self, state, observation, goal, basis):
            return state, Command.rest(basis, str(observation.ray[0]))

    with pytest.raises(
        AssertionError,
        match=(
            r"law_failed, .*; its `inputs` do not name ray, which it reads,"
            r" and which may be None then$"
        ),
    ):
        check_law(Rays())


def test_half_as_many_markers_as_motions_by_default() -> None:
    assert [LawBase().markers_needed(np.eye(6)[:, :n]) for n in (2, 3, 6)] == [1, 2, 3]


def step(self, state, observation, goal, basis): ...


def test_a_wrong_law_is_refused_when_it_is_registered() -> None:
    for make, sentence in (
        (
            lambda: type("Mine", (LawBase,), {"step": step}),
            r"^Mine is not a spec; a law is a class with @spec",
        ),
        (
            lambda: spec(type("Mine", (LawBase,), {"step": step})),
            r"^kind is missing: Mine needs `kind: Literal",
        ),
        (
            lambda: named(),
            r"^Mine lacks step\(state, observation, goal, basis\); add what is missing",
        ),
        (
            lambda: named(object, step=step),
            (
                r"^Mine lacks tasks, inputs, depth, feature, limits, .*;"
                r" derive it from vstestbed.laws.base.Law, .* all but kind and step$"
            ),
        ),
        (
            lambda: named(step=lambda self, observation, goal: None),
            r"^Mine\.step must take the arguments of step\(state, observation, goal, basis\)",
        ),
        (
            lambda: named(step=step, init=lambda self: None),
            r"^Mine\.init must take the arguments of init\(goal\)",
        ),
        (
            lambda: named(step=step, inputs=("xy", "depht")),
            r"^Mine\.inputs: 'depht' is no valid word; did you mean 'depth'",
        ),
    ):
        with pytest.raises(ParameterError, match=sentence):
            LAWS.add(make())
        assert "mine" not in LAWS.members


def named(base: type = LawBase, **body: object) -> type:
    """A spec `Mine` of kind `mine`."""
    return spec(
        type(
            "Mine", (base,), {"__annotations__": {"kind": Literal["mine"]}, "kind": "mine", **body}
        )
    )


def test_a_subclass_without_a_kind_of_its_own_is_refused() -> None:
    with pytest.raises(
        ParameterError, match=r"'ibvs' is already a law .*; give Mine a `kind` of its own"
    ):
        LAWS.add(spec(type("Mine", (IBVS,), {})))
