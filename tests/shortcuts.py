"""One case of many; worker processes and figures, which take seconds and are not what a test is
about; the kinematics of the Puma.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import numpy as np
import pytest

from vstestbed.core.shares import at_once
from vstestbed.report.comparison import page
from vstestbed.robots.puma560 import CHAIN


def one_quick(*cases: Any, every: int = 0) -> list[Any]:
    """Cases of `parametrize`, of which the first is quick and the others are studies; a tuple is a
    case of several arguments.

    every: with 3, the first of each three is quick.
    """
    made = [
        case
        if hasattr(case, "marks")
        else pytest.param(*(case if isinstance(case, tuple) else (case,)))
        for case in cases
    ]
    study = [[pytest.mark.study] if i % (every or len(made)) else [] for i in range(len(made))]
    return [
        pytest.param(*case.values, marks=[*case.marks, *more], id=case.id)
        for case, more in zip(made, study, strict=True)
    ]


class Here:
    """A pool of comparisons and searches in this process: no worker has to start and import the
    package.
    """

    room = 1
    films = True

    def submit(self, request: Any) -> Future[Any]:
        return at_once(request.perform)

    def dispatch(self) -> None:
        pass

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
    return CHAIN.kinematics(q)[0]


def jacobian(q: np.ndarray) -> np.ndarray:
    """Its geometric Jacobian (6, 6) in the flange's frame."""
    return CHAIN.kinematics(q)[1]
