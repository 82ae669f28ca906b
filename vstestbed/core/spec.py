"""@spec and OneOf: what a block of a scenario may become.

A spec is a frozen keyword-only dataclass whose constructor checks itself; the same class is the YAML block,
the object that runs, and the JSON Schema. Pydantic does the checking; this file gives it the house's manners.

    @spec
    class Disc:
        kind: Literal["disc"] = "disc"
        radius: Annotated[float, Gt(0)]

    MARKERS = OneOf("marker", Disc, Sphere)      # in YAML: {kind: disc, radius: 0.02}, or the bare word where all has defaults
    marker: Annotated[Marker, MARKERS]
"""

from __future__ import annotations

import dataclasses
import importlib.metadata
from collections.abc import Mapping
from typing import Any, TypeVar, dataclass_transform

import pydantic
from pydantic import ConfigDict, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic.dataclasses import dataclass as _pydantic_dataclass
from pydantic.dataclasses import rebuild_dataclass
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from vstestbed.core.contract import Contract
from vstestbed.core.errors import ParameterError

T = TypeVar("T")
_CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True, strict=False)
_SPECS: list[type] = []


@dataclass_transform(kw_only_default=True, frozen_default=True)
def spec(cls: type[T]) -> type[T]:
    """Make `cls` a frozen keyword-only dataclass whose constructor refuses unknown, mistyped and out-of-range values.

    Raises (from the constructor): ParameterError that names the field, what it must be and what was given.
    """
    made: Any = _pydantic_dataclass(cls, frozen=True, kw_only=True, config=_CONFIG)
    _with_our_errors(made)
    _SPECS.append(made)
    return made


def _with_our_errors(cls: Any) -> None:
    """Let pydantic's constructor of a spec class raise ParameterError."""
    checked_init = cls.__init__

    def init(self: Any, **values: Any) -> None:
        try:
            checked_init(self, **values)
        except pydantic.ValidationError as error:
            first = error.errors()[0]
            inner = first.get("ctx", {}).get("error")
            if isinstance(inner, ParameterError):
                raise inner from None
            field = ".".join(str(part) for part in first["loc"]) or cls.__name__
            raise ParameterError(field, first["msg"], first["input"]) from None

    cls.__init__ = init


def rebuild_specs() -> None:
    """Build every spec's validator anew, in the order of definition: needed once after a `OneOf` has grown."""
    for cls in _SPECS:
        rebuild_dataclass(cls, force=True)
        _with_our_errors(cls)  # pydantic has put its own constructor back


class OneOf:
    """The list of kinds that a block may be, told apart by its `kind`; the one place that names a room's members.

    Args:
        what: the word of the field ("law"); plugins are found under the entry-point group `vstestbed.<what>s`.
        members: the spec classes; each has `kind: Literal["..."] = "..."`.
        number: (kind, field) that a bare number stands for, where one does.
        default: the kind of a block that names none, where there is one.
        fields: kinds that a block which names none is, where it has the field.
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
        self.what, self.number, self.default, self.fields = what, number, default, dict(fields or {})
        self.contract = contract
        self.members: dict[str, type] = {}
        for member in members:
            self.add(member)

    def add(self, member: type[T]) -> type[T]:
        """Register one more kind (usable as a decorator by a plugin).

        Raises:
            ParameterError: the class is no spec, its word is taken, or it breaks the contract of the room.
        """
        # By identity: a subclass of a spec is a dataclass, too, but without @spec its own fields would be ignored.
        if not any(member is known for known in _SPECS):
            name = getattr(member, "__name__", repr(member))
            raise ParameterError(name, f"is not a spec; a {self.what} is a class with @spec directly above it, below any `add`")
        kind = kind_of(member)
        if kind in self.members and self.members[kind] is not member:
            taken = f"{kind!r} is already a {self.what} ({self.members[kind].__module__})"
            raise ParameterError("kind", f"{taken}; give {member.__name__} a `kind` of its own")
        if self.contract is not None:
            self.contract.check(member)
        self.members[kind] = member
        return member

    def load_entry_points(self) -> bool:
        """Add what installed packages offer under `vstestbed.<what>s`; True when something new came."""
        before = len(self.members)
        for entry in importlib.metadata.entry_points(group=f"vstestbed.{self.what}s"):
            self.add(entry.load())
        return len(self.members) > before

    def _block(self, value: Any) -> Any:
        """A value as a block with a valid kind: bare words and numbers become blocks, anything else is refused."""
        if isinstance(value, tuple(self.members.values())):
            return value
        if isinstance(value, str):
            value = {"kind": value}
        elif self.number and isinstance(value, int | float) and not isinstance(value, bool):
            value = {"kind": self.number[0], self.number[1]: value}
        words = ", ".join(sorted(self.members))
        if not isinstance(value, dict):
            raise PydanticCustomError("block", "must be a {what} block or one of the words: {words}", {"what": self.what, "words": words})
        told = next((kind for field, kind in self.fields.items() if field in value), self.default)
        kind = value.get("kind", told)
        if kind is None:
            raise PydanticCustomError("no_kind", "needs {words}", {"words": self._needs})
        if not isinstance(kind, str) or kind not in self.members:
            raise PydanticCustomError("unknown_kind", "is no {what}; {hint}", {"what": self.what, "hint": f"valid kinds: {words}"})
        return {**value, "kind": kind}

    @property
    def _needs(self) -> str:
        words = f"a kind; valid kinds: {', '.join(sorted(self.members))}"
        return f"one of the fields {', '.join(self.fields)}, or {words}" if self.fields else words

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Pydantic's hook: a union told apart by `kind`, a bare word standing for the block of that kind."""
        choices: dict[Any, CoreSchema] = {k: handler.generate_schema(m) for k, m in self.members.items()}
        union = core_schema.tagged_union_schema(choices, lambda v: v["kind"] if isinstance(v, dict) else v.kind)
        return core_schema.no_info_before_validator_function(self._block, union)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Pydantic's hook for editors: a block of one of the kinds, or what stands for one (a bare word, a number)."""
        blocks = handler(schema)["oneOf"]
        needs = {} if self.default or self.fields else {"required": ["kind"]}
        choices: list[dict[str, Any]] = [block | needs for block in blocks]
        words = sorted(kind for kind, member in self.members.items() if not _needed_fields(member))
        if words:
            choices.append({"enum": words})
        if self.number:
            choices.append({"type": "number"})
        return {"anyOf": choices}


def _needed_fields(cls: type) -> list[str]:
    missing = dataclasses.MISSING
    fields = dataclasses.fields(cls)
    return [f.name for f in fields if f.init and f.default is missing and f.default_factory is missing]


def kind_of(cls: type) -> str:
    """The word that a spec class has as its `kind`."""
    for field in dataclasses.fields(cls):
        if field.name == "kind" and isinstance(field.default, str):
            return field.default
    raise ParameterError("kind", f"is missing: {cls.__name__} needs `kind: Literal['...'] = '...'`")


def to_mapping(value: Any) -> Any:
    """A spec as plain mappings, lists and scalars, every default written out: what `scenario.yaml` holds."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = sorted((f.name for f in dataclasses.fields(value) if f.init), key=lambda name: name != "kind")
        return {name: to_mapping(getattr(value, name)) for name in names}
    if isinstance(value, tuple | list):
        return [to_mapping(v) for v in value]
    if isinstance(value, dict):
        return {name: to_mapping(v) for name, v in value.items()}
    return value
