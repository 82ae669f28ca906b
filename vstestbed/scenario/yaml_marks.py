"""YAML text as plain mappings, lists and scalars with the position (`FILE:LINE:COL`) of each; overrides by dotted path."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq, TaggedScalar
from ruamel.yaml.composer import Composer
from ruamel.yaml.constructor import DuplicateKeyError, RoundTripConstructor
from ruamel.yaml.error import MarkedYAMLError, StreamMark, YAMLError
from ruamel.yaml.reader import ReaderError

from vstestbed.core.errors import Mistake, ParameterError, ScenarioError, short

Key = tuple[str | int, ...]
Marks = dict[Key, str]
"""The position of each key, `FILE:LINE:COL`, or the option or argument that it comes from."""
FROM_OPTION: Mapping[Key, str] = {(): "--set"}  # position of a value that comes from the command line
FROM_PYTHON: Mapping[Key, str] = {(): "overrides"}
DEEPEST, MOST_VALUES = 32, 20_000
"""Limits on nesting and on the number of values: far above any scenario, and low enough that a file of aliases of aliases (a
"billion laughs") cannot fill the memory."""


def plain_mapping(text: str, file: str, needs: str) -> tuple[dict[str, Any], Marks]:
    """The mapping in YAML 1.2 text, and the position of its keys. needs: the required content, for messages.
    Raises ScenarioError: it is not YAML, empty, no mapping, or larger than any scenario.
    """
    found = _mapping(text, file)
    if found is None:
        raise ScenarioError([Mistake(f"{file}:1:1", "", f"is empty; {needs}")])
    plain, marks = found
    if plain is None:
        raise ScenarioError([Mistake(f"{file}:1:1", "", f"must be a mapping (name: value); {needs}")])
    return copy.deepcopy(plain), dict(marks)  # the caller changes them


@lru_cache(maxsize=256)
def _mapping(text: str, file: str) -> tuple[dict[str, Any] | None, Marks] | None:
    # Kept: a comparison reads one file for each of its controllers, and `describe` all bundled files.
    tree = _tree(text, file)
    if not isinstance(tree, CommentedMap):
        return None if tree is None else (None, {})
    marks: Marks = {}
    return _plain(tree, (), marks, file), marks


class _Composer(Composer):
    """Ruamel's, which also remembers where the node stands that it reads: text that is nested too deeply ends it without a position."""

    at: StreamMark | None = None

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Ruamel's hook for each node."""
        self.at = self.parser.peek_event().start_mark
        return super().compose_node(parent, index)


class _Constructor(RoundTripConstructor):
    """Ruamel's, which also remembers where the node stands that it constructs: its errors of Python's own kinds have no position."""

    at: StreamMark | None = None

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        """Ruamel's hook for each node."""
        self.at = node.start_mark
        return super().construct_object(node, deep)


def _tree(text: str, file: str) -> Any:
    # Round-trip mode keeps lines and columns, and leaves tagged values as they are, which `_plain` refuses.
    yaml = YAML(typ="rt")
    yaml.Composer, yaml.Constructor = _Composer, _Constructor
    yaml.composer.warn_double_anchors = False  # a name that is given again is plain YAML
    try:
        return yaml.load(text)
    except RecursionError:  # raised inside ruamel, before `_check_size` can see the tree
        raise ScenarioError([Mistake(_place(yaml, file), "", "is nested too deeply for a scenario")]) from None
    except DuplicateKeyError as error:
        key = re.search(r'duplicate key "(.*?)"', error.problem or "")
        words = "stands here for the second time in its block; keep one of the two"
        raise ScenarioError([Mistake(_position(error, file), key[1] if key else "", words)]) from None
    except MarkedYAMLError as error:
        words = " ".join((error.problem or error.context or "").split())
        raise ScenarioError([Mistake(_position(error, file), "", f"is not YAML: {words}")]) from None
    except ReaderError as error:
        before = text[: error.position]
        where = f"{file}:{before.count(chr(10)) + 1}:{len(before) - before.rfind(chr(10))}"
        words = f"is not YAML: unacceptable character #x{error.character:04x}; delete it"
        raise ScenarioError([Mistake(where, "", words)]) from None
    except (YAMLError, ValueError) as error:
        raise ScenarioError([Mistake(_place(yaml, file), "", f"is not YAML: {' '.join(str(error).split())}")]) from None
    except (TypeError, AttributeError, LookupError) as error:  # a list as a key, a tag on the wrong kind of node
        words = f"holds YAML beyond plain mappings, lists and values ({' '.join(str(error).split())})"
        raise ScenarioError([Mistake(_place(yaml, file), "", words)]) from None


def _place(yaml: YAML, file: str) -> str:
    """The position of the node that is being constructed; before the first one, of the one that is being read."""
    at = yaml.constructor.at or yaml.composer.at
    return f"{file}:{at.line + 1}:{at.column + 1}" if at else f"{file}:1:1"


def _position(error: MarkedYAMLError, file: str) -> str:
    mark = error.problem_mark
    return f"{file}:{mark.line + 1}:{mark.column + 1}" if mark else f"{file}:1:1"


def _plain(node: Any, key: Key, marks: Marks, file: str) -> Any:
    """A ruamel tree as plain dicts, lists and scalars; the position of each is added to `marks`."""
    _check_size(key, marks, file)
    if isinstance(node, CommentedMap):
        marks.setdefault(key, f"{file}:{node.lc.line + 1}:{node.lc.col + 1}")
        for k in node:
            marks[*key, str(k)] = _position_of_item(node.lc.key, k, file) or marks[key]
        # Keys as text: `1: x` would be an integer key, and no field has one.
        return {str(k): _plain(v, (*key, str(k)), marks, file) for k, v in node.items()}
    if isinstance(node, CommentedSeq):
        for i in range(len(node)):
            marks[*key, i] = _position_of_item(node.lc.item, i, file) or place_of(key, marks, file)
        return [_plain(v, (*key, i), marks, file) for i, v in enumerate(node)]
    if isinstance(node, TaggedScalar):
        words = f"has the tag {node.tag}; a scenario holds plain values only"
        raise ScenarioError([Mistake(place_of(key, marks, file), ".".join(map(str, key)), words)])
    # A scalar without ruamel's wrapper, which keeps how a number was written; bool before int: a bool is one.
    return next((scalar(node) for scalar in (bool, int, float, str) if isinstance(node, scalar)), node)


def _check_size(key: Key, marks: Marks, file: str) -> None:
    if len(key) > DEEPEST or len(marks) > MOST_VALUES:
        words = f"is nested more than {DEEPEST} deep" if len(key) > DEEPEST else f"brings the file to more than {MOST_VALUES} values"
        raise ScenarioError([Mistake(place_of(key, marks, file), ".".join(map(str, key[:3])), f"{words}; a scenario needs far less")])


def _position_of_item(position: Callable[[Any], tuple[int, int]], item: object, file: str) -> str | None:
    """The position of an item of a block; None for one from a merge key (`<<`), which stands elsewhere."""
    try:
        line, col = position(item)
    except (KeyError, IndexError, TypeError):
        return None
    return f"{file}:{line + 1}:{col + 1}"


def read_value(text: str) -> object:
    """The value of YAML text (`1e-3`, `[1, 2]`, `{kind: oracle}`, `raw`), for `--set`."""
    try:
        return _plain(_tree(text, ""), (), {}, "")
    except ScenarioError as error:
        raise ParameterError("--set", f"value {error.mistakes[0].sentence}", text) from None


def override(
    plain: dict[str, Any], dotted: str, value: object, marks: Marks, is_kind: Callable[[str], bool], own: Mapping[Key, str] = FROM_PYTHON
) -> None:
    """Set the value at a dotted path of a mapping; missing blocks on the path are created, a bare kind (`is_kind`) becomes a block.
    marks: positions of the keys, which are changed, too. own: of the value, and of the keys in it relative to it.
    Raises ScenarioError: the path goes through a value, or to an item that a list does not have.
    """
    parts, where = dotted.split("."), own[()]
    if not all(parts):
        raise ScenarioError([Mistake(where, dotted, "is no path to a field, such as law.gain")])
    here: Any = plain
    key: Key = ()
    for part in parts[:-1]:
        step = _step(here, part, dotted, where)
        key += (step,)
        child = here.get(step) if isinstance(here, dict) else here[step]
        if child is None:
            marks[key] = where
        block = {} if child is None else {"kind": child} if isinstance(child, str) and is_kind(child) else child
        if not isinstance(block, dict | list):
            raise ScenarioError([Mistake(where, dotted, f"{'.'.join(map(str, key))} is a value, not a block, got {short(child)}")])
        here[step] = block
        here = block
    last = _step(here, parts[-1], dotted, where)
    here[last] = copy.deepcopy(value)  # a later override may go inside it, and must not change the caller's
    # The positions under the old value are gone with it.
    for old in [k for k in marks if k[: len(key) + 1] == (*key, last)]:
        del marks[old]
    marks.update({(*key, last, *inner): place for inner, place in own.items()})


def _step(here: Any, part: str, dotted: str, where: str) -> str | int:
    """One part of a dotted path: a key of a block, or the index of an existing item of a list."""
    if not isinstance(here, list):
        return part
    if not (part.isdecimal() and int(part) < len(here)):
        words = f"there is no item {part} in a list of {len(here)} (the first is item 0)"
        raise ScenarioError([Mistake(where, dotted, words)])
    return int(part)


def from_option(paths: Iterable[str]) -> dict[str, Marks]:
    """The places of overrides that come from the command line, for `load`."""
    return {path: dict(FROM_OPTION) for path in paths}


def place_of(key: Key, marks: Mapping[Key, str], file: str, otherwise: str = "") -> str:
    """The position of a key, or of the nearest block above it, else the file's first line."""
    return next((marks[key[:n]] for n in range(len(key), -1, -1) if key[:n] in marks), otherwise or f"{file}:1:1")


def marks_under(key: Key, marks: Mapping[Key, str]) -> Marks:
    """The positions of a value and of the keys in it, relative to it; `--set` where no file has it."""
    inner = {k[len(key) :]: place for k, place in marks.items() if k[: len(key)] == key}
    return {(): place_of(key, marks, "", FROM_OPTION[()])} | inner
