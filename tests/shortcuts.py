"""One case of many; worker processes and figures, which take seconds and are not what a test is about; the kinematics of the Puma."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from concurrent.futures import Future
from typing import Any

import numpy as np
import pytest

from vstestbed.core.shares import at_once
from vstestbed.report.comparison import page
from vstestbed.robots.puma560 import kinematics


def one_quick(*cases: Any) -> list[Any]:
    """Cases of `parametrize`, of which the first is quick and the others are studies; a tuple is a case of several arguments."""
    first, *others = cases
    return [first, *(pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.study) for case in others)]


def every_third_quick(cases: Iterable[Any]) -> list[Any]:
    """Cases of one argument, or of `pytest.param`, of which two thirds are studies."""
    params = [case if hasattr(case, "marks") else pytest.param(case) for case in cases]
    return [
        pytest.param(*param.values, marks=[*param.marks, pytest.mark.study] if i % 3 else param.marks) for i, param in enumerate(params)
    ]


class Here:
    """A pool of comparisons and searches in this process: no worker has to start and import the package."""

    room = 1

    def submit(self, request: Any) -> Future[Any]:
        return at_once(request.perform)

    def tries(self, request: Any) -> int:
        return 1

    def call(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        return at_once(function, *arguments)

    def close(self) -> None:
        pass


def run_here(patch: pytest.MonkeyPatch) -> None:
    """Runs of comparisons and searches are done in this process."""
    for user in ("comparison", "tuning", "convergence"):
        patch.setattr(f"vstestbed.studies.{user}.pool_of", lambda *_: Here())


def draw_one_figure(patch: pytest.MonkeyPatch) -> None:
    """A comparison's report has the first of its figures alone, on its page and for papers."""
    patch.setattr(page, "PLOTS", page.PLOTS[:1])


def forward(q: np.ndarray) -> np.ndarray:
    """T_base_flange (4, 4) of the Puma at the joint angles q (6,) [rad]."""
    return kinematics(q)[0]


def jacobian(q: np.ndarray) -> np.ndarray:
    """Its geometric Jacobian (6, 6) in the flange's frame."""
    return kinematics(q)[1]
