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
import sys
import typing
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.metadata import EntryPoints
from typing import Any, TypeVar, dataclass_transform

import pydantic
from pydantic import ConfigDict, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.dataclasses import dataclass as _pydantic_dataclass
from pydantic.dataclasses import rebuild_dataclass
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from vstestbed.core.errors import ParameterError
from vstestbed.core.refusals import refusal, refuse_conversions
from vstestbed.core.registry import ROOMS, SPECS, Contract, Room, blocks_in, fields_of

# Which spec classes hold a block of a room, at any depth: those whose validators a new kind of it makes stale.


def holders(rooms: Collection[str]) -> list[type]:
    """The spec classes, in the order of definition, in which a block of one of these rooms (`Room.what`) may stand. A class that holds one
    that does is one of them, too: pydantic compiles the validators of the parts into that of the whole.
    """
    direct, inner = _blocks()
    found = {cls for cls, whats in direct.items() if not whats.isdisjoint(rooms)} | {cls for cls in SPECS if not _types(cls)}
    while more := {cls for cls, held in inner.items() if held & found} - found:
        found |= more
    return [cls for cls in SPECS if cls in found]


def _blocks() -> tuple[dict[type, set[str]], dict[type, set[type]]]:
    direct: dict[type, set[str]] = {}
    inner: dict[type, set[type]] = {}
    ahead = list(SPECS)
    while ahead:
        cls = ahead.pop()
        if cls not in inner:
            blocks = [block for hint in _types(cls) for block in blocks_in(hint)]
            direct[cls] = {room.what for room, _ in blocks if room is not None}
            inner[cls] = {held for _, held in blocks}
            ahead += inner[cls]
    return direct, inner


@functools.cache
def _types(cls: type) -> tuple[Any, ...]:
    """The types of a class's fields; none where a name in them cannot be found, as in a class within a function."""
    try:
        return tuple(typing.get_type_hints(cls, include_extras=True).values())
    except NameError:
        return ()


T = TypeVar("T")
# Not strict: YAML has lists where a spec has tuples, and integers where it has floats. `scenario.validation` refuses other conversions.
_CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True, strict=False)
_GROWN: list[str] = []  # rooms that have got a kind since the validators were built


@dataclass_transform(kw_only_default=True, frozen_default=True)
def spec(cls: type[T]) -> type[T]:
    """Make `cls` a frozen keyword-only dataclass whose constructor refuses unknown, mistyped and out-of-range values. Raises (from the
    constructor): ParameterError with the field, what is valid, and the value given.
    """
    made: Any = _pydantic_dataclass(cls, frozen=True, kw_only=True, config=_CONFIG)
    _with_our_errors(made)
    SPECS.append(made)
    return made


def _with_our_errors(cls: Any) -> None:
    """Let pydantic's constructor of a spec class raise ParameterError, in the words of a scenario's file."""
    checked_init = cls.__init__

    def init(self: Any, *nameless: Any, **values: Any) -> None:
        if refresh_specs():
            type(self).__init__(self, *nameless, **values)
            return
        if nameless:
            first = next((name for name in fields_of(cls) if name != "kind"), "kind")
            raise ParameterError(cls.__name__, f"takes its fields by their names, such as {cls.__name__}({first}=...)", nameless)
        try:
            checked_init(self, **values)
        except pydantic.ValidationError as error:
            raise refusal(error, cls, values) from None
        refuse_conversions(self, values)

    cls.__init__ = init


def refresh_specs() -> bool:
    """Rebuild the validators where a room has grown since the last time; whether that was so."""
    if not _GROWN:
        return False
    rebuild_specs(holders(_GROWN))
    return True


def needs_rebuild(room: str) -> None:
    """Let the next constructor rebuild the validators that hold blocks of this room (`OneOf.what`): it has got other kinds."""
    _GROWN.append(room)


def rebuild_specs(classes: Sequence[type] = SPECS) -> None:
    """Rebuild the validators of specs in the order of definition; the next constructor does it after a `OneOf` has grown. Pydantic compiles
    a validator when the class is defined, with the kinds known then; without this a plugin's kind is refused.
    """
    _GROWN.clear()
    for cls in classes:
        rebuild_dataclass(cls, force=True)
        _with_our_errors(cls)  # pydantic has put its own constructor back


@contextmanager
def undone_on_error() -> Iterator[None]:
    """Take back what was defined and registered within where an error ends it: a plugin is there as a whole, or not at all."""
    specs, members = len(SPECS), [(room, dict(room.members)) for room in ROOMS]
    try:
        yield
    except BaseException:
        del SPECS[specs:]
        for room, before in members:
            if room.members != before:
                room.members.clear()
                room.members.update(before)
                needs_rebuild(room.what)
        raise


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
        self._left_out: set[str] = set()  # of each validator that was built from this room, the kind that it leaves out; "" for none
        for member in members:
            self._add(member)

    def add(self, member: type[T]) -> type[T]:
        """Register one more kind (usable as a decorator by a plugin).
        Raises ParameterError: the class is no spec, its word is taken, or it breaks the contract of the room.
        """
        if self._add(member) and self._left_out - {kind_of(member)}:
            needs_rebuild(self.what)
        return member

    def without(self, kind: str) -> OneOf:
        """The same room for a field in the block of one of its kinds, which may not hold another of that kind."""
        return _Without(self, kind)

    def _add(self, member: type) -> bool:
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
        if self.contract is not None:
            self.contract.check(member)
        new = self.members.get(kind) is not member
        self.members[kind] = member
        return new

    def load_entry_points(self, installed: EntryPoints) -> bool:
        """Register the classes that installed packages offer under `vstestbed.<what>s`; True if any was new."""
        before = len(self.members)
        for entry in installed.select(group=f"vstestbed.{self.what}s"):
            self.add(entry.load())
        return len(self.members) > before

    def _block(self, value: Any) -> Any:
        """A value as a block with a valid kind, for pydantic; objects that are members already pass unchanged."""
        if isinstance(value, tuple(self.members.values())):
            return value
        block, words = self._expanded(value), ", ".join(sorted(self.members))
        if not isinstance(block, dict):
            raise PydanticCustomError("block", "must be a {what} block or one of the words: {words}", {"what": self.what, "words": words})
        kind = block.get("kind", self.implied(block) or self.default)
        if kind is None:
            raise PydanticCustomError("no_kind", "needs {words}", {"words": self._needs})
        if not isinstance(kind, str) or kind not in self.members:
            raise PydanticCustomError("unknown_kind", "is no {what}; {hint}", {"what": self.what, "hint": f"valid kinds: {words}"})
        return {**block, "kind": kind}

    def _expanded(self, value: Any) -> Any:
        if isinstance(value, str):
            return {"kind": value}
        # Python's bool is an int: without the exception `gain: true` would be a gain of 1.
        if self.number and isinstance(value, int | float) and not isinstance(value, bool):
            return {"kind": self.number[0], self.number[1]: value}
        return value

    @property
    def _needs(self) -> str:
        words = f"a kind; valid kinds: {', '.join(sorted(self.members))}"
        return f"one of the fields {', '.join(self.fields)}, or {words}" if self.fields else words

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        self._is_built()
        if not self.members:  # until a plugin adds one
            return core_schema.no_info_plain_validator_function(self._none)
        # Discriminated by `kind`: an error is then one of the block that was meant, not one of each kind.
        choices: dict[Any, CoreSchema] = {k: handler.generate_schema(m) for k, m in self.members.items()}
        union = core_schema.tagged_union_schema(choices, lambda v: v["kind"] if isinstance(v, dict) else v.kind)
        return core_schema.no_info_before_validator_function(self._block, union)

    def _is_built(self) -> None:
        self._left_out.add("")

    def _none(self, value: Any) -> Any:
        words = f"must not be given: there is no kind of {self.what}; a plugin may add one (`--plugin FILE.py`)"
        raise PydanticCustomError("block", "{words}", {"words": words})

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        if not self.members:
            return {"not": {}}
        blocks = handler(schema)["oneOf"]
        # In the classes `kind` has a default and would be optional: without it, a block that needs a kind would pass the schema.
        needs = {} if self.default or self.fields else {"required": ["kind"]}
        choices: list[dict[str, Any]] = [block | needs for block in blocks]
        # A bare word is a block of defaults only, so it needs a kind without required fields.
        words = sorted(kind for kind, member in self.members.items() if not needed_fields(member))
        if words:
            choices.append({"enum": words})
        if self.number:
            kind, field = self.number
            block = handler.resolve_ref_schema(blocks[list(self.members).index(kind)])
            choices.append({key: value for key, value in block["properties"][field].items() if key not in ("default", "title")})
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

    def _is_built(self) -> None:
        self._room._left_out.add(self._kind)


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


def needed_fields(cls: type) -> list[str]:
    """The fields of a spec class that have no default."""
    missing = dataclasses.MISSING
    fields = dataclasses.fields(cls)
    return [f.name for f in fields if f.init and f.default is missing and f.default_factory is missing]


def kind_of(cls: type) -> str:
    """The `kind` of a spec class, the word for it in YAML; ParameterError where it has none."""
    for field in dataclasses.fields(cls):
        if field.name == "kind" and isinstance(field.default, str):
            return field.default
    raise ParameterError("kind", f"is missing: {cls.__name__} needs `kind: Literal['...'] = '...'`")
