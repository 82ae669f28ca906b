"""The fence, for every bundled scenario: whatever judge and log are told to be true, the same is
seen, asked for and commanded.
"""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs
from tests.robots.arms import where_installed
from vstestbed.core.geometry import exp
from vstestbed.core.named_files import bundled_scenarios
from vstestbed.core.outcome import Outcome
from vstestbed.endings import Termination
from vstestbed.loop.shutter import CameraClock
from vstestbed.sim.base import Truth

DURATION_S = 1.2
OF_PICTURES = "keypoints", "patch", "region", "none"
"""Detectors of scenarios without markers."""


def corrupted(truth: Truth, rng: np.random.Generator) -> Truth:
    """The same with garbage in every field but the oracle's: poses moved at random, flags turned,
    numbers drawn anew.
    """
    garbage: dict[str, object] = {}
    for name, value in truth._asdict().items():
        if name in ("p_camera", "hidden"):  # what the oracle is given
            continue
        if name.startswith("T_world"):
            garbage[name] = value @ exp(rng.normal(size=6))
        elif isinstance(value, np.ndarray):
            garbage[name] = ~value if value.dtype == bool else rng.normal(size=value.shape)
        elif isinstance(value, tuple):
            garbage[name] = tuple(rng.normal(size=len(value)))
        else:
            garbage[name] = "" if value else "hub and floor"
    return truth._replace(**garbage)


class Commands:
    """Keeps what a frame gave to the robot, and what the law was given."""

    def __init__(self) -> None:
        self.kept: list[tuple[np.ndarray, ...]] = []

    def frame(self, frame: vs.Frame) -> None:
        o = frame.observation
        seen = [
            array.copy()
            for eye in frame.cameras.values()
            for array in (eye.uv, eye.depth, eye.goal_uv)
        ]
        self.kept.append(
            (
                frame.command.u.copy(),
                frame.allocation.setpoint.copy(),
                o.uv.copy(),
                o.depth.copy(),
                frame.goal.uv.copy(),
                *seen,
            )
        )


@pytest.mark.study
@pytest.mark.parametrize("name", where_installed(bundled_scenarios()))
def test_a_corrupted_truth_changes_no_command(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    honest, lied_to, rng = Commands(), Commands(), np.random.default_rng(0)
    send, own = CameraClock._send, vs.load(name)
    # markers by the oracle, which needs no pictures; what is seen without markers by its own
    # detector
    scenario = (
        own if own.detector.kind in OF_PICTURES else vs.load(name, {"detector": {"kind": "oracle"}})
    )
    # a judge that believes the lies would end the run at once: here the clock does
    monkeypatch.setattr(
        Termination,
        "verdict",
        lambda termination, frame: (Outcome.timed_out, "") if frame.t >= DURATION_S else None,
    )
    vs.run(scenario, watch=[honest])
    # every camera's pictures leave for the controller here, with the truth that stays behind
    monkeypatch.setattr(
        CameraClock,
        "_send",
        lambda self, at, picture, made: send(self, at, picture, (made[0], corrupted(made[1], rng))),
    )
    vs.run(scenario, watch=[lied_to])
    assert len(honest.kept) == len(lied_to.kept) > 5
    for told, lied in zip(honest.kept, lied_to.kept, strict=True):
        assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(told, lied, strict=True))
