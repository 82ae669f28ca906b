"""Checks of the installation: what works on this machine, and the command that repairs what does not."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vstestbed.core.errors import VstestbedError
from vstestbed.core.geometry import Array
from vstestbed.core.provenance import versions

PIXEL_TOLERANCE_PX = 0.1
"""Tolerance between rendered and projected balls [px]: well above the detector's own error (0.02 to 0.04 px on multisampled balls),
well below the 0.5 px of a wrong pixel convention."""


@dataclass(frozen=True)
class Finding:
    """Result of one check: whether it passed, what was found, and the remedy."""

    what: str
    works: bool
    found: str
    remedy: str = ""

    def __str__(self) -> str:
        """One line, and a second one with the remedy if the check failed."""
        line = f"{'ok ' if self.works else 'NO '} {self.what:12} {self.found}"
        return line if self.works or not self.remedy else f"{line}\n    {'':12} {self.remedy}"


def examine() -> Iterator[Finding]:
    """Check everything that a run needs, in turn."""
    # every check gives a finding, also a failed one: one broken part must not hide the others
    yield Finding("python", sys.version_info >= (3, 11), sys.version.split()[0], "install Python 3.11 or newer")
    yield _packages()
    yield Finding("cores", True, f"{len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else os.cpu_count()}")
    yield _data()
    yield from _pictures()
    yield _codec()


def examine_file(model: str) -> Iterator[Finding]:
    """What of an arm's MJCF or URDF file the robot `mjcf` can use, and what is missing."""
    from vstestbed.core.named_files import absolute_file
    from vstestbed.sim.scene.model_report import examine_model

    yield from (Finding(*line) for line in examine_model(absolute_file(model, Path.cwd())))


def _packages() -> Finding:
    found = versions()
    missing = [name for name, version in found.items() if version == "missing"]
    text = ", ".join(f"{name} {version}" for name, version in found.items() if name != "python")
    major = found["mujoco"].split(".")[0]  # "missing" if it is not installed
    if major.isdigit() and int(major) >= 4:
        return Finding("packages", False, text, "dm-control 1.0.50 does not work with mujoco 4: pip install 'mujoco>=3.17,<4'")
    return Finding("packages", not missing, text, "pip install vstestbed again")


def _data() -> Finding:
    from vstestbed.core.assets import bundled_scenarios

    try:
        names = list(bundled_scenarios())
    except VstestbedError as error:
        return Finding("scenarios", False, str(error))
    return Finding("scenarios", bool(names), f"{len(names)} bundled: {', '.join(names)}", "install vstestbed again")


def _pictures() -> Iterator[Finding]:
    """OpenGL (ray casting where it does not work), then the pixel convention: rendered against projected positions of balls."""
    from vstestbed.sim.render import gl_probe as gl
    from vstestbed.sim.render.pixel_check import pixel_convention

    try:
        check = pixel_convention("gl")
    except (VstestbedError, ImportError) as error:
        lack = gl.explain(error) if isinstance(error, ImportError) else error
        problem, _, remedy = str(lack or error).partition("; ")  # the form of every message of this package
        yield Finding("OpenGL", False, f"{problem}; {gl.RAYS_INSTEAD}", remedy)
        check = pixel_convention("rays")
    else:
        yield Finding("OpenGL", True, check.renderer)
    yield _pixels(check.errors, check.renderer)


def _pixels(errors: Array, renderer: str) -> Finding:
    """The finding on the pixel convention; errors: rendered minus projected positions (N, 2) [px], NaN where a ball was not found."""
    seen = np.isfinite(errors).all(axis=1)
    remedy = "this OpenGL driver does not render correctly; try another MUJOCO_GL, or another driver"
    if renderer.startswith("rays"):
        remedy = "this MuJoCo does not cast rays correctly; install the version in requirements.lock"
    if not seen.all():
        return Finding("pixels", False, f"only {np.count_nonzero(seen)} of {len(errors)} rendered balls were found in the picture", remedy)
    worst = float(np.abs(errors).max())  # over both coordinates of all balls
    found = f"{len(errors)} rendered balls within {worst:.3f} px of the camera model ({PIXEL_TOLERANCE_PX} allowed)"
    found += f", by {renderer}" if renderer.startswith("rays") else ""
    return Finding("pixels", worst < PIXEL_TOLERANCE_PX, found, remedy)


def _codec() -> Finding:
    import av
    import av.error

    try:
        av.Codec("libx264", "w")
    except (av.error.FFmpegError, ValueError) as error:
        return Finding("video", False, f"no libx264 encoder ({error})", "pip install --force-reinstall --only-binary :all: av")
    return Finding("video", True, f"libx264 through PyAV {av.__version__}")
