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
from dataclasses import MISSING, dataclass
from types import UnionType
from typing import Any, Literal

from annotated_types import Ge, Gt, Le, Len, Lt

from vstestbed.core.quantity import Bounded, TighterBounds
from vstestbed.core.registry import Registry, to_mapping

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
    def length(self) -> int | None:
        """The only valid length of a list; None where there are several."""
        lengths = [
            (bound.min_length, bound.max_length) for bound in self.bounds if isinstance(bound, Len)
        ]
        return next((least for least, most in lengths if least == most), None)

    @property
    def within(self) -> Bounded | None:
        """The quantity that a number is, with its bounds and its unit."""
        return next((bound for bound in self.bounds if isinstance(bound, Bounded)), None)

    @property
    def limits(self) -> tuple[float, float]:
        """The smallest and the largest value of a number."""
        lows, highs = [float("-inf")], [float("inf")]
        for bound in self.bounds:
            if isinstance(bound, Bounded):
                lows, highs = [*lows, bound.low], [*highs, bound.high]
            elif isinstance(bound, TighterBounds | Ge | Gt | Le | Lt):
                lows += [
                    float(getattr(bound, name))
                    for name in ("gt", "ge")
                    if getattr(bound, name, None) is not None
                ]
                highs += [
                    float(getattr(bound, name))
                    for name in ("lt", "le")
                    if getattr(bound, name, None) is not None
                ]
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
            elif (
                isinstance(leaf.type, type)
                and dataclasses.is_dataclass(leaf.type)
                and (isinstance(value, dict) or leaf.bounds)
            ):
                return leaf.type, None
        return None

    def blocks(self) -> Iterator[tuple[Registry | None, type]]:
        """The spec classes that it may hold, each with the registry in which it is a kind; None
        where it is the only one.
        """
        for leaf in self.leaves():
            if leaf.registry is not None:
                yield from ((leaf.registry, member) for member in leaf.registry.members.values())
            elif isinstance(leaf.type, type) and dataclasses.is_dataclass(leaf.type):
                yield None, leaf.type


def _node(hint: Any, bounds: tuple[Any, ...] = ()) -> Node:
    if hasattr(hint, "__metadata__"):
        bounds = (*bounds, *hint.__metadata__)
        registry = next((bound for bound in bounds if isinstance(bound, Registry)), None)
        return (
            _node(hint.__origin__, bounds)
            if registry is None
            else Node(hint.__origin__, bounds, registry=registry)
        )
    origin, inner = (
        typing.get_origin(hint),
        [part for part in typing.get_args(hint) if part is not type(None)],
    )
    if origin is Literal:
        return Node(Literal, bounds, words=typing.get_args(hint))
    if origin in (typing.Union, UnionType):
        return (
            _node(inner[0], bounds)
            if len(inner) == 1
            else Node(typing.Union, parts=tuple(_node(part, bounds) for part in inner))
        )
    if origin in (tuple, dict):  # a mapping by name: the values
        return Node(origin, bounds, parts=(_node(inner[-1] if origin is dict else inner[0]),))
    return Node(hint, bounds)


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
    own = {field.name: field for field in dataclasses.fields(cls) if field.init}
    # of a class in a function, `spec` has read the types already
    bases = reversed(cls.__mro__) if any(isinstance(f.type, str) for f in own.values()) else ()
    types = {
        name: hint for base in bases for name, hint in _annotations(base, eval_str=True).items()
    }
    return {
        name: SchemaField(name, _node(types.get(name, field.type)), *_default(field))
        for name, field in own.items()
    }


def needed(cls: type) -> list[str]:
    """The fields of a spec class that have no default."""
    return [name for name, field in fields(cls).items() if field.needed]


def _default(field: dataclasses.Field[Any]) -> tuple[Any, bool]:
    if field.default_factory is not MISSING:
        return to_mapping(field.default_factory()), False
    return (None, True) if field.default is MISSING else (to_mapping(field.default), False)


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
    summary, *rest = [
        text.strip("\n") for text in _sections(cls)[0].split("\n\n") if text.strip()
    ] or [""]
    sources = tuple(" ".join(_SOURCE.sub("", p).split()) for p in rest if _SOURCE.match(p))
    text = "\n\n".join(p for p in rest if not _SOURCE.match(p) and not p.startswith("Raises ("))
    return ClassText(" ".join(summary.split()), text, sources, _field_texts(cls))


def _field_texts(cls: type) -> dict[str, FieldText]:
    words: dict[str, FieldText] = {}
    for names, text in (line for base in reversed(cls.__mro__) for line in _sections(base)[1]):
        example, sentence = _EXAMPLE.search(text), _EXAMPLE.sub("", text)
        each, units = [name.strip() for name in names.split(",")], unit_in(sentence).split(", ")
        of_each = (
            units if len(units) == len(each) else [units[0] if len(units) == 1 else ""] * len(each)
        )
        for name, unit in zip(each, of_each, strict=True):
            words[name] = FieldText(sentence, unit, example[1] if example else "")
    own = {
        name: (field.node, words.get(name, FieldText("", "")))
        for name, field in fields(cls).items()
    }
    return {
        name: dataclasses.replace(text, unit=_unit_of(node, text))
        for name, (node, text) in own.items()
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
    text, items, heading = list[str](), list[list[str]](), ""
    for line in inspect.cleandoc(own).splitlines():
        if line in ("Args:", "Attributes:"):
            heading = line
        elif line and not line.startswith(" "):
            heading = ""
        if not heading:
            text.append(line)
        elif heading == "Args:" and (item := _ITEM.fullmatch(line)):
            items.append([item[1], item[2]])
        elif heading == "Args:" and items:  # the next line of a field
            items[-1][1] += f" {line.strip()}"
    return "\n".join(text), tuple((names, words.strip()) for names, words in items)


def unit_in(words: str) -> str:
    """The unit in brackets of a field's sentence, the last one where there are several; "" where
    there is none.
    """
    found = [text.partition(";")[0] for text in _UNIT.findall(words)]
    return next(
        (
            text
            for text in reversed(found)
            if all(_IS_UNIT.fullmatch(part) for part in text.split(", "))
        ),
        "",
    )


def without_unit(words: str) -> str:
    """A field's sentence without the unit in it, for a table that has a column for it."""
    return words.replace(f" [{unit_in(words)}]", "")


def _unit_of(node: Node, text: FieldText) -> str:
    """The unit of a field: as written, which can be the finer (px^2 in a type of px), else of its
    type.
    """
    # a number may stand for a block of a registry
    numbers = [
        leaf
        for leaf in node.leaves()
        if leaf.number or (leaf.registry is not None and leaf.registry.number)
    ]
    if not numbers:
        return ""
    typed = next(
        (leaf.within.unit for leaf in numbers if leaf.within is not None and leaf.within.unit), ""
    )
    # A whole number counts something, unless its sentence has a unit.
    return (
        text.unit
        or typed
        or (DIMENSIONLESS if all(leaf.type is int or leaf.words for leaf in numbers) else "")
    )
