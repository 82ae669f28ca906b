"""Arms of nobody's catalogue: two links, a SCARA, seven joints with position servos of their own;
and which bundled arms are installed.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.core.named_files import place_of_file

HERE = Path(__file__).parent
BLOCKS = {
    "two_link": {"start": {"nominal": {"q_deg": [17, 46]}}, "speed_limits": [2, 2]},
    "scara": {
        "flange": "tool",
        "start": {"nominal": {"q_deg": [20, 40, 0, 10]}, "random": {"q_deg": 6}},
        "speed_limits": [1.5, 1.5, 0.4, 3],
    },
    "seven": {
        "flange": "hand",
        "start": {"nominal": {"q_deg": [10, 40, 0, 80, 0, 50, 0]}, "random": {"q_deg": 6}},
        "speed_limits": [1.5] * 7,
    },
}
"""Their blocks of a scenario, without kind and file."""


def block(name: str, **more: object) -> dict[str, object]:
    """The robot's block of a scenario."""
    return {"kind": "mjcf", "file": str(HERE / f"{name}.xml")} | BLOCKS[name] | more


def is_installed(file: str) -> bool:
    """Whether an arm's file is on this machine."""
    try:
        place_of_file(file)
    except ParameterError:
        return False
    return True


NEEDS_PANDA = pytest.mark.skipif(
    not is_installed("package:dm_robotics.panda/assets/panda/panda.xml"),
    reason=(
        "the Panda's meshes are not installed:"
        " pip install --no-deps dm_robotics_panda (Python 3.12 and older)"
    ),
)


def where_installed(names: Iterable[str]) -> list[Any]:
    """Scenarios as parameters of a test; those with an arm whose file is not there are skipped."""
    return [
        pytest.param(name, marks=NEEDS_PANDA) if name == "arm_panda" else name for name in names
    ]
