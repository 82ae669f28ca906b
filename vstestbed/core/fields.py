"""The schema tree: what each field of a spec class may hold, read once from its type. Every reader of the schema walks it: error messages,
`describe`, the JSON Schema's units, examples, the controls of the live view.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import typing
from collections.abc import Iterator
from dataclasses import MISSING, dataclass
from types import UnionType
from typing import Any, Literal

from annotated_types import Ge, Gt, Le, Len, Lt

from vstestbed.core.quantity import Narrower, Within
from vstestbed.core.registry import Registry, to_mapping


@dataclass(frozen=True)
class Node:
    """What a field, an item of its list, or one of its alternatives may hold.

    Attributes:
        type: float, int, bool, str, a spec class; tuple for a list, dict for a mapping by name; Literal for words; Union for alternatives.
        bounds: what `Annotated` says of it.
        parts: the items of a list or the values of a mapping (one node), or the alternatives.
        words: the words between which there is the choice.
        registry: the list of kinds of which it is one; None else.
    """

    type: Any
    bounds: tuple[Any, ...] = ()
    parts: tuple[Node, ...] = ()
    words: tuple[Any, ...] = ()
    registry: Registry | None = None

    @property
    def number(self) -> bool:
        """Whether it is a number, or a choice between numbers."""
        return self.type in (int, float) or any(isinstance(word, int | float) and not isinstance(word, bool) for word in self.words)

    @property
    def length(self) -> int | None:
        """The only valid length of a list; None where there are several."""
        lengths = [(bound.min_length, bound.max_length) for bound in self.bounds if isinstance(bound, Len)]
        return next((least for least, most in lengths if least == most), None)

    @property
    def within(self) -> Within | None:
        """The quantity that a number is, with its bounds and its unit."""
        return next((bound for bound in self.bounds if isinstance(bound, Within)), None)

    @property
    def limits(self) -> tuple[float, float]:
        """The smallest and the largest value of a number."""
        lows, highs = [float("-inf")], [float("inf")]
        for bound in self.bounds:
            if isinstance(bound, Within):
                lows, highs = [*lows, bound.low], [*highs, bound.high]
            elif isinstance(bound, Narrower | Ge | Gt | Le | Lt):
                lows += [float(getattr(bound, name)) for name in ("gt", "ge") if getattr(bound, name, None) is not None]
                highs += [float(getattr(bound, name)) for name in ("lt", "le") if getattr(bound, name, None) is not None]
        return max(lows), min(highs)

    def leaves(self) -> Iterator[Node]:
        """The nodes without parts in it."""
        if not self.parts:
            yield self
        for part in self.parts:
            yield from part.leaves()

    def block_of(self, value: Any) -> tuple[type, Registry | None] | None:
        """The spec class of the block that a plain value is, by its kind, and the registry of it; None for a value that is no block."""
        for leaf in self.leaves():
            if leaf.registry is not None:
                block = leaf.registry.expanded(value)
                kind = block["kind"] if isinstance(block, dict) else None
                if isinstance(kind, str) and kind in leaf.registry.members:
                    return leaf.registry.members[kind], leaf.registry
            elif isinstance(leaf.type, type) and dataclasses.is_dataclass(leaf.type) and (isinstance(value, dict) or leaf.bounds):
                return leaf.type, None
        return None

    def blocks(self) -> Iterator[tuple[Registry | None, type]]:
        """The spec classes that it may hold, each with the registry in which it is a kind; None where it is the only one."""
        for leaf in self.leaves():
            if leaf.registry is not None:
                yield from ((leaf.registry, member) for member in leaf.registry.members.values())
            elif isinstance(leaf.type, type) and dataclasses.is_dataclass(leaf.type):
                yield None, leaf.type


def _node(hint: Any, bounds: tuple[Any, ...] = ()) -> Node:
    if hasattr(hint, "__metadata__"):
        bounds = (*bounds, *hint.__metadata__)
        registry = next((bound for bound in bounds if isinstance(bound, Registry)), None)
        return _node(hint.__origin__, bounds) if registry is None else Node(hint.__origin__, bounds, registry=registry)
    origin, inner = typing.get_origin(hint), [part for part in typing.get_args(hint) if part is not type(None)]
    if origin is Literal:
        return Node(Literal, bounds, words=typing.get_args(hint))
    if origin in (typing.Union, UnionType):
        return _node(inner[0], bounds) if len(inner) == 1 else Node(typing.Union, parts=tuple(_node(part, bounds) for part in inner))
    if origin in (tuple, dict):  # a mapping by name: the values
        return Node(origin, bounds, parts=(_node(inner[-1] if origin is dict else inner[0]),))
    return Node(hint, bounds)


@dataclass(frozen=True)
class SchemaField:
    """A field of a spec class. node: what it may hold. default: as plain values; None where it has none. needed: it has none."""

    name: str
    node: Node
    default: Any
    needed: bool


# of a class itself: `typing.get_type_hints` would read those of a base anew for each class
_annotations = functools.cache(inspect.get_annotations)


@functools.cache
def fields(cls: type) -> dict[str, SchemaField]:
    """The fields of a spec class that its constructor takes, by name."""
    own = {field.name: field for field in dataclasses.fields(cls) if field.init}
    # of a class in a function, `spec` has read the types already
    bases = reversed(cls.__mro__) if any(isinstance(f.type, str) for f in own.values()) else ()
    types = {name: hint for base in bases for name, hint in _annotations(base, eval_str=True).items()}
    return {name: SchemaField(name, _node(types.get(name, field.type)), *_default(field)) for name, field in own.items()}


def needed(cls: type) -> list[str]:
    """The fields of a spec class that have no default."""
    return [name for name, field in fields(cls).items() if field.needed]


def _default(field: dataclasses.Field[Any]) -> tuple[Any, bool]:
    if field.default_factory is not MISSING:
        return to_mapping(field.default_factory()), False
    return (None, True) if field.default is MISSING else (to_mapping(field.default), False)
