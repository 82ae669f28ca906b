"""The schema tree: what each field of a spec class may hold, read once from its type, and what the
docstring of its class says of it.

Every reader of the schema walks it: error messages, `describe`, the JSON Schema, examples, the
controls of the live view. The docstrings are the one source of the descriptions. A field's line is
`name: words [unit]; e.g. `example`.`, where the example is needed of a field that has no default
and that no bundled file sets. One line may serve several fields,
`width, height: picture size [px].`, with a unit each, `a_m, b_deg: ... [m, deg].`
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import re
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from types import UnionType
from typing import Any, Literal

from annotated_types import Ge, Gt, Le, Len, Lt

from vstestbed.core.quantity import Bounded, TighterBounds
from vstestbed.core.registry import Registry, default_of, is_needed, to_mapping

__all__ = ["DIMENSIONLESS", "Node", "SchemaField", "class_text", "fields", "needed", "without_unit"]


@dataclass(frozen=True)
class Node:
    """What a field, an item of its list, or one of its alternatives may hold.

    Attributes:
        type: float, int, bool, str, a spec class; tuple for a list, dict for a mapping by name;
            Literal for words; Union for alternatives.
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
        return self.type in (int, float) or any(
            isinstance(word, int | float) and not isinstance(word, bool) for word in self.words
        )

    @property
    def is_block(self) -> bool:
        """Whether it is a block of one spec class."""
        return isinstance(self.type, type) and dataclasses.is_dataclass(self.type)

    @property
    def length(self) -> int | None:
        """The only valid length of a list; None where there are several."""
        for bound in self.bounds:
            if isinstance(bound, Len) and bound.min_length == bound.max_length:
                return bound.min_length
        return None

    @property
    def takes_number(self) -> bool:
        """Whether it is a number, or a block for which a number may stand."""
        return self.number or (self.registry is not None and self.registry.number is not None)

    @property
    def within(self) -> Bounded | None:
        """The quantity that a number is, with its bounds and its unit."""
        return next((bound for bound in self.bounds if isinstance(bound, Bounded)), None)

    @property
    def limits(self) -> tuple[float, float]:
        """The smallest and the largest value of a number."""
        lows = [float("-inf")]
        highs = [float("inf")]
        for bound in self.bounds:
            if isinstance(bound, Bounded):
                lows.append(bound.low)
                highs.append(bound.high)
            elif isinstance(bound, TighterBounds | Ge | Gt | Le | Lt):
                lows += _numbers(bound, "gt", "ge")
                highs += _numbers(bound, "lt", "le")
        return max(lows), min(highs)

    def leaves(self) -> Iterator[Node]:
        """The nodes without parts in it."""
        if not self.parts:
            yield self
        for part in self.parts:
            yield from part.leaves()

    def block_of(self, value: Any) -> tuple[type, Registry | None] | None:
        """The spec class of the block that a plain value is, by its kind, and the registry of it;
        None for a value that is no block.
        """
        for leaf in self.leaves():
            if leaf.registry is not None:
                block = leaf.registry.expanded(value)
                kind = block["kind"] if isinstance(block, dict) else None
                if isinstance(kind, str) and kind in leaf.registry.members:
                    return leaf.registry.members[kind], leaf.registry
            elif leaf.is_block and (isinstance(value, dict) or leaf.bounds):
                return leaf.type, None
        return None

    def blocks(self) -> Iterator[tuple[Registry | None, type]]:
        """The spec classes that it may hold, each with the registry in which it is a kind; None
        where it is the only one.
        """
        for leaf in self.leaves():
            if leaf.registry is not None:
                yield from ((leaf.registry, member) for member in leaf.registry.members.values())
            elif leaf.is_block:
                yield None, leaf.type


def _numbers(bound: object, *names: str) -> list[float]:
    values = (getattr(bound, name, None) for name in names)
    return [float(value) for value in values if value is not None]


def _node(hint: Any, bounds: tuple[Any, ...] = ()) -> Node:
    if hasattr(hint, "__metadata__"):
        return _annotated(hint.__origin__, (*bounds, *hint.__metadata__))
    origin = typing.get_origin(hint)
    arguments = typing.get_args(hint)
    if origin is Literal:
        return Node(Literal, bounds, words=arguments)
    if origin in (typing.Union, UnionType):
        parts = tuple(_node(part, bounds) for part in arguments if part is not type(None))
        if len(parts) == 1:
            return parts[0]
        return Node(typing.Union, parts=parts)
    if origin is tuple:
        return Node(tuple, bounds, parts=(_node(arguments[0]),))
    if origin is dict:  # a mapping by name: the values
        return Node(dict, bounds, parts=(_node(arguments[1]),))
    return Node(hint, bounds)


def _annotated(hint: Any, bounds: tuple[Any, ...]) -> Node:
    for bound in bounds:
        if isinstance(bound, Registry):
            return Node(hint, bounds, registry=bound)
    return _node(hint, bounds)


@dataclass(frozen=True)
class SchemaField:
    """A field of a spec class. node: what it may hold. default: as plain values; None where it has
    none. needed: it has none.
    """

    name: str
    node: Node
    default: Any
    needed: bool


# of a class itself: `typing.get_type_hints` would read those of a base anew for each class
_annotations = functools.cache(inspect.get_annotations)


@functools.cache
def fields(cls: type) -> dict[str, SchemaField]:
    """The fields of a spec class that its constructor takes, by name."""
    own = [field for field in dataclasses.fields(cls) if field.init]
    types: dict[str, Any] = {}
    # of a class in a function, `spec` has read the types already
    if any(isinstance(field.type, str) for field in own):
        for base in reversed(cls.__mro__):
            types |= _annotations(base, eval_str=True)
    found = {}
    for field in own:
        lacks = is_needed(field)
        default = None if lacks else to_mapping(default_of(field))
        node = _node(types.get(field.name, field.type))
        found[field.name] = SchemaField(field.name, node, default, lacks)
    return found


def needed(cls: type) -> list[str]:
    """The fields of a spec class that have no default."""
    return [name for name, field in fields(cls).items() if field.needed]


DIMENSIONLESS = "1"
_UNIT = re.compile(r" \[([^\[\]]{1,40})\]")
_SYMBOL = (
    r"(?:1|rad|deg|[mun]?m|[mu]?s|h|[kMG]?Hz|px|k?g|[mk]?N|[mk]?Nm|[mk]?W|m?V|m?A|K|degC|[kM]?J|[kM]?Pa|T|H|F|C|ohm|lx|dB|%"
    r"|e-|DN|k?bit|grey levels)(?:\^[234])?"
)
_IS_UNIT = re.compile(rf"{_SYMBOL}(?:[ /]{_SYMBOL})*(?: per [a-z_ ]+)?|unit (?:of|as in) .+")
_EXAMPLE = re.compile(r"; e\.g\. `([^`]+)`(?=\.$)")
_SOURCE = re.compile(r"References?: ")
# a field, or several: `width, height: picture size [px].`
_ITEM = re.compile(r" {4}(\S[^:]*): (.*)")


@dataclass(frozen=True)
class FieldText:
    """What is known of a field in words; "" what is not. unit: "1" for a pure number. example: YAML
    of a value.
    """

    description: str
    unit: str
    example: str = ""


@dataclass(frozen=True)
class ClassText:
    """A docstring in parts. summary: its first paragraph, on one line. text: what follows up to the
    fields. sources: one a line.
    """

    summary: str
    text: str
    sources: tuple[str, ...]
    fields: dict[str, FieldText]


@functools.cache
def class_text(cls: type) -> ClassText:
    """The docstring of a dataclass in parts; inherited fields have the text of the class that
    brings them.
    """
    paragraphs = [text.strip("\n") for text in _sections(cls)[0].split("\n\n") if text.strip()]
    summary = " ".join("".join(paragraphs[:1]).split())
    sources = []
    rest = []
    for text in paragraphs[1:]:
        if _SOURCE.match(text):
            sources.append(" ".join(_SOURCE.sub("", text).split()))
        elif not text.startswith("Raises ("):
            rest.append(text)
    return ClassText(summary, "\n\n".join(rest), tuple(sources), _field_texts(cls))


def _field_texts(cls: type) -> dict[str, FieldText]:
    words: dict[str, FieldText] = {}
    for base in reversed(cls.__mro__):
        for names, text in _sections(base)[1]:
            words |= _texts_of(names, text)
    texts = {}
    for name, field in fields(cls).items():
        text = words.get(name, FieldText("", ""))
        texts[name] = dataclasses.replace(text, unit=_unit_of(field.node, text))
    return texts


def _texts_of(names: str, words: str) -> dict[str, FieldText]:
    """The texts of the fields that share a line: with a unit for each of them, or one for all."""
    example = _EXAMPLE.search(words)
    sentence = _EXAMPLE.sub("", words)
    each = names.split(",")
    units = unit_in(sentence).split(", ")
    if len(units) != len(each):
        units = (units if len(units) == 1 else [""]) * len(each)
    return {
        name.strip(): FieldText(sentence, unit, example[1] if example else "")
        for name, unit in zip(each, units, strict=True)
    }


@functools.cache
def _sections(cls: type) -> tuple[str, tuple[tuple[str, str], ...]]:
    """The text of a class's own docstring without its lists of fields, and the names and words of
    the list `Args:`.
    """
    own = cls.__dict__.get("__doc__")
    # dataclasses write a signature where there is none
    if not own or cls is object or own.startswith(f"{cls.__name__}("):
        return "", ()
    lists: dict[str, list[str]] = {"Args:": [], "Attributes:": []}
    here = text = list[str]()
    for line in inspect.cleandoc(own).splitlines():
        if line in lists:
            here = lists[line]
        elif line and not line.startswith(" "):
            here = text
        here.append(line)
    return "\n".join(text), _items(lists["Args:"])


def _items(lines: list[str]) -> tuple[tuple[str, str], ...]:
    items: list[list[str]] = []
    for line in lines:
        if item := _ITEM.fullmatch(line):
            items.append([item[1], item[2]])
        elif items:  # the next line of a field
            items[-1][1] += f" {line.strip()}"
    return tuple((names, words.strip()) for names, words in items)


def unit_in(words: str) -> str:
    """The unit in brackets of a field's sentence, the last one where there are several; "" where
    there is none.
    """
    for text in reversed(_UNIT.findall(words)):
        unit = text.partition(";")[0]
        if all(map(_IS_UNIT.fullmatch, unit.split(", "))):
            return unit
    return ""


def without_unit(words: str) -> str:
    """A field's sentence without the unit in it, for a table that has a column for it."""
    return words.replace(f" [{unit_in(words)}]", "")


def _unit_of(node: Node, text: FieldText) -> str:
    """The unit of a field: as written, which can be the finer (px^2 in a type of px), else of its
    type.
    """
    numbers = [leaf for leaf in node.leaves() if leaf.takes_number]
    if not numbers:
        return ""
    typed = [leaf.within.unit for leaf in numbers if leaf.within is not None]
    # A whole number counts something, unless its sentence has a unit.
    counts = all(leaf.type is int or leaf.words for leaf in numbers)
    units = [text.unit, *typed, DIMENSIONLESS if counts else ""]
    return next(filter(None, units), "")
