"""A comparison's folder elsewhere: it is flown again with the copies of its files, agrees, and
refuses files that have changed.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import polars as pl
import pytest

from vstestbed.core.errors import RunFolderError
from vstestbed.studies.comparison.record import (
    RECORD,
    _commit,
    agreement,
    keep,
    must_be_unchanged,
    needed_files,
)

GUIDE = Path(__file__).parents[3] / "docs" / "guides" / "first_law.md"


def run(*words: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "vstestbed", *map(str, words)],
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.process
def test_a_copied_folder_is_flown_again_agrees_and_refuses_a_changed_law(
    tmp_path: Path, quick: Path
) -> None:
    home, elsewhere = tmp_path / "home", tmp_path / "elsewhere"
    home.mkdir()
    elsewhere.mkdir()
    law = GUIDE.read_text(encoding="utf-8").partition("```python\n")[2].partition("```")[0]
    (home / "my_law.py").write_text(f"import gains\n{law}")
    (home / "gains.py").write_text("GAIN = 2.0\n")
    (home / "mine.yaml").write_text(f"plugins: [my_law.py]\n{quick.read_text()}")
    chosen = "law={kind: my_law, gain: 4}"
    made = run(
        "compare",
        "mine.yaml",
        "--set",
        chosen,
        "--seeds",
        2,
        "--no-film",
        "--no-figures",
        "--out",
        "c",
        cwd=home,
    )
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
    assert (
        changed.returncode == 2
        and "gains.py: is not the file with which the stored runs flew" in changed.stderr
    )


def test_files_that_a_model_and_a_module_need_are_copied_with_their_layout(tmp_path: Path) -> None:
    robot = tmp_path / "robot"
    (robot / "meshes").mkdir(parents=True)
    (robot / "arm.xml").write_text(
        '<mujoco><compiler meshdir="meshes"/><asset><mesh file="link.stl"/></asset></mujoco>'
    )
    (robot / "meshes" / "link.stl").write_bytes(b"solid")
    (tmp_path / "law.py").write_text("import helper\nWEIGHTS = 'weights.npy'\n")
    (tmp_path / "helper.py").write_text("import numpy\n")
    (tmp_path / "weights.npy").write_bytes(b"numbers")
    folder = tmp_path / "c"
    (folder / "scenarios").mkdir(parents=True)
    (folder / "comparison.yaml").write_text(
        f"base: [scenarios/s.yaml]\nset: {{robot.file: {robot / 'arm.xml'}}}\n"
    )
    (folder / "scenarios" / "s.yaml").write_text(f"plugins: [{tmp_path / 'law.py'}]\n")
    keep(folder)
    kept = json.loads((folder / RECORD).read_text())
    names = sorted("/".join(Path(copy).parts[2:]) for copy in kept["files"])
    assert names == ["arm.xml", "helper.py", "law.py", "meshes/link.stl", "weights.npy"]
    assert all(
        (folder / copy).read_bytes() == Path(said["from"]).read_bytes()
        for copy, said in kept["files"].items()
    )
    assert kept["environment"]["versions"]["numpy"] and kept["environment"]["cores"] >= 1

    must_be_unchanged(folder)
    (tmp_path / "helper.py").write_text("import numpy as np\n")
    with pytest.raises(
        RunFolderError,
        match=r"helper\.py has changed since; bring it back.*runs of two versions are never mixed",
    ):
        must_be_unchanged(folder)
    (tmp_path / "helper.py").unlink()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    moved = (tmp_path / "law.py").rename(elsewhere / "law.py")
    # it has moved, and is the same: the plan keeps its name, which `--plugin` answers for
    must_be_unchanged(folder, [str(moved)])
    assert str(tmp_path / "law.py") in (folder / "scenarios" / "s.yaml").read_text()
    moved.write_text("WEIGHTS = 'others.npy'\n")
    with pytest.raises(RunFolderError, match=r"elsewhere/law\.py has changed since"):
        must_be_unchanged(folder, [str(moved)])
    must_be_unchanged(folder)  # they are gone: the plan names the copies now
    assert f"{folder}/files/law_" in (folder / "scenarios" / "s.yaml").read_text()


def planned(folder: Path, **files: Path) -> Path:
    """A comparison's folder whose plan names files by its fields."""
    (folder / "scenarios").mkdir(parents=True)
    lines = [f"{field.replace('__', '.')}: {path}" for field, path in files.items()]
    (folder / "comparison.yaml").write_text(
        f"base: [scenarios/s.yaml]\nset: {{{', '.join(lines)}}}\n"
    )
    (folder / "scenarios" / "s.yaml").write_text("seed: 0\n")
    return folder


def kept_by(folder: Path) -> tuple[dict[str, dict[str, str]], list[str]]:
    keep(folder)
    record = json.loads((folder / RECORD).read_text())
    files = {"/".join(Path(copy).parts[2:]): said for copy, said in record["files"].items()}
    return files, record["not_copied"]


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    """A file of this machine that nobody wants in a folder that is published."""
    path = tmp_path / "home" / "id_rsa"
    path.parent.mkdir()
    path.write_text("SECRET")
    return path


def test_what_a_model_names_outside_its_folder_and_in_comments_is_not_copied(
    tmp_path: Path, secret: Path
) -> None:
    robot = tmp_path / "robot"
    (robot / "more").mkdir(parents=True)
    (robot / "more" / "part.xml").write_text(
        '<mujocoinclude><!-- <include file="no.xml"/> --><asset><mesh file="b.stl"/>'
        "</asset></mujocoinclude>"
    )
    for name in ("a.stl", "b.stl", "no.xml", "no.stl", "no.png", "noise.png"):
        (robot / name).write_bytes(b"bytes")
    (robot / "link.stl").symlink_to(secret)
    (robot / "arm.xml").write_text(
        f"""<mujoco><!-- <mesh file="no.stl"/> <texture file="{secret}"/> file="no.png" -->
        <custom><text name="file" data="file='no.png'"/></custom>
        <include file='more/part.xml'/>
        <asset><mesh name="file" file = "a.stl"/>
        <mesh file="link.stl"/><mesh file="../home/id_rsa.stl"/>
        <texture name="t" type="2d" file="{secret}"/>
        <texture name="p" type="2d" file="/etc/passwd"/>
        <hfield name="h" file="noise.png" size="1 1 1 1"/></asset>
        <worldbody/></mujoco>"""
    )
    (secret.parent / "id_rsa.stl").write_text("SECRET")
    copies, others = kept_by(planned(tmp_path / "c", robot__file=robot / "arm.xml"))
    assert sorted(copies) == ["a.stl", "arm.xml", "b.stl", "more/part.xml", "noise.png"]
    assert others == sorted(
        ["/etc/passwd", str(secret), str(secret.parent / "id_rsa.stl"), str(robot / "link.stl")]
    )
    assert not any(
        b"SECRET" in path.read_bytes() for path in (tmp_path / "c").rglob("*") if path.is_file()
    )


def test_a_urdf_has_the_meshes_of_its_package_and_no_others(tmp_path: Path, secret: Path) -> None:
    """`package://` would find a folder of any name beside the file or above it."""
    package = tmp_path / "arm_description"
    for name in ("urdf", "meshes"):
        (package / name).mkdir(parents=True)
    (package / "package.xml").write_text("<package/>")
    link = '<link name="{0}"><visual><geometry><mesh filename="package://{1}"/></geometry></visual></link>'
    names = ["arm_description/meshes/a.stl", "home/id_rsa.stl"]
    (package / "meshes" / "a.stl").write_bytes(b"solid")
    (package / "meshes" / "no.stl").write_bytes(b"solid")
    (secret.parent / "id_rsa.stl").write_text("SECRET")
    links = "".join(link.format(f"l{i}", name) for i, name in enumerate(names))
    comment = (
        f"<!-- {link.format('x', 'arm_description/meshes/no.stl')}"
        f" {link.format('y', 'nowhere/no.stl')} <xacro:x/> -->"
    )
    (package / "urdf" / "arm.urdf").write_text(f'{comment}<robot name="r">{comment}{links}</robot>')
    copies, others = kept_by(planned(tmp_path / "c", robot__file=package / "urdf" / "arm.urdf"))
    assert sorted(copies) == ["meshes/a.stl", "urdf/arm.urdf"]
    assert others == [str(secret.parent / "id_rsa.stl")]


def test_a_law_has_the_files_below_its_folder_and_no_others(tmp_path: Path, secret: Path) -> None:
    law = tmp_path / "laws" / "law.py"
    law.parent.mkdir()
    secret.with_suffix(".txt").write_text("SECRET")
    law.write_text(
        f"A = '../home/id_rsa.txt'\nB = '{secret.with_suffix('.txt')}'\nC = 'weights.npy'\n"
    )
    (law.parent / "weights.npy").write_bytes(b"numbers")
    folder = planned(tmp_path / "c")
    (folder / "scenarios" / "s.yaml").write_text(f"plugins: [{law}]\n")
    copies, others = kept_by(folder)
    assert sorted(copies) == ["law.py", "weights.npy"]
    assert {Path(name).resolve() for name in others} == {secret.with_suffix(".txt")}


def git(folder: Path, *words: str) -> str:
    who = ["-c", "user.name=a", "-c", "user.email=a@b"]
    return subprocess.run(
        ["git", "-C", str(folder), *who, *words], capture_output=True, text=True, check=True
    ).stdout.strip()


def model_in(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "arm.xml"
    path.write_text("<mujoco/>")
    return path


@pytest.mark.skipif(shutil.which("git") is None, reason="it makes repositories, with git")
def test_the_commit_is_read_as_git_has_it(tmp_path: Path) -> None:
    """In a checkout, packed, detached, in a worktree, and of objects named by SHA-256; the blob's
    name is git's.
    """
    top = tmp_path / "top"
    path = model_in(top / "below")
    git(top, "init", "-q", "-b", "some/branch")
    git(top, "add", ".")
    git(top, "commit", "-qm", "one")
    (found,) = kept_by(planned(tmp_path / "c", robot__file=path))[0].values()
    assert found["commit"] == git(top, "rev-parse", "HEAD")
    assert found["blob"] == git(top, "rev-parse", "HEAD:below/arm.xml")
    git(top, "commit", "-q", "--allow-empty", "-m", "two")
    git(top, "pack-refs", "--all")
    assert not (top / ".git/refs/heads/some/branch").exists()
    assert _commit(path) == git(top, "rev-parse", "HEAD")
    git(top, "worktree", "add", "-q", "-b", "other", str(tmp_path / "tree"))
    git(tmp_path / "tree", "commit", "-q", "--allow-empty", "-m", "three")
    assert (
        _commit(tmp_path / "tree/below/arm.xml")
        == git(tmp_path / "tree", "rev-parse", "HEAD")
        != _commit(path)
    )
    git(top, "checkout", "-q", "--detach", "HEAD~1")
    assert _commit(path) == git(top, "rev-parse", "HEAD")
    longer = model_in(tmp_path / "longer")
    git(longer.parent, "init", "-q", "--object-format=sha256")
    assert _commit(longer) == ""  # without a commit
    git(longer.parent, "commit", "-q", "--allow-empty", "-m", "one")
    assert _commit(longer) == git(longer.parent, "rev-parse", "HEAD") and len(_commit(longer)) == 64
    assert _commit(model_in(tmp_path / "outside")) == ""


@pytest.mark.skipif(shutil.which("git") is None, reason="it makes a repository, with git")
def test_the_settings_of_a_foreign_folder_run_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`core.fsmonitor` names a program that `git status` runs; so do other settings, for other
    commands. Nothing at all is run.
    """
    path = model_in(tmp_path / "foreign")
    git(path.parent, "init", "-q")
    git(path.parent, "commit", "-q", "--allow-empty", "-m", "one")
    commit, ran = git(path.parent, "rev-parse", "HEAD"), tmp_path / "ran"
    hook = tmp_path / "hook.sh"
    hook.write_text(f"#!/bin/sh\ntouch {ran}\n")
    hook.chmod(0o755)
    git(path.parent, "config", "core.fsmonitor", str(hook))
    git(path.parent, "status")
    assert ran.exists()  # git does
    ran.unlink()
    monkeypatch.setattr(subprocess, "Popen", lambda *words, **more: pytest.fail(f"it runs {words}"))
    (found,) = kept_by(planned(tmp_path / "c", robot__file=path))[0].values()
    assert found["commit"] == commit and not ran.exists()


def test_files_of_git_that_are_none_name_no_commit(tmp_path: Path, secret: Path) -> None:
    path = model_in(tmp_path / "foreign")
    marker = path.parent / ".git"
    for text in ("", "gitdir: nowhere", f"gitdir: {secret}", "gitdir: \0", "gitdir: " + "x" * 5000):
        marker.write_text(text)
        assert _commit(path) == ""
    marker.unlink()
    marker.mkdir()
    for head in (
        "",
        "ref: ../../home/id_rsa",
        f"ref: {secret}",
        "ref: \0",
        "ref: refs/heads/none",
        "SECRET",
        "0" * 41,
        "ref: (((",
        "ref: .invalid",
    ):
        (marker / "HEAD").write_text(head)
        assert _commit(path) == ""
    (marker / "HEAD").unlink()
    if hasattr(os, "mkfifo"):  # who opened it would wait for ever
        os.mkfifo(marker / "HEAD")
    assert _commit(path) == ""


def test_runs_agree_to_a_frame_and_differ_in_outcome_or_number() -> None:
    row = {
        "folder": "a",
        "outcome": "converged",
        "time_to_converge_s": 2.0,
        "final_error_px": 0.1,
        "path_ratio": None,
    }
    rows = [row | {"folder": name} for name in "abcd"]
    now = [
        rows[0],
        rows[1] | {"time_to_converge_s": 2.04},
        rows[2] | {"final_error_px": 0.3},
        rows[3] | {"outcome": "timed_out"},
    ]
    found = agreement(pl.DataFrame(rows), pl.DataFrame(now))
    assert (found.same, found.near) == (1, 1)
    assert found.differ == ("c: final_error_px 0.1, now 0.3", "d: converged, now timed_out")
    assert found.lines()[0].startswith("2 of 4 runs agree (1 to the last digit, 1 within")


FOREIGN_PYTHON = {
    "of Python 2": b"print 'hello'\n",
    "with a NUL": b"a\0b",
    "nested deeply": b"x=" + b"(" * 5000 + b")" * 5000,
    "a sum of 20,000": b"x=" + b"+".join([b"1"] * 20000),
    "too large": b"import os\n#" + b"x" * (5 << 20),
}


@pytest.mark.parametrize("text", FOREIGN_PYTHON.values(), ids=FOREIGN_PYTHON)
def test_a_python_file_that_is_not_understood_is_copied_and_needs_nothing(
    text: bytes, tmp_path: Path
) -> None:
    (tmp_path / "law.py").write_text("import other\n")
    (tmp_path / "other.py").write_bytes(text)
    assert needed_files([tmp_path / "law.py"]) == ([tmp_path / "law.py", tmp_path / "other.py"], [])


def test_the_name_of_a_branch_is_no_more_than_a_name(tmp_path: Path) -> None:
    """It is searched for in a file of git: a name of megabytes would take as long as it is."""
    git = tmp_path / ".git"
    git.mkdir()
    (tmp_path / "law.py").write_text("")
    (git / "packed-refs").write_text(
        f"# pack-refs with: peeled\n{'b' * 40} refs/heads/xy\n{'a' * 40} refs/heads/x.y\n"
    )
    (git / "HEAD").write_text("ref: refs/heads/x.y\n")
    assert _commit(tmp_path / "law.py") == "a" * 40
    (git / "HEAD").write_text("ref: " + "a" * (4 << 20))
    began = time.monotonic()
    assert _commit(tmp_path / "law.py") == ""
    assert time.monotonic() - began < 2  # s: it is not read; to search for it took over 20
