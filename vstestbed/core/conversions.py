"""Values that pydantic converts silently, such as a quoted number: they are refused, in a file and in a constructor alike."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from vstestbed.core.errors import ParameterError, short
from vstestbed.core.mapping import to_mapping

Key = tuple[str | int, ...]


def refuse_conversions(made: Any, values: Mapping[str, Any]) -> None:
    """Refuse what pydantic has converted to a number or a truth value in a constructor in Python: a text, or True for 1.

    Raises:
        ParameterError: it names the field and what it should have been.
    """
    for name, value in values.items():
        if _may_convert(value):
            for key, words in converted(value, to_mapping(getattr(made, name)), (name,)):
                raise ParameterError(".".join((type(made).__name__, *map(str, key))), words)


def _may_convert(value: Any) -> bool:
    """Whether pydantic could have converted a value, or something in it: a quick look, for this is in every constructor."""
    kind = type(value)
    if kind is tuple or kind is list:
        return any(map(_may_convert, value))
    return kind is str or kind is bool or kind is dict


def converted(plain: Any, built: Any, key: Key) -> Iterator[tuple[Key, str]]:
    """Errors for values that pydantic silently converted to another type, such as a quoted number, or true for 1.

    Pydantic's strict mode is no way out: it would also refuse the lists of YAML for fields that are tuples.

    Args:
        plain: what was given. built: what it has become (`to_mapping`). key: of both.
    """
    if isinstance(plain, dict) and isinstance(built, dict):
        for name in plain:
            yield from converted(plain[name], built.get(name), (*key, name))
    elif isinstance(plain, list | tuple) and isinstance(built, list):
        for i, (p, b) in enumerate(zip(plain, built, strict=False)):
            yield from converted(p, b, (*key, i))
    elif (expected := _expected_type(plain, built)) is not None:
        yield key, f"must be {expected}, got {short(plain)}"


def _expected_type(plain: Any, built: Any) -> str | None:
    """The type that a scalar should have had; None where it was not converted."""
    if isinstance(built, bool):  # before int: a bool is one
        return None if isinstance(plain, bool) else "true or false"
    return "a number" if isinstance(built, int | float) and isinstance(plain, str | bool) else None
