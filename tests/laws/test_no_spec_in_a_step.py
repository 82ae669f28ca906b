"""A law's step builds no spec: its bounds are for scenarios, and what a step computes may lie
outside of them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from tests.catalogue.test_catalogue import LAW_PARAMETERS, SMALL_PICTURES
from vstestbed.core import spec
from vstestbed.core.named_files import folder
from vstestbed.effects.airframe import RotorDrag
from vstestbed.features import FEATURES
from vstestbed.laws import LAWS, Predictive
from vstestbed.laws.feedforward import FEEDFORWARDS
from vstestbed.laws.solve import Solve
from vstestbed.loop.controller import GuardedLaw
from vstestbed.robots import Quadrotor
from vstestbed.robots.rotors import X4
from vstestbed.testing.laws import quick

Built = Callable[[vs.Scenario, int], set[str]]
FEW, ROUND = ("polygon", "segment"), ("ellipse", "moments")
"""Features that tell fewer than six motions; that need other targets than a square."""


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> Built:
    """Runs a scenario for some frames; the specs that were built in the steps of its law, each with
    where.
    """
    found: set[str] = set()
    within: list[object] = []
    construct, step = spec.construct, GuardedLaw.step

    def constructed(made: object, *given: Any) -> None:
        if within:
            caller = sys._getframe(2)
            found.add(f"{type(made).__name__} in {caller.f_code.co_filename}:{caller.f_lineno}")
        construct(made, *given)

    def stepped(self: GuardedLaw, *given: Any) -> Any:
        within.append(self)
        try:
            return step(self, *given)
        finally:
            within.pop()

    monkeypatch.setattr(spec, "construct", constructed)
    monkeypatch.setattr(GuardedLaw, "step", stepped)

    def run(scenario: vs.Scenario, frames: int) -> set[str]:
        with vs.Session(scenario) as session:
            frame, moved = session.reset(), False
            while frame.outcome is None and frame.timing.number < frames:
                moved |= bool(frame.command.twist.any())
                frame = session.step()
        assert moved and frame.outcome is not vs.Outcome.law_failed, frame.command.rest_reason
        return found

    return run


def of(kind: str) -> vs.Scenario:
    """A quick scenario with a law of a kind."""
    if kind == "photometric":
        return vs.load("camera_photometric", SMALL_PICTURES)
    if kind == "policy":
        return vs.load("arm_policy", {"detector": "oracle", "robot.actuation": "ideal"})
    law = LAWS.members[kind](**LAW_PARAMETERS.get(kind, {}))
    return replace(quick(law.tasks[0]), law=law)


@pytest.mark.parametrize("kind", LAWS.members)
def test_no_law(kind: str, built: Built) -> None:
    assert built(of(kind), 12) == set()


@pytest.mark.parametrize(
    "law",
    [
        # 12 frames do not end that of the defaults
        {"kind": "uncalibrated", "excitation": {"amplitude_px": 4.0, "time_s": 0.1}},
        {
            "kind": "uncalibrated",
            "excitation": {"amplitude_px": 4.0, "time_s": 0.1},
            "dynamic": True,
        },
        {"kind": "predictive", "feedforward": "integral"},
        {"kind": "ibvs", "redundant": True, "projection": "large"},
        {
            "kind": "ibvs",
            "visibility": {"margin_px": 20.0},
            "smooth_start_s": 0.2,
            "keep_last": True,
        },
        *({"kind": "ibvs", "feedforward": kind} for kind in FEEDFORWARDS.members),
        *(
            {"kind": "ibvs", "feature": kind, "redundant": kind in FEW}
            for kind in FEATURES.members
            if kind not in ROUND
        ),
    ],
    ids=lambda law: "-".join(str(value) for value in law.values() if isinstance(value, str)),
)
def test_no_part_of_a_law(law: dict[str, object], built: Built) -> None:
    assert (
        built(
            vs.load("ibvs_book", {"law": law, "detector": "oracle"}),
            60 if law["kind"] == "uncalibrated" else 8,
        )
        == set()
    )


@pytest.mark.study
@pytest.mark.parametrize(
    "name",
    sorted(path.stem for path in folder("scenarios").glob("*.yaml") if path.stem != "camera_vitvs"),
)
def test_no_law_of_a_bundled_scenario(name: str, built: Built) -> None:
    assert built(vs.load(name), 60) == set()


def test_what_a_step_computes_may_lie_outside_of_the_bounds_of_a_field() -> None:
    """The damping of `uncalibrated` is error / trust_px, the trust of `predictive` a share of the
    distance in a period.
    """
    A, b = np.diag([2.0, 1.0]), np.ones(2)
    assert np.allclose(Solve().least_squares(A, b, at_least=1e6), A @ b / 1e12, rtol=1e-9)
    assert np.allclose(
        Solve(damping=0.5).least_squares(A, b, at_least=0.1), Solve(damping=0.5).least_squares(A, b)
    )
    assert Predictive()._trusted(np.array([[0.0, 0.0, 500.0]]), 0.001) == (50_000.0, 100.0)
    # under the least speed that a scenario may give
    assert Predictive()._trusted(np.array([[0.0, 0.0, 1e-7]]), 0.04)[0] < 1e-6
    craft = Quadrotor(rotor_drag=RotorDrag(), parameters=replace(X4, drag_area_m2=0.0))
    assert craft.body.changes[2][-1] == (0.0,)
