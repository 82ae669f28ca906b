"""One case of many; worker processes and figures, which take seconds and are not what a test is
about; the kinematics of the Puma.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future
from importlib import import_module
from typing import Any

import numpy as np
import pytest

from vstestbed.core.apps import bundled
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


def of_apps(cases: Iterable[str], apps: Mapping[str, str]) -> list[Any]:
    """Cases of `parametrize` by their names; one of an app is skipped where that is not there."""
    found: list[Any] = []
    for name in cases:
        marks = [pytest.mark.app(apps[name])] if name in apps else []
        found.append(pytest.param(name, marks=marks, id=name))
    return found


def is_here(file: str) -> bool:
    """Whether a file of the package, `apps/ros/bag.py`, is none of an app that is not there."""
    room, *inner = file.split("/")
    return room != "apps" or inner[0] in bundled()


def in_app(place: str) -> Callable[..., Any]:
    """A function of an app, `package.module:name`, imported when it is called: tables of tests can
    name it where the app is not there.
    """
    module, _, name = place.partition(":")

    def call(*arguments: Any) -> Any:
        return getattr(import_module(module), name)(*arguments)

    return call


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
    users = {
        "vstestbed.studies.comparison": "",
        "vstestbed.apps.tune.tuning": "tune",
        "vstestbed.apps.maps.convergence": "maps",
    }
    for user, app in users.items():
        if not app or app in bundled():
            patch.setattr(f"{user}.pool_of", lambda *_: Here())


def draw_one_figure(patch: pytest.MonkeyPatch) -> None:
    """A comparison's report has the first of its figures alone, on its page and for papers."""
    patch.setattr(page, "PLOTS", page.PLOTS[:1])


def forward(q: np.ndarray) -> np.ndarray:
    """T_base_flange (4, 4) of the Puma at the joint angles q (6,) [rad]."""
    return CHAIN.kinematics(q)[0]


def jacobian(q: np.ndarray) -> np.ndarray:
    """Its geometric Jacobian (6, 6) in the flange's frame."""
    return CHAIN.kinematics(q)[1]
