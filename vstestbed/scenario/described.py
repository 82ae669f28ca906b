"""JSON Schema with the words of the docstrings: a description, a unit and an example for every field.

Editors show the description where the cursor is. `unit` is no word of JSON Schema, which leaves room for such: a reader that does not
know it passes over it.
"""

from __future__ import annotations

import dataclasses
import itertools
import typing
from collections.abc import Iterator
from typing import Any

import pydantic
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core.core_schema import DataclassSchema

from vstestbed.core.docstrings import DIMENSIONLESS, ClassText, FieldText, class_text
from vstestbed.core.mapping import to_mapping
from vstestbed.core.registry import blocks_in, is_list
from vstestbed.core.spec import kind_of, needed_fields, refresh_specs
from vstestbed.scenario.bundled_uses import Uses, bundled_uses
from vstestbed.scenario.dump import flow_text
from vstestbed.scenario.yaml_marks import read_value

LONGEST_EXAMPLE = 100
"""Longest example of a field, in characters of its YAML."""
_NOTHING = ({}, [], "", None)


def schema_of(cls: type) -> dict[str, Any]:
    """JSON Schema of a spec class, Scenario or Comparison, with the kinds that plugins have added until now."""
    refresh_specs()
    draft = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return draft | pydantic.TypeAdapter(cls).json_schema(schema_generator=_Described)


class _Described(GenerateJsonSchema):
    """Pydantic's generator, which takes a whole docstring for a class and nothing for its fields."""

    def dataclass_schema(self, schema: DataclassSchema) -> JsonSchemaValue:
        """The block of a class."""
        block, cls = super().dataclass_schema(schema), schema["cls"]
        words, uses = class_text(cls), bundled_uses()
        block["description"] = "\n\n".join([words.summary, *filter(None, [words.text]), *(f"Source: {s}" for s in words.sources)])
        # Pydantic has fields here, too, that no constructor takes.
        block["properties"] = {name: p for name, p in block["properties"].items() if name in words.fields}
        for name, rule in block["properties"].items():
            rule.pop("title", None)  # the name of the field once more
            rule |= _annotations(cls, name, words, uses)
        return block

    def sort(self, value: JsonSchemaValue, parent_key: str | None = None) -> JsonSchemaValue:
        """As it was made: pydantic would sort the keys in examples, too."""
        return value


def _annotations(cls: type, name: str, words: ClassText, uses: Uses) -> dict[str, Any]:
    """Description, unit and examples of a field, as far as there are any."""
    if name == "kind":
        return {"description": words.summary or f"The kind of {cls.__name__}.", "examples": [kind_of(cls)]}
    field = words.fields[name]
    found: dict[str, Any] = {"description": with_unit(field)} if field.description else {}
    if field.unit:
        found["unit"] = field.unit
    examples = list(examples_of(cls, name, uses))
    return found | ({"examples": examples} if examples else {})


def with_unit(field: FieldText) -> str:
    """A field's sentence, with its unit where the sentence has none."""
    shown = field.unit in ("", DIMENSIONLESS) or "[" in field.description
    return field.description if shown else f"{field.description} [{field.unit}]"


def examples_of(cls: type, name: str, uses: Uses) -> Iterator[Any]:
    """One example of a field, if there is any: one in a bundled file that is not its default; the docstring's; the default."""
    default = next(default_of(f) for f in dataclasses.fields(cls) if f.name == name)
    written = [v for v in uses.values.get((cls.__name__, name), []) if v != default and v not in _NOTHING]
    if written:
        yield min(written, key=lambda v: max(len(flow_text(v)), LONGEST_EXAMPLE))  # the first that is short enough, else the shortest
    elif example := class_text(cls).fields[name].example:
        yield read_value(example)
    elif (filled := _filled(default)) not in _NOTHING:
        yield filled
    else:
        yield from _block_example(typing.get_type_hints(cls, include_extras=True)[name], uses)


def _block_example(hint: Any, uses: Uses) -> Iterator[Any]:
    """Of a field that holds a block, or a list of them."""
    for _, cls in itertools.islice(blocks_in(hint), 1):
        block = example_block(cls, uses)
        yield [block] if is_list(hint) else block


def example_block(cls: type, uses: Uses) -> dict[str, Any]:
    """A block of a class, which need not be used anywhere: its kind and the fields that it needs, else its first field."""
    names = [f.name for f in dataclasses.fields(cls) if f.init and f.name != "kind"]
    kind = {"kind": kind_of(cls)} if "kind" in class_text(cls).fields else {}
    return kind | {name: next(examples_of(cls, name, uses), None) for name in needed_fields(cls) or ([] if kind else names[:1])}


def _filled(value: Any) -> Any:
    """Plain values without the fields that are None, which say nothing in an example."""
    return {name: _filled(inner) for name, inner in value.items() if inner is not None} if isinstance(value, dict) else value


def default_of(field: dataclasses.Field[Any]) -> Any:
    """A field's default as plain values; None where it has none."""
    if field.default_factory is not dataclasses.MISSING:
        return to_mapping(field.default_factory())
    return None if field.default is dataclasses.MISSING else to_mapping(field.default)
