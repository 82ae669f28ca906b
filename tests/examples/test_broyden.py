"""A law of 30 lines as a plugin: on the arm, in a comparison, in a map of its basin, at its gain
limit, and through the suite.
"""

from __future__ import annotations

import ast
import json
from pathlib import Path

import pytest

import vstestbed as vs

HERE = Path(__file__).parent
BROYDEN = ("--plugin", "broyden", "--set", "law=broyden")
QUIET = ("--quiet", "--json")


@pytest.fixture(autouse=True)
def plugin(own_kinds, monkeypatch: pytest.MonkeyPatch):
    """The file's folder is where a user would have it: beside the scenario."""
    monkeypatch.syspath_prepend(str(HERE))
    monkeypatch.delitem(__import__("sys").modules, "broyden", raising=False)


def test_it_is_a_class_of_30_lines_with_one_registration():
    tree = ast.parse((HERE / "broyden.py").read_text())
    law = next(n for n in tree.body if isinstance(n, ast.ClassDef) and n.name == "Broyden")
    assert law.end_lineno is not None and law.end_lineno - law.decorator_list[0].lineno + 1 <= 30
    assert [ast.unparse(d) for d in law.decorator_list] == ["vs.LAWS.add", "vs.spec"]


def test_it_passes_the_suite_of_laws():
    from broyden import Broyden  # pyright: ignore[reportMissingImports]

    vs.testing.check_law(Broyden())


def test_it_drives_the_arm(command):
    ideal = ("--set", "detector=oracle", "--set", "robot.actuation=industrial")
    summary = json.loads(
        command("run", "arm_ibvs", "--video", "none", *QUIET, *BROYDEN, *ideal).out
    )
    assert summary["outcome"] == "converged" and summary["time_to_converge_s"] < 15


@pytest.mark.study
def test_it_is_compared_with_the_classic(command, quick: Path, here: None, one_figure: None):
    both = ("--vary", "law.kind=ibvs,broyden", "--set", "law.gain=3")
    ended = command(
        "compare",
        "quick.yaml",
        *both,
        "--plugin",
        "broyden",
        "--seeds",
        2,
        "--set",
        "camera.rate_hz=10",
        *QUIET,
    )
    assert ended.code == 0, ended.err
    rows = json.loads(ended.out)
    assert sorted((row["law.kind"], row["outcome"]) for row in rows) == [
        (law, "converged") for law in ("broyden", "ibvs") for _ in "12"
    ]
    assert Path("runs/compare/001/comparison.mp4").stat().st_size > 1000


@pytest.mark.app("maps")
def test_its_basin_ends_as_in_the_time_loop(command, quick: Path):
    from vstestbed.apps.maps.basin import ON_AXIS_DEG

    grid = ("--x", "x=-.15:.15", "--y", "yaw=-40:40", "--n", 3, "--check", 3)
    ended = command(
        "basin", "quick.yaml", "--plugin", "broyden", "--set", "law=broyden", *grid, *QUIET
    )
    assert ended.code == 0, ended.err
    basin = json.loads(ended.out)[0]
    assert basin["checked"] == basin["agreeing"] == 3 + len(ON_AXIS_DEG)
    assert basin["shares"]["converged"] > 0.4


@pytest.mark.app("maps")
@pytest.mark.study
def test_it_has_a_gain_limit(command, quick: Path):
    ended = command(
        "gain-limit",
        "quick.yaml",
        "--plugin",
        "broyden",
        "--set",
        "law={kind: broyden, update: 1e-6}",
        "--frames",
        "1",
        *QUIET,
    )
    assert ended.code == 0, ended.err
    limit = json.loads(ended.out)[0]
    # a Jacobian that stays: the classic's closed form
    assert limit["measured_to_theory"] == pytest.approx(1.0, abs=0.005)
