"""A law that fails in a step: whatever it raises or returns, the robot is stopped, and no error of
the scenario is told.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError
from vstestbed.laws import IBVS
from vstestbed.testing.laws import quick

NAN = np.full(6, np.nan)


def wild(value: Any) -> Any:
    """A step that goes well for three frames, and then gives or raises `value`."""
    step = IBVS.step

    def stepped(self: IBVS, state: Any, observation: Any, goal: Any, basis: Any) -> Any:
        state, command = step(self, state, observation, goal, basis)
        if observation.t < 0.1:
            return state, command
        if isinstance(value, BaseException):
            raise value
        return (state, value(command)) if callable(value) else value

    return stepped


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (
            ParameterError("damping", "must be <= 1000", 2000),
            "raised ParameterError: damping must be <= 1000, got 2000",
        ),
        (SystemExit(3), "raised SystemExit: 3"),
        (None, "returned NoneType; its step must return (state, Command)"),
        (
            lambda c: replace(c, twist=[0.0] * 6),
            (
                "gave the twist [0.0, 0.0, 0.0, 0.0, 0.0, 0.0];"
                " the twist of a Command must be an array"
            ),
        ),
        (
            lambda c: replace(c, twist=np.zeros(3)),
            "gave the twist array([0., 0., 0.]); the twist of a Command must be an array of six",
        ),
        (lambda c: replace(c, twist=NAN), "gave a twist that is not finite, [nan"),
        (lambda c: replace(c, rates=NAN), "gave rates that are not finite, [nan"),
        (
            lambda c: replace(c, rates=np.zeros(9)),
            "gave 9 rates; those of a Command must be the velocities of `Obs",
        ),
        (
            lambda c: replace(c, free=((1.0, NAN[:, None]),)),
            "gave free motions that are not finite",
        ),
    ],
    ids=[
        "ParameterError",
        "SystemExit",
        "None",
        "list",
        "short",
        "twist",
        "rates",
        "nine rates",
        "free",
    ],
)
def test_whatever_it_does_the_robot_is_stopped(
    value: Any, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(IBVS, "step", wild(value))
    r = vs.run(
        vs.load(
            "arm_ibvs", {"detector": "oracle", "robot.actuation": "ideal", "stop.duration_s": 2.0}
        )
    )
    assert r.outcome is vs.Outcome.law_failed and r.reason.startswith(f"law ibvs {words}")


def test_also_at_the_next_goal_of_a_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """`init` is asked again at each via point."""
    begun: list[object] = []
    init = IBVS.init

    def first_only(self: IBVS, goal: Any) -> Any:
        begun.append(goal)
        if len(begun) > 1:
            raise ValueError("no such goal")
        return init(self, goal)

    monkeypatch.setattr(IBVS, "init", first_only)
    r = vs.run(vs.load("omni_via_points", {"robot.wheels": "planar", "detector": "oracle"}))
    assert r.outcome is vs.Outcome.law_failed
    assert r.reason.startswith("law ibvs raised ValueError: no such goal (")
    assert len(begun) == 2


def test_ctrl_c_is_no_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(IBVS, "step", wild(KeyboardInterrupt()))
    with vs.Session(quick("view")) as session, pytest.raises(KeyboardInterrupt):
        session.reset()
        while True:
            session.step()
