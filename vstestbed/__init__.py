"""vstestbed: visual servoing meets real dynamics.

    import vstestbed as vs
    recording = vs.run(vs.load("arm_ibvs", {"law.gain": 1.0}))
    recording.outcome, recording.summary(), recording.frame()

Public names are imported when first used, so that `import vstestbed` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from vstestbed import features
    from vstestbed.core.outcome import Outcome
    from vstestbed.experiments.comparison import compare
    from vstestbed.experiments.run_folder import run_into
    from vstestbed.loop.recording import Recording
    from vstestbed.loop.run import run
    from vstestbed.scenario.load import load
    from vstestbed.scenario.scenario import Scenario

_HOMES = {
    "compare": "vstestbed.experiments.comparison",
    "run": "vstestbed.loop.run",
    "run_into": "vstestbed.experiments.run_folder",
    "load": "vstestbed.scenario.load",
    "Scenario": "vstestbed.scenario.scenario",
    "Recording": "vstestbed.loop.recording",
    "Outcome": "vstestbed.core.outcome",
}

__all__ = ["Outcome", "Recording", "Scenario", "compare", "features", "load", "run", "run_into"]


def __getattr__(name: str) -> object:
    if name == "features":
        return import_module("vstestbed.features")
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'vstestbed' has no attribute {name!r}; public names: {', '.join(__all__)}")


def __dir__() -> list[str]:
    return __all__
