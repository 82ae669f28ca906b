"""From plain mappings to specs: every mistake as a sentence with its position in the file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

import pydantic

from vstestbed.core.errors import Mistake, ScenarioError
from vstestbed.core.refusals import converted, findings
from vstestbed.core.registry import to_mapping, validator_of
from vstestbed.scenario.yaml_marks import FROM_PYTHON, Marks, override, place_of

T = TypeVar("T")


def build(cls: type[T], plain: dict[str, Any], marks: Marks, file: str) -> T:
    """An object of the spec class `cls` from the YAML as plain values, with the positions of its keys and the file's name for messages.
    Raises ScenarioError: all mistakes at once, each with its position in the file.
    """
    try:
        made = validator_of(cls).validate_python(plain)
        found = list(converted(plain, to_mapping(made), ()))
        if not found:
            return made
    except pydantic.ValidationError as error:
        found = findings(error, plain, cls)
    mistakes = [Mistake(place_of(key, marks, file), ".".join(map(str, key)), words) for key, words in dict.fromkeys(found)]
    raise ScenarioError(sorted(mistakes, key=_reading_order))


def _reading_order(mistake: Mistake) -> tuple[int, ...]:
    """Sort key (line, column) of a mistake; those of --set, which have no position, come last."""
    place = mistake.where.rsplit(":", 2)[1:]
    return tuple(int(n) for n in place) if len(place) == 2 else (1 << 31,)


def put_over(plain: dict[str, Any], values: Mapping[str, object], marks: Marks, places: Mapping[str, Marks]) -> None:
    """Put values over a scenario's mapping, in place and in their order, by dotted path. marks: positions of its keys, also
    changed. places: of the values, and of the keys in them. Raises ScenarioError: see `override`.
    """
    for path, value in values.items():
        override(plain, path, value, marks, places.get(path, FROM_PYTHON))
