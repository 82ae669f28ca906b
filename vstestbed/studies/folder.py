"""The folder of a study: a new one, or one that goes on; held by one process; its plan, tables and
numbers, each whole or not at all.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from vstestbed.core.errors import ParameterError, RunFolderError
from vstestbed.core.files import (
    make_folder,
    must_be_new,
    new_folder,
    only_writer,
    remove_empty,
    write_whole,
)
from vstestbed.core.registry import to_mapping
from vstestbed.scenario.dump import as_yaml
from vstestbed.scenario.load import for_another_folder

__all__ = ["RESUMABLE", "resumed_folder", "study_folder", "write_plan"]

RESUMABLE = "give a new one, or --resume to go on with what is there"


@contextmanager
def study_folder(kind: str, out: Path | None, remedy: str = "give a new one") -> Iterator[Path]:
    """Make and hold the folder of a new study: `out`, or the next free number in runs/KIND.

    It is removed again if an error leaves it empty.

    kind: the command, such as `basin`. out: the folder. remedy: what would work where it holds
    something already. Raises OutputError: it holds something already, another process writes into
    it, or it cannot be made.
    """
    folder = new_folder(Path("runs") / kind, out, remedy)
    with only_writer(folder):
        # again: another process may have finished there before this one held it
        must_be_new(folder, remedy)
        try:
            yield folder
        except BaseException:
            remove_empty(folder)
            raise


@contextmanager
def resumed_folder(kind: str, out: Path | None, plan: str) -> Iterator[Path]:
    """Hold the folder of a study that goes on; kind: the command, such as `compare`; plan: name of
    the plan in it.
    Raises RunFolderError: there is no plan.
    """
    if out is None:
        raise ParameterError.needs(
            "--resume", f"the folder that `vstestbed {kind}` has made", why="--out DIR"
        )
    if not (out / plan).is_file():
        found = (
            f"has no {plan}, so that no `vstestbed {kind}` was here"
            if out.is_dir()
            else "no such folder"
        )
        raise RunFolderError(out, found, f"`vstestbed {kind} --out DIR` makes one")
    with only_writer(out):
        yield out


def write_plan(path: Path, plan: Any, names: str) -> None:
    """Write the plan of a study, with which the study is repeated, as YAML; scenarios that are
    files are copied into its folder. path: of the plan. plan: a spec. names: its field with the
    name of a scenario, or with several.
    """
    plain = to_mapping(plan)
    given = plain[names]
    plain[names] = (
        _kept(path.parent, given)
        if isinstance(given, str)
        else [_kept(path.parent, name) for name in given]
    )
    write_whole(path, as_yaml(plain))


def _kept(folder: Path, name: str) -> str:
    """The name of a scenario for a plan in `folder`; one that is a file is copied there."""
    if not Path(name).is_file():
        return name
    write_whole(make_folder(folder / "scenarios") / Path(name).name, for_another_folder(Path(name)))
    return f"scenarios/{Path(name).name}"
