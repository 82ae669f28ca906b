"""A comparison's folder elsewhere: it is flown again with the copies of its files, agrees, and refuses files that have changed."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import polars as pl
import pytest

from vstestbed.core.errors import RunFolderError
from vstestbed.studies.comparison.record import RECORD, agreement, keep, must_be_unchanged

GUIDE = Path(__file__).parents[3] / "docs" / "guides" / "first_law.md"


def run(*words: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", "vstestbed", *map(str, words)], cwd=cwd, capture_output=True, text=True, check=False)


@pytest.mark.process
def test_a_copied_folder_is_flown_again_agrees_and_refuses_a_changed_law(tmp_path: Path, quick: Path) -> None:
    home, elsewhere = tmp_path / "home", tmp_path / "elsewhere"
    home.mkdir()
    elsewhere.mkdir()
    law = GUIDE.read_text(encoding="utf-8").partition("```python\n")[2].partition("```")[0]
    (home / "my_law.py").write_text(f"import gains\n{law}")
    (home / "gains.py").write_text("GAIN = 2.0\n")
    (home / "mine.yaml").write_text(f"plugins: [my_law.py]\n{quick.read_text()}")
    chosen = "law={kind: my_law, gain: 4}"
    made = run("compare", "mine.yaml", "--set", chosen, "--seeds", 2, "--no-film", "--no-figures", "--out", "c", cwd=home)
    assert made.returncode == 0, made.stderr
    shutil.move(home / "c", elsewhere / "c")
    (home / "my_law.py").unlink()
    again = run("compare", "c", "--again", "--out", "again", cwd=elsewhere)
    assert again.returncode == 0, again.stderr
    assert "2 of 2 runs agree (2 to the last digit" in again.stderr
    copies = json.loads((elsewhere / "c" / RECORD).read_text())["files"]
    assert sorted(Path(copy).name for copy in copies) == ["gains.py", "my_law.py"]
    (copy,) = (elsewhere / "c" / name for name in copies if name.endswith("gains.py"))
    copy.write_text("GAIN = 3.0\n")
    changed = run("compare", "c", "--again", cwd=elsewhere)
    assert changed.returncode == 2 and "gains.py: is not the file with which the stored runs flew" in changed.stderr


def test_files_that_a_model_and_a_module_need_are_copied_with_their_layout(tmp_path: Path) -> None:
    robot = tmp_path / "robot"
    (robot / "meshes").mkdir(parents=True)
    (robot / "arm.xml").write_text('<mujoco><compiler meshdir="meshes"/><asset><mesh file="link.stl"/></asset></mujoco>')
    (robot / "meshes" / "link.stl").write_bytes(b"solid")
    (tmp_path / "law.py").write_text("import helper\nWEIGHTS = 'weights.npy'\n")
    (tmp_path / "helper.py").write_text("import numpy\n")
    (tmp_path / "weights.npy").write_bytes(b"numbers")
    folder = tmp_path / "c"
    (folder / "scenarios").mkdir(parents=True)
    (folder / "comparison.yaml").write_text(f"base: [scenarios/s.yaml]\nset: {{robot.file: {robot / 'arm.xml'}}}\n")
    (folder / "scenarios" / "s.yaml").write_text(f"plugins: [{tmp_path / 'law.py'}]\n")
    keep(folder)
    kept = json.loads((folder / RECORD).read_text())
    names = sorted("/".join(Path(copy).parts[2:]) for copy in kept["files"])
    assert names == ["arm.xml", "helper.py", "law.py", "meshes/link.stl", "weights.npy"]
    assert all((folder / copy).read_bytes() == Path(said["from"]).read_bytes() for copy, said in kept["files"].items())
    assert kept["environment"]["versions"]["numpy"] and kept["environment"]["cores"] >= 1

    must_be_unchanged(folder)
    (tmp_path / "helper.py").write_text("import numpy as np\n")
    with pytest.raises(RunFolderError, match=r"helper\.py has changed since; bring it back.*runs of two versions are never mixed"):
        must_be_unchanged(folder)
    (tmp_path / "helper.py").unlink()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    moved = (tmp_path / "law.py").rename(elsewhere / "law.py")
    must_be_unchanged(folder, [str(moved)])  # it has moved, and is the same: the plan keeps its name, which `--plugin` answers for
    assert str(tmp_path / "law.py") in (folder / "scenarios" / "s.yaml").read_text()
    moved.write_text("WEIGHTS = 'others.npy'\n")
    with pytest.raises(RunFolderError, match=r"elsewhere/law\.py has changed since"):
        must_be_unchanged(folder, [str(moved)])
    must_be_unchanged(folder)  # they are gone: the plan names the copies now
    assert f"{folder}/files/law_" in (folder / "scenarios" / "s.yaml").read_text()


def test_runs_agree_to_a_frame_and_differ_in_outcome_or_number() -> None:
    row = {"folder": "a", "outcome": "converged", "time_to_converge_s": 2.0, "final_error_px": 0.1, "path_ratio": None}
    rows = [row | {"folder": name} for name in "abcd"]
    now = [rows[0], rows[1] | {"time_to_converge_s": 2.04}, rows[2] | {"final_error_px": 0.3}, rows[3] | {"outcome": "timed_out"}]
    found = agreement(pl.DataFrame(rows), pl.DataFrame(now))
    assert (found.same, found.near) == (1, 1)
    assert found.differ == ("c: final_error_px 0.1, now 0.3", "d: converged, now timed_out")
    assert found.lines()[0].startswith("2 of 4 runs agree (1 to the last digit, 1 within")
