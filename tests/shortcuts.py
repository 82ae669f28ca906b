"""What takes seconds and is not what a test is about: worker processes, and the figures of a comparison's report."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import pytest

from vstestbed.core.shares import at_once
from vstestbed.report.comparison import page


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
