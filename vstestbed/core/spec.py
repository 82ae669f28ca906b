"""@spec: the classes that a block of a scenario may become.

A spec is a frozen keyword-only dataclass whose constructor validates its values; the same class is
the YAML block, the object that runs, and the JSON Schema. Pydantic validates; `core.messages` turns
its errors into ParameterError. The kinds of a block are in its registry (`core.registry`).

    @spec
    class Disc:
        kind: Literal["disc"] = "disc"
        radius: PositiveLength
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import sys
import typing
from collections.abc import Callable
from typing import Any, TypeVar, dataclass_transform

import pydantic
from pydantic import ConfigDict, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import ArgsKwargs, CoreSchema, core_schema

from vstestbed.core.errors import ParameterError
from vstestbed.core.fields import fields
from vstestbed.core.messages import message, refuse_conversions
from vstestbed.core.registry import SPECS, default_of, is_needed, validator_of

__all__ = ["FromFile", "OrText", "Shorthand", "spec"]

T = TypeVar("T")
# Not strict: YAML has lists where a spec has tuples, and integers where it has floats.
# `scenario.yaml_marks` refuses other conversions.
_CONFIG = ConfigDict(
    extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True, strict=False
)


@dataclass_transform(kw_only_default=True, frozen_default=True)
def spec(cls: type[T]) -> type[T]:
    """Make `cls` a frozen keyword-only dataclass whose constructor refuses unknown, mistyped and
    out-of-range values. Raises (from the constructor): ParameterError with the field, what is
    valid, and the value given.
    """
    # The methods are the same for all specs: dataclass would compile five for each class, which
    # takes half of the time of a start.
    made: Any = dataclasses.dataclass(cls, init=False, repr=False, eq=False, kw_only=True)  # pyright: ignore[reportCallIssue, reportArgumentType] - of any class
    made.__pydantic_config__ = _CONFIG
    # the names in its annotations may be those of a function, which later nobody finds
    if "<locals>" in made.__qualname__:
        types = typing.get_type_hints(
            made, localns=dict(sys._getframe(1).f_locals), include_extras=True
        )
        for field in dataclasses.fields(made):
            field.type = types[field.name]
    # whether the defaults alone make no object
    has_more = any(map(is_needed, dataclasses.fields(made))) or _is_checked(made)

    def init(self: Any, *nameless: Any, **values: Any) -> None:
        construct(self, made, has_more, nameless, values)

    made.__init__ = init
    made.__signature__ = _Signature()
    made.__setattr__ = made.__delattr__ = _frozen
    for name, method in (("__eq__", _equal), ("__hash__", _hashed), ("__repr__", _shown)):
        # a class with __eq__ alone has None for the other
        if name not in vars(cls) or vars(cls)[name] is None:
            setattr(made, name, method)
    SPECS.append(made)
    return made


def _is_checked(cls: type) -> bool:
    """Whether a validator of pydantic's checks what has been made. One in the mode "before" reads
    what is given, and has nothing to read where nothing is.
    """
    for base in cls.__mro__:
        for member in vars(base).values():
            check = getattr(member, "decorator_info", None)
            if check is not None and getattr(check, "mode", "") != "before":
                return True
    return False


def _frozen(self: Any, name: str, *_: Any) -> None:
    raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")


@functools.cache
def _compared(cls: type) -> tuple[str, ...]:
    return tuple(field.name for field in dataclasses.fields(cls) if field.compare)


def _equal(self: Any, other: object) -> Any:
    if other.__class__ is not self.__class__:
        return NotImplemented
    return _values(self) == _values(other)


def _values(one: Any) -> list[Any]:
    values = one.__dict__
    return [values[name] for name in _compared(type(one))]


def _hashed(self: Any) -> int:
    parts = [tuple(v.items()) if type(v) is dict else v for v in _values(self)]
    return hash(tuple(parts))


def _shown(self: Any) -> str:
    values = ", ".join(
        f"{field.name}={getattr(self, field.name)!r}"
        for field in dataclasses.fields(self)
        if field.repr
    )
    return f"{type(self).__qualname__}({values})"


class _Signature:
    """The signature of a spec's constructor for `help` and notebooks, made when somebody asks."""

    def __get__(self, made: object, cls: type) -> inspect.Signature:
        only = inspect.Parameter.KEYWORD_ONLY
        own = []
        for f in dataclasses.fields(cls):
            if f.init:
                default = inspect.Parameter.empty if is_needed(f) else default_of(f)
                own.append(inspect.Parameter(f.name, only, default=default, annotation=f.type))
        return inspect.Signature(own)


def construct(
    made: Any, cls: type, has_more: bool, nameless: tuple[Any, ...], values: dict[str, Any]
) -> None:
    """Fill an object of a spec class with checked values. has_more: its defaults alone do not make
    one.
    """
    if nameless:
        first = next((name for name in fields(cls) if name != "kind"), "kind")
        words = f"takes its fields by their names, such as {cls.__name__}({first}=...)"
        raise ParameterError(cls.__name__, words, nameless)
    if not (values or has_more):  # defaults need no check
        made.__dict__.update((field.name, default_of(field)) for field in dataclasses.fields(cls))
        if hasattr(made, "__post_init__"):
            made.__post_init__()
        return
    try:
        validator_of(cls).validate_python(ArgsKwargs((), values), self_instance=made)
    except pydantic.ValidationError as error:
        raise message(error, cls, values) from None
    refuse_conversions(made, values)


@dataclasses.dataclass(frozen=True)
class OrText:
    """For `Annotated` of a field whose class reads another text than those listed, such as a file's
    name, before it is validated.
    """

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return handler(source)

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        return {"anyOf": [handler(schema), {"type": "string"}]}


@dataclasses.dataclass(frozen=True)
class FromText(OrText):
    """For `Annotated` of a spec: a text stands for the block that is read from it. read: from the
    text to the block's values.
    """

    read: Callable[[str], Any]

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_before_validator_function(self._block, handler(source))

    def _block(self, value: Any) -> Any:
        return self.read(value) if isinstance(value, str) else value


class FromFile(FromText):
    """The same of the name of a file, for the block that it holds."""


class Shorthand(FromText):
    """The same of a text that the block has in one field. field: its name."""

    def __init__(self, field: str):
        super().__init__(lambda text: {field: text})
