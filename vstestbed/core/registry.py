"""What is registered: the spec classes, and the registries with the kinds of each block; and spec
objects as plain values.

MARKERS = Registry("marker", Disc, Sphere)
    # in YAML: {kind: disc, radius: 0.02}, or the bare word where all has defaults
marker: Annotated[Marker, MARKERS]
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import inspect
import sys
import typing
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

import pydantic
from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from vstestbed.core.errors import ParameterError, nearest

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints

__all__ = [
    "REGISTRIES",
    "SPECS",
    "Contract",
    "Registry",
    "brief_mapping",
    "kind_of",
    "registries_of",
    "to_mapping",
    "undone_on_error",
    "validator_of",
    "whole_adapter",
]

T = TypeVar("T")
SPECS: list[type] = []  # Every spec in the order of definition
REGISTRIES: list[Registry] = []


class Registry:
    """The kinds of one block of a scenario: a tagged union by `kind`, which plugins extend.

    Args:
        what: the name of the field ("law"); plugins are found under the entry-point group
            `vstestbed.<what>s`.
        members: the spec classes; each has `kind: Literal["..."] = "..."`.
        number: (kind, field) for which a bare number is a shorthand; None where numbers are
            refused.
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
        self.what = what
        self.number = number
        self.default = default
        self.fields = dict(fields or {})
        self.contract = contract
        self._members: dict[str, type] = {}
        self._left_out: str | None = None
        REGISTRIES.append(self)
        for member in members:
            self.add(member)

    @property
    def members(self) -> dict[str, type]:
        """The spec class of each kind."""
        if self._left_out is None:
            return self._members
        return {kind: member for kind, member in self._members.items() if kind != self._left_out}

    def without(self, kind: str) -> Registry:
        """The same registry for a field in the block of one of its kinds, which may not hold
        another of that kind.
        """
        other = copy.copy(self)  # with the same members, also those that are added later
        other._left_out = kind
        return other

    @property
    def base(self) -> type | None:
        """The spec class from which all kinds come, and which is none of them; None where there is
        none.
        """
        kinds = self.members.values()
        for cls in SPECS:
            if kinds and cls not in kinds and all(issubclass(kind, cls) for kind in kinds):
                return cls
        return None

    def implied(self, block: Mapping[str, Any]) -> str | None:
        """The kind of a block without `kind`, by one of its fields; None where none tells it."""
        return next((kind for field, kind in self.fields.items() if field in block), None)

    def expanded(self, value: Any) -> Any:
        """A word, a number or a block as a block with its `kind`, None where it has none; any other
        value as it is.
        """
        if isinstance(value, str):
            return {"kind": value}
        # Python's bool is an int: without the exception `gain: true` would be a gain of 1.
        if self.number and isinstance(value, int | float) and not isinstance(value, bool):
            return {"kind": self.number[0], self.number[1]: value}
        if isinstance(value, dict):
            return {**value, "kind": value.get("kind", self.implied(value) or self.default)}
        return value

    def add(self, member: type[T]) -> type[T]:
        """Register one more kind (usable as a decorator by a plugin).
        Raises ParameterError: the class is no spec, its word is taken, or it breaks the contract of
        the registry.
        """
        self._check(member)
        self.members[kind_of(member)] = member
        return member

    def _check(self, member: type) -> None:
        # By identity: a subclass of a spec is a dataclass, too, but without @spec its own fields
        # would be ignored.
        if not any(member is known for known in SPECS):
            name = getattr(member, "__name__", repr(member))
            words = (
                f"is not a spec; a {self.what} is a class"
                " with @spec directly above it, below any `add`"
            )
            raise ParameterError(name, words)
        kind = kind_of(member)
        known = self.members.get(kind, member)
        home = known.__module__
        # a notebook's cell that is run once more after a change defines its class again
        again = (
            home == member.__module__ == "__main__" and known.__qualname__ == member.__qualname__
        )
        if known is not member and not again:
            place = home
            if not home.startswith("vstestbed."):
                place = getattr(sys.modules.get(home), "__file__", home)
            taken = f"{kind!r} is already a {self.what} ({place})"
            raise ParameterError("kind", f"{taken}; give {member.__name__} a `kind` of its own")
        # of those a test checks it once for all starts
        if self.contract is not None and not member.__module__.startswith("vstestbed."):
            self.contract.check(member)

    def load_entry_points(self, installed: EntryPoints) -> bool:
        """Register the classes that installed packages offer under `vstestbed.<what>s`; True if any
        was new.
        """
        before = len(self.members)
        for entry in installed.select(group=f"vstestbed.{self.what}s"):
            self.add(entry.load())
        return len(self.members) > before

    def _made(self, value: Any) -> Any:
        """A value as an object of the class of its kind; objects that are members already pass
        unchanged.
        """
        if isinstance(value, tuple(self.members.values())):
            return value
        if not self.members:
            words = (
                f"must not be given: there is no kind of {self.what};"
                " a plugin may add one (`--plugin FILE.py`)"
            )
            raise PydanticCustomError("block", "{words}", {"words": words})
        block = self.expanded(value)
        kinds = ", ".join(sorted(self.members))
        if not isinstance(block, dict):
            words = f"must be a {self.what} block or one of the words: {kinds}"
            raise PydanticCustomError("block", "{words}", {"words": words})
        kind = block["kind"]
        if kind is None:
            needs = "needs a kind"
            if self.fields:
                needs = f"needs one of the fields {', '.join(self.fields)}, or a kind"
            words = f"{needs}; valid kinds: {kinds}"
            raise PydanticCustomError("no_kind", "{words}", {"words": words})
        if not isinstance(kind, str) or kind not in self.members:
            words = f"is no {self.what}; valid kinds: {kinds}"
            raise PydanticCustomError("unknown_kind", "{words}", {"words": words})
        return validator_of(self.members[kind]).validate_python(block)

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> CoreSchema:
        if not (_WHOLE and self.members):
            return core_schema.no_info_plain_validator_function(self._made)
        choices: dict[Any, CoreSchema] = {
            k: handler.generate_schema(m) for k, m in self.members.items()
        }
        return core_schema.tagged_union_schema(choices, "kind")

    def __get_pydantic_json_schema__(
        self, schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        if not self.members:
            return {"not": {}}
        blocks = handler(schema)["oneOf"]
        # In the classes `kind` has a default and would be optional: without it, a block that needs
        # a kind would pass the schema.
        needs = {} if self.default or self.fields else {"required": ["kind"]}
        choices: list[dict[str, Any]] = [block | needs for block in blocks]
        # A bare word is a block of defaults only, so it needs a kind without required fields.
        words = []
        for kind, member in self.members.items():
            if not any(map(is_needed, dataclasses.fields(member))):
                words.append(kind)
        if words:
            choices.append({"enum": sorted(words)})
        if self.number:
            kind, field = self.number
            hint = typing.get_type_hints(self.members[kind], include_extras=True)[field]
            choices.append(pydantic.TypeAdapter(hint).json_schema())
        return {"anyOf": choices}


def registries_of(cls: type) -> list[Registry]:
    """The registries that a spec class is a member of."""
    return [registry for registry in REGISTRIES if cls in registry.members.values()]


def kind_of(cls: type) -> str:
    """The `kind` of a spec class, the word for it in YAML; ParameterError where it has none."""
    for own in dataclasses.fields(cls):
        if own.name == "kind" and isinstance(own.default, str):
            return own.default
    raise ParameterError.missing("kind", f"{cls.__name__} needs `kind: Literal['...'] = '...'`")


@functools.cache
def validator_of(cls: type) -> Any:
    """Pydantic's validator of a spec class, built when it is first used. The kinds in a registry
    are looked up when a block is validated, so that a validator stays valid when a plugin adds one.
    """
    return pydantic.TypeAdapter(cls).validator


_WHOLE: list[bool] = []  # not empty while a schema is built with the blocks of all kinds in it


def whole_adapter(hint: Any) -> pydantic.TypeAdapter[Any]:
    """Pydantic's adapter of a type with the blocks of all kinds in it, from which it makes a JSON
    Schema.
    """
    _WHOLE.append(True)
    try:
        return pydantic.TypeAdapter(hint)
    finally:
        _WHOLE.pop()


@contextmanager
def undone_on_error() -> Iterator[None]:
    """Take back what was defined and registered within where an error ends it: a plugin is there as
    a whole, or not at all.
    """
    specs = len(SPECS)
    members = [(registry, dict(registry.members)) for registry in REGISTRIES]
    try:
        yield
    except BaseException:
        del SPECS[specs:]
        for registry, before in members:
            registry.members.clear()
            registry.members.update(before)
        raise


def to_mapping(value: Any) -> Any:
    """A spec as plain mappings, lists and scalars with all defaults written out: the content of
    `resolved.yaml`.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclasses.fields(value) if field.init]
        # `kind` first, as people write it; the sort is stable and keeps the order of the others.
        names.sort(key=lambda name: name != "kind")
        return {name: to_mapping(getattr(value, name)) for name in names}
    if isinstance(value, tuple | list):
        return [to_mapping(v) for v in value]
    if isinstance(value, dict):
        return {name: to_mapping(v) for name, v in value.items()}
    return value


def brief_mapping(value: Any) -> Any:
    """A spec as people write it: without defaults and what `preset_values` stand for, whole numbers
    without `.0`, with shorthands.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return _brief_block(value)
    if isinstance(value, tuple | list):
        return [brief_mapping(v) for v in value]
    if isinstance(value, dict):
        return {name: brief_mapping(v) for name, v in value.items()}
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e6:
        return int(value)
    return value


def _brief_block(value: Any) -> Any:
    preset = getattr(value, "preset_values", {})
    block = {}
    for name in _kept_fields(value, preset):
        block[name] = _brief_part(getattr(value, name), preset.get(name))
    kind = getattr(value, "kind", None)
    return block if kind is None else _with_kind(kind, block, registries_of(type(value)))


def _brief_part(value: Any, preset: Any) -> Any:
    """A field's value; of a block that a preset fills, the fields alone in which it differs from
    the preset's.
    """
    if not dataclasses.is_dataclass(value) or type(value) is not type(preset):
        return brief_mapping(value)
    different = {}
    for f in dataclasses.fields(value):
        if f.init and getattr(value, f.name) != getattr(preset, f.name):
            different[f.name] = brief_mapping(getattr(value, f.name))
    return different


def _kept_fields(value: Any, preset: Mapping[str, Any]) -> list[str]:
    """The fields that are not at their default, or at what a preset of the block fills in its
    place. Of a block without a kind, which needs something in it, the first one at least.
    """
    fields = [f for f in dataclasses.fields(value) if f.init and f.name != "kind"]
    # What makes it this kind comes before what all kinds have, as people write it: a square's side
    # before its pose.
    own = sorted(fields, key=lambda f: f.name not in type(value).__annotations__)
    kept = [f.name for f in own if getattr(value, f.name) != preset.get(f.name, default_of(f))]
    if not kept and not hasattr(value, "kind"):
        kept = [f.name for f in own[:1]]
    return kept


def _with_kind(kind: str, block: dict[str, Any], registries: list[Registry]) -> Any:
    if registries and all(registry.implied(block) == kind for registry in registries):
        return block
    for registry in registries:
        if registry.number and (kind, [*block]) == (registry.number[0], [registry.number[1]]):
            return block[registry.number[1]]
    return {"kind": kind, **block} if block or not registries else kind


def is_needed(field: dataclasses.Field[Any]) -> bool:
    """Whether a field of a constructor has no default."""
    return field.init and field.default is field.default_factory is dataclasses.MISSING


def default_of(field: dataclasses.Field[Any]) -> Any:
    """The default of a field, also one that a function makes."""
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return field.default


# A plugin that lacks a method would otherwise run until the loop first calls that method, and end
# with a traceback there.
@dataclass(frozen=True)
class Contract:
    """What a class must have to be a member of a registry: the public methods and attributes of
    `protocol`, which may have defaults. base: a class with defaults for most of them, or None.
    words: the valid items of attributes that are tuples of words, by name.
    """

    protocol: type
    base: type | None = None
    words: Mapping[str, Collection[str]] = field(default_factory=dict)

    def check(self, member: type) -> None:
        """Refuse a class that breaks the contract. member: a dataclass; its fields count as
        attributes.
        """
        required = _public_members(self.protocol)
        missing = [name for name in required if not self._has(member, name)]
        if missing:
            names = ", ".join(_shown(name, required[name]) for name in missing)
            raise ParameterError(member.__name__, f"lacks {names}; {self._remedy(member)}")
        for name, method in required.items():
            _check_shape(member, name, method)
        for name, valid in self.words.items():
            _check_words(member, name, valid)

    def _has(self, member: type, name: str) -> bool:
        """Whether a class has a member that is no stub: neither abstract, nor inherited from a
        `typing.Protocol`.
        """
        own = inspect.getattr_static(member, name, None)
        if own is None:
            return hasattr(member, name) or name in getattr(member, "__dataclass_fields__", {})
        stub = own is vars(self.protocol).get(name)
        if stub and getattr(self.protocol, "_is_protocol", False):
            return False
        function = getattr(own, "func", own)  # of a cached property
        return not getattr(function, "__isabstractmethod__", False)

    def _remedy(self, member: type) -> str:
        if self.base is None or issubclass(member, self.base):
            return f"add what is missing (see {self.protocol.__module__}.{self.protocol.__name__})"
        rest = [name for name in _public_members(self.protocol) if not self._has(self.base, name)]
        return (
            f"derive it from {self.base.__module__}.{self.base.__name__},"
            f" which has defaults for all but {' and '.join(rest)}"
        )


def _public_members(protocol: type) -> dict[str, Callable[..., Any] | None]:
    found: dict[str, Callable[..., Any] | None] = {}
    for cls in reversed(protocol.__mro__):
        found |= dict.fromkeys(inspect.get_annotations(cls))
        for name, value in vars(cls).items():
            found[name] = value if inspect.isfunction(value) else None
    return {name: method for name, method in found.items() if not name.startswith("_")}


def _shown(name: str, method: Callable[..., Any] | None) -> str:
    if method is None:
        return name
    _, *parameters = inspect.signature(method).parameters
    return f"{name}({', '.join(parameters)})"


def _check_shape(member: type, name: str, method: Callable[..., Any] | None) -> None:
    """Refuse a method where an attribute belongs, an attribute where a method belongs, and a wrong
    number of parameters.
    """
    own = inspect.getattr_static(member, name, None)
    where = f"{member.__name__}.{name}"
    if method is None:
        if inspect.isfunction(own):
            words = "must be an attribute, and is a method; write @property above it"
            raise ParameterError(where, words)
        return
    wanted = _shown(name, method)
    if not callable(getattr(member, name, None)):
        raise ParameterError(where, f"must be a method {wanted}")
    arguments = list(inspect.signature(method).parameters)
    # Read off the class, a plain function still has its `self`; a static or class method does not.
    if not inspect.isfunction(own):
        del arguments[0]
    signature = inspect.signature(getattr(member, name))
    try:
        signature.bind(*arguments)
    except TypeError:
        words = f"must take the arguments of {wanted}; it has the signature {signature}"
        raise ParameterError(where, words) from None


def _check_words(member: type, name: str, valid: Collection[str]) -> None:
    """Refuse an unknown word in a tuple of words. A property is read from an object made of the
    defaults alone; of a class that has none such, its words stay unchecked.
    """
    words = getattr(member, name, ())
    if isinstance(words, property):
        try:
            words = getattr(member(), name)
        except (TypeError, ParameterError):
            # a field without a default, or defaults that need another value beside them
            return
    where = f"{member.__name__}.{name}"
    if not isinstance(words, tuple):
        problem = "must be a tuple of words, such as ('xy', 'depth')"
        raise ParameterError(where, problem, words)
    for word in words:
        if word not in valid:
            hint = nearest(str(word), valid)
            raise ParameterError.unknown(f"{where}: {word!r}", "valid word", hint)
