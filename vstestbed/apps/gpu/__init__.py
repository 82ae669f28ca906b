"""Pictures of many runs by one device, with MuJoCo Warp."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from vstestbed.core.apps import App
from vstestbed.core.errors import EnvironmentLackError

if TYPE_CHECKING:
    from vstestbed.apps.gpu.together import TogetherPool
    from vstestbed.scenario.scenario import Scenario

APP = App(executors={"warp": "vstestbed.apps.gpu:pool"})


def pool(workers: int, folder: Path, flown: Callable[[], Iterable[Scenario]]) -> TogetherPool:
    """The pool of `--executor warp`. Raises ParameterError: Warp does not draw what one of them
    asks for. EnvironmentLackError: no MuJoCo Warp.
    """
    try:
        from vstestbed.apps.gpu.together import TogetherPool, must_fly_together
    except ImportError as error:
        raise EnvironmentLackError(
            f"MuJoCo Warp is not installed ({error})", "pip install 'vstestbed[gpu]'"
        ) from None
    must_fly_together(flown())
    return TogetherPool(workers, folder)
