"""Arms of nobody's catalogue: two links, a SCARA, seven joints with position servos of their own."""

from __future__ import annotations

from pathlib import Path

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
