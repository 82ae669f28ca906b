"""Attacks of a submission's law on those who fly it again: its code does not reach what compares
its runs with those handed in.

The world: a suite of one task with an ideal camera and the oracle, and a law of points whose rows
are handed in with half their times. Each attack stands in a plugin beside the law, and is there to
have the forged rows agree, or to have none of them compared.
"""

from __future__ import annotations

from pathlib import Path

import polars as pl
import pytest

from vstestbed.apps.suite.submission import Checked, _checked
from vstestbed.apps.suite.suite import law_of_file, opened
from vstestbed.core.errors import ParameterError
from vstestbed.laws import LAWS
from vstestbed.loop.isolated import offered

SUITE = "description: one\nlaws: {}\ntasks: {only: {plan: plan.yaml}}\n"
PLAN = """base: [ibvs_book]
set: {detector: {kind: oracle, field_of_view: unlimited}, stop.duration_s: 20, camera.rate_hz: 10}
cases: {gain of the camera: {one: {}}}
seeds: 1
"""
PLUGIN = """\
import atexit, json, os, sys, time
from typing import Literal

import vstestbed as vs

POINT = vs.features.Point()


@vs.LAWS.add
@vs.spec
class Mine(vs.ErrorLaw):
    kind: Literal["mine"] = "mine"

    def equations(self, view, goal):
        e = POINT.measure(view.xy) - POINT.measure(goal.xy)
        return e, POINT.interaction(view.xy, view.depth)


"""
ATTACKS = {
    "replaces what compares, tables and metrics": (
        """
import polars as pl
import vstestbed.apps.suite.submission as s
from vstestbed.loop import metrics
from vstestbed.tasks.metrics import METRICS
s._agrees = lambda *row: True
s._checked = s.check = lambda *given, **named: s.Checked(1, (), [])
given = {"success_given": "success", "value_given": "value"}
pl.DataFrame.join = lambda self, other, **how: other.with_columns(**given)
for name in dir(metrics): setattr(metrics, name, lambda *given, **named: {})
METRICS._members.clear()
"""
    ),
    "ends its process": "os._exit(0)",
    "ends its process in a run": "Mine.step = lambda *given: os._exit(0)",
    "registers an end": "atexit.register(os._exit, 0)",
    "prints that all agree": (
        "print('1 of 1 runs that were flown again agree')\n"
        "Mine.equations = lambda *given: sys.exit(0)"
    ),
    "takes the word of the judge's law": "vs.LAWS._members['isolated'] = Mine",
}


@pytest.fixture
def folder(tmp_path: Path, own_kinds: None) -> Path:
    (tmp_path / "own.yaml").write_text(SUITE)
    (tmp_path / "plan.yaml").write_text(PLAN)
    (tmp_path / "mine.yaml").write_text("law: {kind: mine, gain: 1.2}\nplugins: [mine.py]\n")
    return tmp_path


def flown(folder: Path, attack: str, out: str, given: pl.DataFrame) -> Checked:
    """The submission as it is checked; given: what was handed in."""
    (folder / "mine.py").write_text(PLUGIN + attack)
    (folder / out).mkdir()
    with offered():
        entry = opened(str(folder / "mine.yaml"), str(folder / "own.yaml"), alone=True, apart=True)
        return _checked(entry, given, folder / out, 1, 0)


def in_this_process(folder: Path) -> pl.DataFrame:
    (folder / "mine.py").write_text(PLUGIN)
    entry = opened(str(folder / "mine.yaml"), str(folder / "own.yaml"), alone=True)
    return entry.fly(folder / "flown", jobs=1)


@pytest.mark.process
def test_an_honest_law_agrees_apart_and_no_attack_makes_forged_rows_agree(folder: Path) -> None:
    honest = in_this_process(folder)
    assert honest["success"].all()
    # a machine of another kind may differ in the last digits
    for out, off in (("same", 0.0), ("near", 1e-6)):
        found = flown(folder, "", out, honest.with_columns(pl.col("value") * (1 + off)))
        assert found.runs == 1 and not found.otherwise
    forged = honest.with_columns(pl.col("value") / 2)
    for number, (name, attack) in enumerate({"only forges": "", **ATTACKS}.items()):
        found = flown(folder, attack, f"forged{number}", forged)
        # a law that takes part in no task has no run, and its rows are of no plan
        assert found.otherwise or not found.runs, name
        assert "isolated" not in LAWS.members


@pytest.mark.process
def test_the_code_of_a_submission_is_not_loaded_by_who_checks_it(folder: Path) -> None:
    (folder / "mine.py").write_text(
        PLUGIN + "open('loaded', 'w').close()\nraise RuntimeError(os.getcwd())\n"
    )
    with offered():
        entry = opened(str(folder / "mine.yaml"), str(folder / "own.yaml"), alone=True, apart=True)
        assert not entry.plans and "RuntimeError" in entry.blank["mine", "only"]
    assert (
        "mine" not in LAWS.members
        and not (folder / "loaded").exists()
        and not Path("loaded").exists()
    )


@pytest.mark.process
def test_a_plugin_of_one_law_flies_apart_as_it_is_by_default(folder: Path) -> None:
    (folder / "mine.py").write_text(PLUGIN)
    with offered():
        entry = opened(str(folder / "mine.py"), str(folder / "own.yaml"), alone=True, apart=True)
        assert list(entry.plans) == ["only"]
    (folder / "mine.py").write_text(
        PLUGIN + PLUGIN[PLUGIN.index("@vs") :].replace("Mine", "Other").replace("mine", "other")
    )
    with offered():
        entry = opened(str(folder / "mine.py"), str(folder / "own.yaml"), alone=True, apart=True)
        assert not entry.plans and "must add one law" in entry.blank["mine", "only"]


def test_a_run_that_crashed_counts_the_tasks_limit_whatever_the_laws_beside_it_did(
    folder: Path,
) -> None:
    """The worst of the laws that flew is no limit: a loop that cannot compute with a command would
    count less than to fail.
    """
    (folder / "mine.py").write_text(PLUGIN)
    entry = opened(str(folder / "mine.yaml"), str(folder / "own.yaml"), alone=True)
    table = pl.DataFrame(
        {
            "law": ["mine"] * 2,
            "seed": [0, 1],
            "outcome": ["converged", "crashed"],
            "success": [True, False],
        }
    )
    rows = entry.rows_of(
        table.with_columns(time_to_goal_s=pl.Series([3.0, None])), entry.plans["only"], "only"
    )
    assert rows["value"].to_list() == [3.0, 20.0]


@pytest.mark.parametrize("plugins", ["5", "[5]", "{mine.py: 1}", "mine.py", "[[mine.py]]"])
def test_plugins_that_are_no_list_of_files_are_refused_by_name(plugins: str, folder: Path) -> None:
    (folder / "mine.yaml").write_text(f"law: {{kind: mine}}\nplugins: {plugins}\n")
    with pytest.raises(ParameterError, match="plugins must be a list of the law's files"):
        law_of_file(str(folder / "mine.yaml"), apart=True)


@pytest.mark.parametrize("way", ["a plugin", "a link", "a file of the block"])
def test_nothing_outside_of_the_laws_folder_is_packed_or_read(
    way: str, folder: Path, tmp_path: Path
) -> None:
    """A file that is above it would be copied to a place above the submission's."""
    inner = tmp_path / "a" / "b"
    inner.mkdir(parents=True)
    (tmp_path / "a" / "out").mkdir()
    (tmp_path / "helper.py").write_text(PLUGIN)
    (tmp_path / "net.onnx").write_bytes(b"")
    named = "../../helper.py"
    if way == "a link":
        named = "linked.py"
        (inner / named).symlink_to(tmp_path / "helper.py")
    law = "law: {kind: mine}\nplugins: [" + named + "]\n"
    if way == "a file of the block":
        (inner / "mine.py").write_text(PLUGIN)
        law = "law: {kind: mine, file: ../../net.onnx}\nplugins: [mine.py]\n"
    (inner / "mine.yaml").write_text(law)
    for apart in (False, True):
        with offered():
            entry = opened(
                str(inner / "mine.yaml"), str(folder / "own.yaml"), alone=True, apart=apart
            )
            with pytest.raises(
                ParameterError,
                match=r"(helper|net|linked)\S+, which must be in the folder of mine\.yaml",
            ):
                entry.must_stay()
            if not apart:
                with pytest.raises(ParameterError, match="which must be in the folder"):
                    entry.mark(tmp_path / "a" / "out")
    assert {path.name for path in (tmp_path / "a").rglob("*.py")} <= {"linked.py", "mine.py"}
