"""What the docstring of a class says: its sections, and the sentence and unit of each field.

The docstrings are the one source of the descriptions in the JSON Schema and of `describe`. A field's line is
`name: words [unit]; e.g. `example`.`, where the example is needed of a field that has no default and that no bundled file sets. One
line may serve several fields, `width, height: picture size [px].`, with a unit each, `a_m, b_deg: ... [m, deg].`
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import re
from dataclasses import dataclass

from vstestbed.core.fields import Node, fields

DIMENSIONLESS = "1"
_UNIT = re.compile(r" \[([^\[\]]{1,40})\]")
_SYMBOL = r"(?:1|rad|deg|m|s|h|Hz|px|kg|N|Nm|W|V|A|K|%|e-|DN|kbit|grey levels)(?:\^[234])?"
_IS_UNIT = re.compile(rf"{_SYMBOL}(?:[ /]{_SYMBOL})*(?: per [a-z_ ]+)?|unit (?:of|as in) .+")
_EXAMPLE = re.compile(r"; e\.g\. `([^`]+)`(?=\.$)")
_SOURCE = re.compile(r"References?: ")
_ITEM = re.compile(r" {4}(\S[^:]*): (.*)")  # a field, or several: `width, height: picture size [px].`


@dataclass(frozen=True)
class FieldText:
    """What is known of a field in words; "" what is not. unit: "1" for a pure number. example: YAML of a value."""

    description: str
    unit: str
    example: str = ""


@dataclass(frozen=True)
class ClassText:
    """A docstring in parts. summary: its first paragraph, on one line. text: what follows up to the fields. sources: one a line."""

    summary: str
    text: str
    sources: tuple[str, ...]
    fields: dict[str, FieldText]


@functools.cache
def class_text(cls: type) -> ClassText:
    """The docstring of a dataclass in parts; inherited fields have the text of the class that brings them."""
    summary, *rest = [text.strip("\n") for text in _sections(cls)[0].split("\n\n") if text.strip()] or [""]
    sources = tuple(" ".join(_SOURCE.sub("", p).split()) for p in rest if _SOURCE.match(p))
    text = "\n\n".join(p for p in rest if not _SOURCE.match(p) and not p.startswith("Raises ("))
    return ClassText(" ".join(summary.split()), text, sources, _field_texts(cls))


def _field_texts(cls: type) -> dict[str, FieldText]:
    words: dict[str, FieldText] = {}
    for names, text in (line for base in reversed(cls.__mro__) for line in _sections(base)[1]):
        example, sentence = _EXAMPLE.search(text), _EXAMPLE.sub("", text)
        each, units = [name.strip() for name in names.split(",")], unit_in(sentence).split(", ")
        of_each = units if len(units) == len(each) else [units[0] if len(units) == 1 else ""] * len(each)
        for name, unit in zip(each, of_each, strict=True):
            words[name] = FieldText(sentence, unit, example[1] if example else "")
    own = {name: (field.node, words.get(name, FieldText("", ""))) for name, field in fields(cls).items()}
    return {name: dataclasses.replace(text, unit=_unit_of(node, text)) for name, (node, text) in own.items()}


@functools.cache
def _sections(cls: type) -> tuple[str, tuple[tuple[str, str], ...]]:
    """The text of a class's own docstring without its lists of fields, and the names and words of the list `Args:`."""
    own = cls.__dict__.get("__doc__")
    if not own or cls is object or own.startswith(f"{cls.__name__}("):  # dataclasses write a signature where there is none
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
    """The unit in brackets of a field's sentence, the last one where there are several; "" where there is none."""
    found = [text.partition(";")[0] for text in _UNIT.findall(words)]
    return next((text for text in reversed(found) if all(_IS_UNIT.fullmatch(part) for part in text.split(", "))), "")


def without_unit(words: str) -> str:
    """A field's sentence without the unit in it, for a table that has a column for it."""
    return words.replace(f" [{unit_in(words)}]", "")


def _unit_of(node: Node, text: FieldText) -> str:
    """The unit of a field: as written, which can be the finer (px^2 in a type of px), else of its type."""
    # a number may stand for a block of a registry
    numbers = [leaf for leaf in node.leaves() if leaf.number or (leaf.registry is not None and leaf.registry.number)]
    if not numbers:
        return ""
    typed = next((leaf.within.unit for leaf in numbers if leaf.within is not None and leaf.within.unit), "")
    # A whole number counts something, unless its sentence has a unit.
    return text.unit or typed or (DIMENSIONLESS if all(leaf.type is int or leaf.words for leaf in numbers) else "")
