"""The guide on scenarios in Python: its code runs as it stands,
and its commands say what it says.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib
import pytest

GUIDE = (Path(__file__).parents[2] / "docs/guides/python.md").read_text(encoding="utf-8")


def test_the_guide_runs_from_python_and_from_its_yaml(
    command: Callable[..., Any], capsys: pytest.CaptureFixture[str]
) -> None:
    """In the empty folder that `command` works in."""
    matplotlib.use("Agg")
    code, yaml = (
        re.findall(rf"```{language}\n(.*?)```", GUIDE, re.DOTALL)[0]
        for language in ("python", "yaml")
    )
    space: dict[str, object] = {}
    exec(code, space)
    out = capsys.readouterr().out
    assert out.startswith("converged 8.3 s") and yaml in out
    assert Path("my_ibvs.yaml").read_text(encoding="utf-8") == yaml
    assert Path("camera.png").stat().st_size > 10_000 and Path("camera.gif").stat().st_size > 10_000

    words = next(
        line.split() for line in GUIDE.splitlines() if line.startswith("    vstestbed run")
    )
    ended = command(*words[1:])
    assert ended.code == 0
    logs = [Path(f"runs/{how}/log.parquet").read_bytes() for how in ("from_python", "from_yaml")]
    assert logs[0] == logs[1]
