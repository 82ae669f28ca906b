"""@spec and OneOf: the classes that a block of a scenario may become.

A spec is a frozen keyword-only dataclass whose constructor validates its values; the same class is the YAML block, the object
that runs, and the JSON Schema. Pydantic validates; this file turns its errors into ParameterError and adds lists of kinds that grow.

    @spec
    class Disc:
        kind: Literal["disc"] = "disc"
        radius: PositiveLength

    MARKERS = OneOf("marker", Disc, Sphere)      # in YAML: {kind: disc, radius: 0.02}, or the bare word where all has defaults
    marker: Annotated[Marker, MARKERS]
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import sys
import typing
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import EntryPoints
from typing import Any, TypeVar, dataclass_transform

import pydantic
from pydantic import ConfigDict, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import ArgsKwargs, CoreSchema, PydanticCustomError, core_schema

from vstestbed.core.errors import ParameterError
from vstestbed.core.fields import fields, needed
from vstestbed.core.refusals import refusal, refuse_conversions
from vstestbed.core.registry import ROOMS, SPECS, Contract, Room

T = TypeVar("T")
# Not strict: YAML has lists where a spec has tuples, and integers where it has floats. `scenario.validation` refuses other conversions.
_CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True, strict=False)


@dataclass_transform(kw_only_default=True, frozen_default=True)
def spec(cls: type[T]) -> type[T]:
    """Make `cls` a frozen keyword-only dataclass whose constructor refuses unknown, mistyped and out-of-range values. Raises (from the
    constructor): ParameterError with the field, what is valid, and the value given.
    """
    # The methods are the same for all specs: dataclass would compile five for each class, which takes half of the time of a start.
    made: Any = dataclasses.dataclass(cls, init=False, repr=False, eq=False, kw_only=True)  # pyright: ignore[reportCallIssue, reportArgumentType] - of any class
    made.__pydantic_config__ = _CONFIG
    if "<locals>" in made.__qualname__:  # the names in its annotations may be those of a function, which later nobody finds
        types = typing.get_type_hints(made, localns=dict(sys._getframe(1).f_locals), include_extras=True)
        for field in dataclasses.fields(made):
            field.type = types[field.name]
    has_more = _needs_values(made)

    def init(self: Any, *nameless: Any, **values: Any) -> None:
        construct(self, made, has_more, nameless, values)

    made.__init__, made.__signature__ = init, _Signature()
    made.__setattr__ = made.__delattr__ = _frozen
    for name, method in (("__eq__", _equal), ("__hash__", _hashed), ("__repr__", _shown)):
        if name not in vars(cls) or vars(cls)[name] is None:  # a class with __eq__ alone has None for the other
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
    return [mine[name] for name in _compared(type(self))] == [others[name] for name in _compared(type(self))]


def _hashed(self: Any) -> int:
    values = self.__dict__
    return hash(tuple([values[name] for name in _compared(type(self))]))


def _shown(self: Any) -> str:
    values = ", ".join(f"{field.name}={getattr(self, field.name)!r}" for field in dataclasses.fields(self) if field.repr)
    return f"{type(self).__qualname__}({values})"


class _Signature:
    """The signature of a spec's constructor for `help` and notebooks, made when somebody asks."""

    def __get__(self, made: object, cls: type) -> inspect.Signature:
        given = [field for field in dataclasses.fields(cls) if field.init]
        own = [inspect.Parameter(f.name, inspect.Parameter.KEYWORD_ONLY, default=_default(f), annotation=f.type) for f in given]
        return inspect.Signature(own)


def _default(field: dataclasses.Field[Any]) -> Any:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return inspect.Parameter.empty if field.default is dataclasses.MISSING else field.default


def _needs_values(cls: type) -> bool:
    """Whether the defaults alone make no object: a field has none, or a validator of pydantic's may put values where none are given."""
    lacks = any(field.init and field.default is field.default_factory is dataclasses.MISSING for field in dataclasses.fields(cls))
    return lacks or any(hasattr(member, "decorator_info") for base in cls.__mro__ for member in vars(base).values())


def construct(made: Any, cls: type, has_more: bool, nameless: tuple[Any, ...], values: dict[str, Any]) -> None:
    """Fill an object of a spec class with checked values. has_more: its defaults alone do not make one."""
    if nameless:
        first = next((name for name in fields(cls) if name != "kind"), "kind")
        raise ParameterError(cls.__name__, f"takes its fields by their names, such as {cls.__name__}({first}=...)", nameless)
    if not (values or has_more):  # defaults need no check
        made.__dict__.update((field.name, _default(field)) for field in dataclasses.fields(cls))
        if hasattr(made, "__post_init__"):
            made.__post_init__()
        return
    try:
        validator_of(cls).validate_python(ArgsKwargs((), values), self_instance=made)
    except pydantic.ValidationError as error:
        raise refusal(error, cls, values) from None
    refuse_conversions(made, values)


@functools.cache
def validator_of(cls: type) -> Any:
    """Pydantic's validator of a spec class, built when it is first used. The kinds of a room are looked up when a block is validated, so
    that a validator stays valid when a plugin adds one.
    """
    return pydantic.TypeAdapter(cls).validator


@contextmanager
def undone_on_error() -> Iterator[None]:
    """Take back what was defined and registered within where an error ends it: a plugin is there as a whole, or not at all."""
    specs, members = len(SPECS), [(room, dict(room.members)) for room in ROOMS]
    try:
        yield
    except BaseException:
        del SPECS[specs:]
        for room, before in members:
            room.members.clear()
            room.members.update(before)
        raise


_WHOLE: list[bool] = []  # not empty while a schema is built with the blocks of all kinds in it


def whole_adapter(hint: Any) -> pydantic.TypeAdapter[Any]:
    """Pydantic's adapter of a type with the blocks of all kinds in it, from which it makes a JSON Schema."""
    _WHOLE.append(True)
    try:
        return pydantic.TypeAdapter(hint)
    finally:
        _WHOLE.pop()


class OneOf(Room):
    """The registered kinds of one block, discriminated by `kind`; the only list of a room's members.

    Args:
        what: the name of the field ("law"); plugins are found under the entry-point group `vstestbed.<what>s`.
        members: the spec classes; each has `kind: Literal["..."] = "..."`.
        number: (kind, field) for which a bare number is a shorthand; None where numbers are refused.
        default: the kind of a block without `kind`; None where `kind` is required.
        fields: the kind of a block without `kind` that has the given field, by field.
        contract: what each member must have; None where any spec class may be a member.
    """

    def __init__(
        self,
        what: str,
        *members: type,
        number: tuple[str, str] | None = None,
        default: str | None = None,
        fields: Mapping[str, str] | None = None,
        contract: Contract | None = None,
    ):
        super().__init__(what, number, default, fields)
        self.contract = contract
        for member in members:
            self.add(member)

    def add(self, member: type[T]) -> type[T]:
        """Register one more kind (usable as a decorator by a plugin).
        Raises ParameterError: the class is no spec, its word is taken, or it breaks the contract of the room.
        """
        self._check(member)
        self.members[kind_of(member)] = member
        return member

    def without(self, kind: str) -> OneOf:
        """The same room for a field in the block of one of its kinds, which may not hold another of that kind."""
        return _Without(self, kind)

    def _check(self, member: type) -> None:
        # By identity: a subclass of a spec is a dataclass, too, but without @spec its own fields would be ignored.
        if not any(member is known for known in SPECS):
            name = getattr(member, "__name__", repr(member))
            raise ParameterError(name, f"is not a spec; a {self.what} is a class with @spec directly above it, below any `add`")
        kind = kind_of(member)
        if kind in self.members and self.members[kind] is not member and not _same_cell(self.members[kind], member):
            home = self.members[kind].__module__
            place = home if home.startswith("vstestbed.") else getattr(sys.modules.get(home), "__file__", home)
            taken = f"{kind!r} is already a {self.what} ({place})"
            raise ParameterError("kind", f"{taken}; give {member.__name__} a `kind` of its own")
        if self.contract is not None and not member.__module__.startswith("vstestbed."):  # of those a test checks it once for all starts
            self.contract.check(member)

    def load_entry_points(self, installed: EntryPoints) -> bool:
        """Register the classes that installed packages offer under `vstestbed.<what>s`; True if any was new."""
        before = len(self.members)
        for entry in installed.select(group=f"vstestbed.{self.what}s"):
            self.add(entry.load())
        return len(self.members) > before

    def _made(self, value: Any) -> Any:
        """A value as an object of the class of its kind; objects that are members already pass unchanged."""
        if isinstance(value, tuple(self.members.values())):
            return value
        if not self.members:
            words = f"must not be given: there is no kind of {self.what}; a plugin may add one (`--plugin FILE.py`)"
            raise PydanticCustomError("block", "{words}", {"words": words})
        block, words = self.expanded(value), ", ".join(sorted(self.members))
        if not isinstance(block, dict):
            raise PydanticCustomError("block", "must be a {what} block or one of the words: {words}", {"what": self.what, "words": words})
        kind = block["kind"]
        if kind is None:
            needs = f"one of the fields {', '.join(self.fields)}, or a kind" if self.fields else "a kind"
            raise PydanticCustomError("no_kind", "needs {words}", {"words": f"{needs}; valid kinds: {words}"})
        if not isinstance(kind, str) or kind not in self.members:
            raise PydanticCustomError("unknown_kind", "is no {what}; {hint}", {"what": self.what, "hint": f"valid kinds: {words}"})
        return validator_of(self.members[kind]).validate_python(block)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        if not (_WHOLE and self.members):
            return core_schema.no_info_plain_validator_function(self._made)
        choices: dict[Any, CoreSchema] = {k: handler.generate_schema(m) for k, m in self.members.items()}
        return core_schema.tagged_union_schema(choices, "kind")

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        if not self.members:
            return {"not": {}}
        blocks = handler(schema)["oneOf"]
        # In the classes `kind` has a default and would be optional: without it, a block that needs a kind would pass the schema.
        needs = {} if self.default or self.fields else {"required": ["kind"]}
        choices: list[dict[str, Any]] = [block | needs for block in blocks]
        # A bare word is a block of defaults only, so it needs a kind without required fields.
        words = sorted(kind for kind, member in self.members.items() if not needed(member))
        if words:
            choices.append({"enum": words})
        if self.number:
            kind, field = self.number
            hint = typing.get_type_hints(self.members[kind], include_extras=True)[field]
            choices.append(pydantic.TypeAdapter(hint).json_schema())
        return {"anyOf": choices}


class _Without(OneOf):
    """A room without one of its kinds; what joins the room later is in it, too."""

    def __init__(self, room: OneOf, kind: str):
        # Not OneOf's: this is no list of its own, and `ROOMS` has the room already.
        self._room, self._kind = room, kind
        self.what, self.number, self.default, self.fields = room.what, room.number, room.default, room.fields

    @property
    def members(self) -> dict[str, type]:  # pyright: ignore[reportIncompatibleVariableOverride] - of the room as it is now
        return {kind: member for kind, member in self._room.members.items() if kind != self._kind}


@dataclasses.dataclass(frozen=True)
class Shorthand:
    """For `Annotated` of a spec: a text stands for the block that has it in one field. field: its name."""

    field: str

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_before_validator_function(lambda v: {self.field: v} if isinstance(v, str) else v, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [handler(schema), {"type": "string"}]}


def _same_cell(before: type, after: type) -> bool:
    """Whether two classes are one that was defined again by hand: a notebook's cell, run once more after a change."""
    return before.__module__ == after.__module__ == "__main__" and before.__qualname__ == after.__qualname__


def kind_of(cls: type) -> str:
    """The `kind` of a spec class, the word for it in YAML; ParameterError where it has none."""
    for field in dataclasses.fields(cls):
        if field.name == "kind" and isinstance(field.default, str):
            return field.default
    raise ParameterError("kind", f"is missing: {cls.__name__} needs `kind: Literal['...'] = '...'`")
