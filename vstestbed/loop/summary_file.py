"""`summary.json` of a run's folder, checked when it is read: an editor or a broken disk may have changed it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from vstestbed.core.errors import RunFolderError
from vstestbed.core.files import read_file
from vstestbed.core.outcome import Outcome
from vstestbed.tasks.metrics import FIGURES, SOME_FIGURES

LARGEST = 2**63
"""Whole numbers from here on fit no table."""
Scalar = bool | int | float | str | None


class _Open(BaseModel):
    """Any other name holds a scalar, or a block of scalars."""

    model_config = ConfigDict(strict=True, extra="allow")
    __pydantic_extra__: dict[str, Scalar | dict[str, Scalar]]  # pyright: ignore[reportIncompatibleVariableOverride] - as pydantic has it


_NUMBERS: dict[str, Any] = dict.fromkeys((*FIGURES, *SOME_FIGURES, "wall_time_s", "real_time_factor"), (float | None, None))
_Summary = create_model(
    "_Summary",
    __base__=_Open,
    outcome=(str, ...),
    success=(bool, ...),
    reason=(str, ""),
    scenario=(str, ""),
    seed=(int, 0),
    time_ms=(dict[str, float | None], {}),
    versions=(dict[str, str], {}),
    **_NUMBERS,
)


def read_summary(folder: Path, works: str) -> dict[str, Any]:
    """The summary of a run.

    Args:
        folder: the run's folder. works: what would work where the summary is damaged, for the message.

    Raises:
        RunFolderError: it is missing, cannot be read, is no JSON, or is not the summary of a run.
    """
    path = folder / "summary.json"
    content = read_file(path, works)
    fault, summary = _checked(content)
    if fault is not None:
        raise RunFolderError(path, f"is not the summary of a run ({fault})", works)
    return summary


def _checked(content: bytes) -> tuple[str | None, dict[str, Any]]:
    """What is wrong with a summary, None for a sound one; and its content, where it can be read."""
    try:
        summary = _Summary.model_validate_json(content)
    except ValidationError as error:
        first = error.errors()[0]
        return ": ".join([*(str(part) for part in first["loc"][:1]), first["msg"]]), {}
    outcome = getattr(summary, "outcome", "")
    if outcome not in Outcome.__members__:
        return f"outcome: {outcome[:40]!r} is none", {}
    found = json.loads(content)  # numbers as they are written: a whole one stays whole
    values = [item for block in (found, *found.values()) if isinstance(block, dict) for item in block.items()]
    large = (f"{name}: too large a number" for name, v in values if isinstance(v, int) and abs(v) >= LARGEST)
    return next(large, None), found
