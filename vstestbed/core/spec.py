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
from vstestbed.core.registry import SPECS, validator_of

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
    # Whether the defaults alone make no object: a field has none, or a validator of pydantic's
    # checks what has been made. One in the mode "before" reads what is given, and has nothing to
    # read then.
    has_more = any(
        field.init and field.default is field.default_factory is dataclasses.MISSING
        for field in dataclasses.fields(made)
    )
    checks = (
        getattr(member, "decorator_info", None)
        for base in made.__mro__
        for member in vars(base).values()
    )
    has_more |= any(
        check is not None and getattr(check, "mode", "") != "before" for check in checks
    )

    def init(self: Any, *nameless: Any, **values: Any) -> None:
        construct(self, made, has_more, nameless, values)

    made.__init__, made.__signature__ = init, _Signature()
    made.__setattr__ = made.__delattr__ = _frozen
    for name, method in (("__eq__", _equal), ("__hash__", _hashed), ("__repr__", _shown)):
        # a class with __eq__ alone has None for the other
        if name not in vars(cls) or vars(cls)[name] is None:
            setattr(made, name, method)
    SPECS.append(made)
    return made


def _frozen(self: Any, name: str, *_: Any) -> None:
    raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")


@functools.cache
def _compared(cls: type) -> tuple[str, ...]:
    return tuple(field.name for field in dataclasses.fields(cls) if field.compare)


def _equal(self: Any, other: object) -> Any:
    if other.__class__ is not self.__class__:
        return NotImplemented
    mine, others = self.__dict__, other.__dict__
    return [mine[name] for name in _compared(type(self))] == [
        others[name] for name in _compared(type(self))
    ]


def _hashed(self: Any) -> int:
    values = self.__dict__
    parts = [values[name] for name in _compared(type(self))]
    return hash(tuple([tuple(part.items()) if type(part) is dict else part for part in parts]))


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
        given = [field for field in dataclasses.fields(cls) if field.init]
        own = [
            inspect.Parameter(
                f.name, inspect.Parameter.KEYWORD_ONLY, default=_default(f), annotation=f.type
            )
            for f in given
        ]
        return inspect.Signature(own)


def _default(field: dataclasses.Field[Any]) -> Any:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return inspect.Parameter.empty if field.default is dataclasses.MISSING else field.default


def construct(
    made: Any, cls: type, has_more: bool, nameless: tuple[Any, ...], values: dict[str, Any]
) -> None:
    """Fill an object of a spec class with checked values. has_more: its defaults alone do not make
    one.
    """
    if nameless:
        first = next((name for name in fields(cls) if name != "kind"), "kind")
        raise ParameterError(
            cls.__name__,
            f"takes its fields by their names, such as {cls.__name__}({first}=...)",
            nameless,
        )
    if not (values or has_more):  # defaults need no check
        made.__dict__.update((field.name, _default(field)) for field in dataclasses.fields(cls))
        if hasattr(made, "__post_init__"):
            made.__post_init__()
        return
    try:
        validator_of(cls).validate_python(ArgsKwargs((), values), self_instance=made)
    except pydantic.ValidationError as error:
        raise message(error, cls, values) from None
    refuse_conversions(made, values)


@dataclasses.dataclass(frozen=True)
class Shorthand:
    """For `Annotated` of a spec: a text stands for the block that has it in one field. field: its
    name.
    """

    field: str

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_before_validator_function(
            lambda v: {self.field: v} if isinstance(v, str) else v, handler(source)
        )

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        return {"anyOf": [handler(schema), {"type": "string"}]}


@dataclasses.dataclass(frozen=True)
class FromFile:
    """For `Annotated` of a spec: the name of a file stands for the block that it holds. read: from
    the name to the block's values.
    """

    read: Callable[[str], Any]

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        return core_schema.no_info_before_validator_function(
            lambda v: self.read(v) if isinstance(v, str) else v, handler(source)
        )

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        return {"anyOf": [handler(schema), {"type": "string"}]}


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
