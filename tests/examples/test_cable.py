"""The cable of the example pulls as its equation says, by the true poses of the log, and stands in
the log, the record and `describe`.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl

import vstestbed as vs
from vstestbed.core.geometry import inverse

CABLE = Path(__file__).parent / "cable.py"
GIVEN = (
    "run",
    "arm_ibvs",
    "--plugin",
    str(CABLE),
    "--set",
    "detector=oracle",
    "--set",
    "stop.duration_s=0.4",
    "--video",
    "none",
)


def test_its_tension_is_that_of_its_length(command, own_kinds, tmp_path: Path) -> None:
    word = "robot.effects=[{kind: cable, hook_m: [0, 0, 1.5], length_m: 0.5, stiffness_npm: 300}]"
    ended = command(*GIVEN, "--set", word, "--out", tmp_path / "run")
    assert ended.code == 3, ended.err  # its time is over
    log, scenario = (
        pl.read_parquet(tmp_path / "run" / "log.parquet"),
        vs.load(str(tmp_path / "run" / "scenario.yaml")),
    )
    p, w, x, y, z = (
        np.array([log[f"cam_{c}"] for c in ("x", "y", "z")]).T,
        *(np.array(log[f"cam_q{c}"]) for c in "wxyz"),
    )
    to_flange = inverse(scenario.camera.mount.T)[:3, 3]
    R = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]).transpose(2, 0, 1)  # fmt: skip
    length = np.linalg.norm(p + R @ to_flange - [0, 0, 1.5], axis=1)
    found = np.array(log["cable_n"])
    assert found.max() > 10
    np.testing.assert_allclose(found, 300 * np.maximum(0, length - 0.5), atol=1e-6)
    page = (tmp_path / "run" / "report.html").read_text()
    assert "Columns of the law and of effects" in page and "cable_n" in page


def test_it_is_described_and_its_mistakes_are_told(command, own_kinds, tmp_path: Path) -> None:
    without = command("run", "arm_ibvs", "--set", "robot.effects=[{kind: cable}]")
    assert without.code == 2 and "robot.effects.0" in without.err
    assert (
        command("list", "effects").out
        == "none; those of the package are blocks of robots (vstestbed describe puma560)\n"
    )
    shown = command("describe", "effect.cable", "--plugin", CABLE)
    assert shown.code == 0 and "stiffness_npm" in shown.out and "N/m" in shown.out
    assert command("list", "effects").out.startswith("cable  A cable")
    wrong = command(*GIVEN, "--set", "robot.effects=[{kind: cable, lenght_m: 1}]")
    assert (
        wrong.code == 2
        and "robot.effects.0.lenght_m: is an unknown field; did you mean 'length_m'?" in wrong.err
    )
