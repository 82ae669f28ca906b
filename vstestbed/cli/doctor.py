"""Checks of the installation: what works on this machine, and the command that repairs what does
not.
"""

from __future__ import annotations

import os
import sys
import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from rich.console import Console
from rich.text import Text

from vstestbed.core.errors import EnvironmentLackError, ParameterError, VstestbedError
from vstestbed.core.geometry import Array
from vstestbed.core.named_files import absolute_file, bundled_scenarios, folder
from vstestbed.core.provenance import versions
from vstestbed.sim import gl_probe as gl

PIXEL_TOLERANCE_PX = 0.1
"""Tolerance between rendered and projected balls [px]: well above the detector's own error (0.02 to
0.04 px on multisampled balls), well below the 0.5 px of a wrong pixel convention.
"""


STATUS_WIDTH, MISSING = 9, "missing"


@dataclass(frozen=True)
class Finding:
    """Result of one check: whether it passed, what was found, and the remedy."""

    what: str
    works: bool
    found: str
    remedy: str = ""

    def lines(self, width: int | None) -> Iterator[str]:
        """What was found, and where the check failed the remedy after an arrow; set off and
        wrapped, None: not wrapped.
        """
        head = f"{'ok' if self.works else MISSING:{STATUS_WIDTH}}{self.what:13}"
        remedy = [] if self.works else self.remedy.splitlines()
        for text in [*(self.found or "-").splitlines(), *(f"-> {line}" for line in remedy)]:
            room = None if width is None or text.startswith(" ") else max(width - len(head), 20)
            for line in (
                [text] if room is None else textwrap.wrap(text, room, break_on_hyphens=False)
            ):
                yield f"{head}{line}".rstrip()
                head = " " * len(head)


def show(all_messages: Iterable[Finding]) -> bool:
    """Print findings as they come, and a line that counts them; whether all is well. Coloured and
    wrapped on a terminal alone.
    """
    console, works = Console(highlight=False), list[bool]()
    for finding in all_messages:
        works.append(finding.works)
        for number, line in enumerate(
            finding.lines(console.width if console.is_terminal else None)
        ):
            text = Text(line)
            if number == 0:
                text.stylize("green" if finding.works else "bold red", 0, STATUS_WIDTH)
            elif line.lstrip().startswith("-> "):
                text.stylize("yellow")
            console.print(text, soft_wrap=True)
    end = (
        f"all {len(works)} are well"
        if all(works)
        else f"{works.count(False)} of {len(works)} to mend, see ->"
    )
    console.print(Text(end, style="bold"))
    return all(works)


def examined(model: str | None) -> int:
    """Show what works here, or of an arm's file; the exit code."""
    if model is None:
        return 0 if show(examine()) else EnvironmentLackError.exit_code
    from vstestbed.sim.scene.model_report import examine_model  # here: MuJoCo may be what is broken

    sound = show(Finding(*line) for line in examine_model(absolute_file(model, Path.cwd())))
    return 0 if sound else ParameterError.exit_code


def examine() -> Iterator[Finding]:
    """Check everything that a run needs, in turn."""
    # every check gives a finding, also a failed one: one broken part must not hide the others
    yield Finding(
        "python",
        sys.version_info >= (3, 11),
        sys.version.split()[0],
        "install Python 3.11 or newer",
    )
    found, remedy = versions(), "pip install vstestbed again"
    major, whole = found["mujoco"].split(".")[0], MISSING not in found.values()
    if major.isdigit() and int(major) >= 4:
        whole, remedy = (
            False,
            "dm-control 1.0.50 does not work with mujoco 4: pip install 'mujoco>=3.17,<4'",
        )
    yield Finding(
        "packages",
        whole,
        ", ".join(f"{name} {version}" for name, version in found.items() if name != "python"),
        remedy,
    )
    yield Finding(
        "cores",
        True,
        f"{len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else os.cpu_count()}",
    )
    try:
        names = list(bundled_scenarios())
        yield Finding(
            "scenarios",
            bool(names),
            f"{len(names)} bundled (vstestbed list scenarios)",
            "install vstestbed again",
        )
    except VstestbedError as error:
        yield Finding("scenarios", False, str(error))
    try:
        yield Finding("guides", True, str(folder("docs/guides")))
    except VstestbedError as error:
        yield Finding("guides", False, str(error))
    yield from _pictures()
    yield _codec()


def _pictures() -> Iterator[Finding]:
    """OpenGL (ray casting where it does not work), then the pixel convention: rendered against
    projected positions of balls.
    """
    try:
        errors, renderer = _rendered_by("gl")
    except (VstestbedError, ImportError) as error:
        lack = gl.explain(error) if isinstance(error, ImportError) else error
        # the form of every message of this package
        problem, _, remedy = str(lack or error).partition("; ")
        yield Finding("OpenGL", False, f"{problem}; {gl.RAYS_INSTEAD}", remedy)
        errors, renderer = _rendered_by("rays")
    else:
        yield Finding("OpenGL", True, renderer)
    # rendered minus projected positions (N, 2) [px], NaN where a ball was not found
    seen = np.isfinite(errors).all(axis=1)
    remedy = (
        "this OpenGL driver does not render correctly; try another MUJOCO_GL, or another driver"
    )
    if renderer.startswith("rays"):
        remedy = (
            "this MuJoCo does not cast rays correctly; install the version in requirements.lock"
        )
    if not seen.all():
        yield Finding(
            "pixels",
            False,
            (
                f"only {np.count_nonzero(seen)} of {len(errors)} rendered balls were"
                " found in the picture"
            ),
            remedy,
        )
        return
    worst = float(np.abs(errors).max())  # over both coordinates of all balls
    found = (
        f"{len(errors)} rendered balls within {worst:.3f} px of the camera model"
        f" ({PIXEL_TOLERANCE_PX} allowed)"
    )
    found += f", by {renderer}" if renderer.startswith("rays") else ""
    yield Finding("pixels", worst < PIXEL_TOLERANCE_PX, found, remedy)


def _rendered_by(renderer: Literal["gl", "rays"]) -> tuple[Array, str]:
    """What `pixel_convention` finds by a renderer."""
    # here, and anew: OpenGL may be missing, without which MuJoCo is not imported
    from vstestbed.cli.pixel_convention import pixel_convention

    return pixel_convention(renderer)


def _codec() -> Finding:
    import av
    from av.error import FFmpegError

    try:
        av.Codec("libx264", "w")
    except (FFmpegError, ValueError) as error:
        return Finding(
            "video",
            False,
            f"no libx264 encoder ({error})",
            "pip install --force-reinstall --only-binary :all: av",
        )
    return Finding("video", True, f"libx264 through PyAV {av.__version__}")
