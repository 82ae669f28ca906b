"""YAML of others as plain values: no aliases, no field twice."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import yaml


class _Loader(yaml.SafeLoader):
    """YAML without aliases, of which a short file can hold millions of values, and without fields
    that come twice.
    """

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise ValueError("it has aliases; write their values out")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        return once(self.construct_pairs(node, deep))


OTHER_BASE = re.compile(r"[-+]?0[0-7_]+|.*:.*")


def _number(loader: _Loader, node: Any) -> Any:
    """A number, but a text of one that YAML 1.1 reads by a base of 8 or 60, and other readers do
    not: 0640 is 416 there, 10:00 600.
    """
    if OTHER_BASE.fullmatch(node.value):
        return f"{node.value} (by YAML 1.1 of base 8 or 60)"
    if node.tag.endswith("float"):
        return loader.construct_yaml_float(node)
    return loader.construct_yaml_int(node)


for _kind in ("int", "float"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _number)


def plain_documents(text: str) -> list[Any]:
    """The documents of a YAML text that hold anything. ValueError, yaml.YAMLError, RecursionError:
    for `foreign`.
    """
    documents = yaml.load_all(text, _Loader)
    return [document for document in documents if document is not None]


def once(pairs: Sequence[tuple[Any, Any]]) -> dict[Any, Any]:
    """The mapping of these pairs; ValueError where a field comes twice."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("it has a field twice")
    return found
