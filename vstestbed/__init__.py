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
    from vstestbed.comparing import compare
    from vstestbed.loop import run
    from vstestbed.recording import Recording
    from vstestbed.runs import run_into
    from vstestbed.scenario import Scenario
    from vstestbed.scenario_file import load
    from vstestbed.stop import Outcome

_HOMES = {
    "compare": "vstestbed.comparing",
    "run": "vstestbed.loop",
    "run_into": "vstestbed.runs",
    "load": "vstestbed.scenario_file",
    "Scenario": "vstestbed.scenario",
    "Recording": "vstestbed.recording",
    "Outcome": "vstestbed.stop",
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
