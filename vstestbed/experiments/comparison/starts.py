"""Start tables: starts that form a task, such as rotations of 20 to 180 deg about the optical axis."""

from __future__ import annotations

import json
from dataclasses import field
from functools import cached_property
from typing import Annotated, Any, NamedTuple

from annotated_types import Ge, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose
from vstestbed.core.named_files import place_of_file
from vstestbed.core.spec import spec


class StartLists(NamedTuple):
    """The lists of a start table, one entry a run: values by dotted path, and displacements of the camera or of the target."""

    each: dict[str, tuple[Any, ...]]
    camera_from_goal: tuple[Pose, ...] = ()
    target_from_goal: tuple[Pose, ...] = ()


MUST_BE = 'must be JSON like {"camera_from_goal": [{"xyz": [0, 0, 0.1], "rpy_deg": [0, 0, 20]}]}'
"""What a file of starts holds."""


@spec
class StartTable:
    """The starts of a task: run i has the i-th value of every list in `each`, the i-th displacement, or the start that seed i draws.

    Args:
        set: values by dotted path, for all runs of the task.
        each: lists of values by dotted path, all of the same length, one value per run.
        camera_from_goal: in place of `each`, or beside it: poses of the camera in the frame of the camera at its goal, for any arm,
            whose joints follow by inverse kinematics (`Scenario.displaced`).
        target_from_goal: in place of `camera_from_goal`: poses of the target in its frame at the goal, as the camera is to see it.
        seeds: in place of these lists: number of random starts.
        file: in place of these lists: a JSON file, relative to the comparison's, with one or more of `each`, `camera_from_goal` and
            `target_from_goal` as they are written here; e.g. `my_starts.json`.
        amounts: label of each run [unit as in `unit`]: 20 (deg), 40, ...; by default its number from 0, as in `seed` and in
            the name of its folder.
        unit: unit of the amounts.
    """

    set: dict[str, Any] = field(default_factory=dict)
    each: dict[str, tuple[Any, ...]] = field(default_factory=dict)
    camera_from_goal: tuple[Pose, ...] = ()
    target_from_goal: tuple[Pose, ...] = ()
    seeds: Annotated[int, Ge(1), Le(1_000_000)] | None = None
    file: str | None = None
    amounts: tuple[float, ...] = ()
    unit: str = ""

    def __post_init__(self) -> None:
        """Refuse lists of different lengths."""
        given = [bool(self.each or self.camera_from_goal or self.target_from_goal), self.file is not None, self.seeds is not None]
        if sum(given) != 1 or (self.camera_from_goal and self.target_from_goal):
            words = "or camera_from_goal, target_from_goal, seeds or file must say what the runs of a task are"
            raise ParameterError("each", f"{words}; give one of the five, or each beside one of the two displacements")
        self._check_lists()
        if self.amounts and len(self.amounts) != self.runs:
            raise ParameterError("amounts", f"must name each of the {self.runs} runs", list(self.amounts))

    def _check_lists(self) -> None:
        found = self.lists
        lengths = {path: len(values) for path, values in found.each.items()}
        lengths |= {name: len(poses) for name, poses in found._asdict().items() if name != "each" and poses}
        where = "each" if self.file is None else "file"
        if 0 in lengths.values() or len(set(lengths.values())) > 1:
            raise ParameterError(where, "must have one value or more for each run in every list; their lengths are", lengths)
        if not lengths and self.seeds is None:
            raise ParameterError(where, f"must hold one or more of {', '.join(StartLists._fields)}", self.file)

    @cached_property
    def lists(self) -> StartLists:
        """The lists given here, or those of the file."""
        if self.file is None:
            return StartLists(self.each, self.camera_from_goal, self.target_from_goal)
        return _read_lists(self.file)

    @property
    def runs(self) -> int:
        """Number of runs."""
        if self.seeds is not None:
            return self.seeds
        return len(self.displacements or next(iter(self.lists.each.values())))

    @property
    def displacements(self) -> tuple[Pose, ...]:
        """Those of the camera or of the target."""
        return self.lists.camera_from_goal or self.lists.target_from_goal

    def setting(self, i: int) -> dict[str, object]:
        """The settings of run i by dotted path."""
        return {path: values[i] for path, values in self.lists.each.items()}

    def numbers(self, limit: int | None) -> tuple[int, ...]:
        """The numbers of the runs that are made, from 0: all, or `limit` of them, spread evenly; of random starts the first ones."""
        if limit is None or limit >= self.runs:
            return tuple(range(self.runs))
        if self.seeds is not None:
            return tuple(range(limit))
        return tuple((2 * i + 1) * self.runs // (2 * limit) for i in range(limit))  # in the middle of equal parts

    def labels(self) -> tuple[str, ...]:
        """The label of each run; without amounts its number from 0, by which table and folder have it."""
        return tuple(f"{amount:g} {self.unit}".strip() for amount in self.amounts or range(self.runs))


def _read_lists(file: str) -> StartLists:
    """The lists of a table's file.

    Raises:
        ParameterError: it is not there, is no JSON, or holds something else.
    """
    path = place_of_file(file)
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        unknown = set(found) - {*StartLists._fields, "about"}
        if unknown:
            raise ParameterError("file", f"may have {', '.join(StartLists._fields)} and about; it also has {', '.join(unknown)}", file)
        poses = {name: tuple(Pose(**pose) for pose in found.get(name, ())) for name in StartLists._fields[1:]}
        each = {str(key): tuple(values) for key, values in found.get("each", {}).items()}
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError("file", f"cannot be read ({getattr(error, 'strerror', None) or error})", file) from None
    except RecursionError:
        raise ParameterError("file", f"is nested too deeply; {MUST_BE}", file) from None
    except (ValueError, TypeError, AttributeError) as error:  # a Pose of something else raises a ValueError, too
        raise ParameterError("file", f"{MUST_BE}; reading it failed: {error}", file) from None
    return StartLists(each, **poses)
