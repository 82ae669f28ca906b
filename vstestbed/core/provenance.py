"""Provenance of a result: versions of all packages that its numbers depend on."""

from __future__ import annotations

import functools
import platform
from importlib.metadata import PackageNotFoundError, version

__all__ = ["versions", "vstestbed_version"]

PACKAGES = {
    "mujoco": "mujoco",
    "dm_control": "dm-control",
    "opencv": "opencv-python-headless",
    "numpy": "numpy",
}


def vstestbed_version() -> str:
    """The installed version, `unknown` when run from a folder that is not installed."""
    try:
        return version("vstestbed")
    except PackageNotFoundError:
        return "unknown"


@functools.cache  # it takes 5 ms, and a process may do thousands of runs
def versions() -> dict[str, str]:
    """Versions of vstestbed, mujoco, dm_control, opencv, numpy and python,
    which nobody may change.
    """
    found = {"vstestbed": vstestbed_version()}
    for name, package in PACKAGES.items():
        try:
            found[name] = version(package)
        except PackageNotFoundError:
            found[name] = "missing"  # a result is worth more than its provenance: no error here
    return found | {"python": platform.python_version()}
