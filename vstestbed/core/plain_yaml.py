"""YAML of others as plain values: no aliases, no field twice."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import yaml


class _Loader(yaml.SafeLoader):
    """YAML without aliases, of which a short file can hold millions of values, and without fields that come twice."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise ValueError("it has aliases; write their values out")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        return once(self.construct_pairs(node, deep))


def plain_documents(text: str) -> list[Any]:
    """The documents of a YAML text that hold anything. ValueError, yaml.YAMLError, RecursionError: for `foreign`."""
    documents = yaml.load_all(text, _Loader)
    return [document for document in documents if document is not None]


def once(pairs: Sequence[tuple[Any, Any]]) -> dict[Any, Any]:
    """The mapping of these pairs; ValueError where a field comes twice."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("it has a field twice")
    return found
