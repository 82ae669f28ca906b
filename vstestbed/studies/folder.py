"""The folder of a study that goes on; held by one process, with its plan."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from vstestbed.core.errors import ParameterError, RunFolderError
from vstestbed.core.files import make_folder, only_writer, write_whole
from vstestbed.core.registry import to_mapping
from vstestbed.scenario.dump import as_yaml
from vstestbed.scenario.load import for_another_folder

__all__ = ["RESUMABLE", "resumed_folder", "write_plan"]

RESUMABLE = "give a new one, or --resume to go on with what is there"


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
