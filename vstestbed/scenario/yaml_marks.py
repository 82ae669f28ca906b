"""YAML text as plain mappings, lists and scalars with the position (`FILE:LINE:COL`) of each;
overrides by dotted path; the specs that are built from them, with every mistake as a sentence at
its position.
"""

from __future__ import annotations

import copy
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Literal, TypeVar

import pydantic
import yaml

from vstestbed.core.errors import Mistake, ParameterError, ScenarioError, short
from vstestbed.core.foreign import foreign
from vstestbed.core.messages import all_messages, converted
from vstestbed.core.registry import REGISTRIES, to_mapping, validator_of

__all__ = [
    "FROM_OPTION",
    "FROM_PYTHON",
    "Key",
    "Marks",
    "build",
    "bundled_mapping",
    "from_option",
    "marks_under",
    "place_of",
    "plain_mapping",
    "put_over",
    "read_value",
    "respelled",
    "text_of",
]

T = TypeVar("T")

Key = tuple[str | int, ...]
# the position of each key, `FILE:LINE:COL`, or the option or argument that it comes from
Marks = dict[Key, str]
# position of a value that comes from the command line
FROM_OPTION: Mapping[Key, str] = {(): "--set"}
FROM_PYTHON: Mapping[Key, str] = {(): "overrides"}
DEEPEST = 32
MOST_VALUES = 20_000
"""Limits on nesting and on the number of values: far above any scenario, and low enough that a file
of aliases of aliases (a "billion laughs") cannot fill the memory.
"""

# largest file that is read: fifty times the largest bundled one, and parsed in 2 s; one of 10 MB
# would take minutes
MOST_BYTES = 100_000


def text_of(path: Path) -> str:
    """The text of a UTF-8 file; ScenarioError where it cannot be read."""
    if path.exists() and not (path.is_file() or path.is_dir()):
        words = "is not a regular file, and would be waited for; save it as one"
        raise ScenarioError.at(str(path), "", words)
    try:
        # Bytes first: the position of a bad byte is its line and column only while nothing is
        # decoded.
        with path.open("rb") as stream:
            raw = stream.read(MOST_BYTES + 1)
    except OSError as error:
        raise ScenarioError.at(str(path), "", f"cannot be read ({error.strerror})") from None
    if len(raw) > MOST_BYTES:
        words = f"has more than {MOST_BYTES // 1000} kB; a scenario needs far less"
        raise ScenarioError.at(f"{path}:1:1", "", words)
    try:
        return raw.decode("utf-8-sig")  # editors on Windows begin a file with a byte order mark
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        col = error.start - (raw.rfind(b"\n", 0, error.start) + 1) + 1
        words = f"is not UTF-8 text (byte 0x{raw[error.start]:02x}); save the file as UTF-8"
        raise ScenarioError.at(f"{path}:{line}:{col}", "", words) from None


def plain_mapping(text: str, file: str, needs: str) -> tuple[dict[str, Any], Marks]:
    """The mapping in YAML 1.2 text, and the position of its keys. needs: the required content, for
    messages.
    Raises ScenarioError: it is not YAML, empty, no mapping, or larger than any scenario.
    """
    with foreign(file, needs):
        found = _mapping(text, file)
    if found is None:
        raise ScenarioError.at(f"{file}:1:1", "", f"is empty; {needs}")
    plain, marks = found
    if plain is None:
        raise ScenarioError.at(f"{file}:1:1", "", f"must be a mapping (name: value); {needs}")
    return copy.deepcopy(plain), dict(marks)  # the caller changes them


@lru_cache(maxsize=256)
def _mapping(text: str, file: str) -> tuple[dict[str, Any] | None, Marks] | None:
    # Kept: a comparison reads one file for each of its controllers.
    tree = _tree(text, file)
    if tree is None or (tree.kind == "scalar" and _scalar(tree) is None):
        return None
    if tree.kind != "mapping":
        return None, {}
    marks: Marks = {}
    _mark(tree, (), marks)
    return _value(tree), marks


@dataclass(eq=False)
class _Node:
    """A node of YAML text. parts: of a list its items, of a mapping keys and values in turn. start,
    end: the parser's marks.
    """

    kind: Literal["scalar", "list", "mapping"]
    file: str
    start: Any = None
    end: Any = None
    tag: str = ""
    text: str = ""
    quoted: bool = False
    parts: list[_Node] = field(default_factory=list)

    @property
    def place(self) -> str:
        """Its position, FILE:LINE:COL."""
        return _place(self.start, self.file)

    @cached_property
    def fields(self) -> Fields:
        """Of a mapping its fields.

        They are found once: a mapping of merges of merges would be gone through as often as there
        are ways to it.
        """
        merged: Fields = {}
        own: Fields = {}
        for name, value in zip(self.parts[::2], self.parts[1::2], strict=True):
            if name.kind != "scalar":
                raise _not_plain(name)
            if name.text == "<<":
                merged = _merged(name, value) | merged
            elif name.text in own:
                words = "stands here for the second time in its block; keep one of the two"
                raise ScenarioError.at(name.place, name.text, words)
            else:
                own[name.text] = name.place, value
        return own | {name: field for name, field in merged.items() if name not in own}


# of a mapping, by name: the position of the key, "" of one from a merge key, and the value's node
Fields = dict[str, tuple[str, _Node]]


def _merged(name: _Node, value: _Node) -> Fields:
    """The fields of the mapping, or of the list of mappings, at a merge key (`<<`)."""
    merged: Fields = {}
    for source in value.parts if value.kind == "list" else [value]:
        if source.kind != "mapping":
            raise _not_plain(name)
        merged = {inner: ("", held) for inner, (_, held) in source.fields.items()} | merged
    return merged


def _not_plain(node: _Node) -> ScenarioError:
    return ScenarioError.at(node.place, "", "holds YAML beyond plain mappings, lists and values")


def _tree(text: str, file: str) -> _Node | None:
    """The node of a document; None for one that is empty. From the parser's events, since libyaml's
    own tree of a deep document overflows the stack.
    """
    try:
        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        return _node_of(yaml.parse(text, Loader=loader), file)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        words = error.problem or error.context or ""
        got = f", got {text[mark.index]!r}" if mark and mark.index < len(text) else ""
        raise _not_yaml(_place(mark, file), f"{words}{got}") from None
    except yaml.reader.ReaderError as error:
        before = text[: error.position]
        where = f"{file}:{before.count(chr(10)) + 1}:{len(before) - before.rfind(chr(10))}"
        words = f"unacceptable character #x{error.character:04x}; delete it"
        raise _not_yaml(where, words) from None
    except UnicodeEncodeError as error:
        raise _not_yaml(f"{file}:1:1", error.reason) from None


def _place(mark: Any, file: str) -> str:
    return f"{file}:{mark.line + 1}:{mark.column + 1}" if mark else f"{file}:1:1"


def _node_of(events: Iterable[Any], file: str) -> _Node | None:
    whole = _Node("list", file)
    open_nodes = [whole]
    anchors: dict[str, _Node] = {}
    for event in events:
        if isinstance(event, yaml.CollectionEndEvent):
            open_nodes.pop()
        elif isinstance(event, yaml.DocumentStartEvent) and whole.parts:
            raise _not_yaml(_place(event.start_mark, file), "but found another document")
        if not isinstance(event, yaml.NodeEvent):
            continue
        node = _begun(event, anchors, file)
        open_nodes[-1].parts.append(node)
        if event.anchor:
            anchors[event.anchor] = node
        if isinstance(event, yaml.CollectionStartEvent):
            open_nodes.append(node)
            if len(open_nodes) > DEEPEST + 1:
                words = f"is nested more than {DEEPEST} deep; a scenario needs far less"
                raise ScenarioError.at(node.place, "", words)
    return whole.parts[0] if whole.parts else None


def _begun(event: Any, anchors: Mapping[str, _Node], file: str) -> _Node:
    """The node that an event of the parser begins, or the one that its alias stands for."""
    if isinstance(event, yaml.AliasEvent):
        if event.anchor not in anchors:
            words = f"found undefined alias {event.anchor!r}"
            raise _not_yaml(_place(event.start_mark, file), words)
        return anchors[event.anchor]
    node = _Node("list", file, event.start_mark, event.end_mark, event.tag or "")
    if isinstance(event, yaml.ScalarEvent):
        node.kind = "scalar"
        node.text = event.value
        node.quoted = not event.implicit[0]
    elif isinstance(event, yaml.MappingStartEvent):
        node.kind = "mapping"
    return node


def _not_yaml(where: str, words: str) -> ScenarioError:
    return ScenarioError.at(where, "", f"is not YAML: {words}")


def _scalar(node: _Node) -> Any:
    """The value of a scalar by YAML 1.2; PyYAML's own are those of 1.1, where `on` is a truth value
    and `1e3` a text.
    """
    text = node.text
    if (node.quoted and not node.tag) or node.tag == f"{_CORE}str":
        return text
    if text in _WORDS:
        return _WORDS[text]
    try:
        if _INTEGER.fullmatch(text):
            return int(text, 0 if text[:2] in ("0o", "0x") else 10)
        return float(text) if _FLOAT.fullmatch(text) else text
    except ValueError as error:
        raise _not_yaml(node.place, " ".join(str(error).split())) from None


_INTEGER = re.compile(r"[-+]?[0-9][0-9_]*|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9][0-9_]*(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_CORE = "tag:yaml.org,2002:"
_PLAIN = {f"{_CORE}{kind}" for kind in ("str", "int", "float", "bool", "null", "seq", "map")}
_WORDS: dict[str, Any] = dict.fromkeys(("", "~", "null", "Null", "NULL"))
_WORDS |= dict.fromkeys(("true", "True", "TRUE"), True)
_WORDS |= dict.fromkeys(("false", "False", "FALSE"), False)
_WORDS |= dict.fromkeys((".inf", ".Inf", ".INF", "+.inf", "+.Inf", "+.INF"), math.inf)
_WORDS |= dict.fromkeys(("-.inf", "-.Inf", "-.INF"), -math.inf)
_WORDS |= dict.fromkeys((".nan", ".NaN", ".NAN"), math.nan)


def _mark(node: _Node, key: Key, marks: Marks) -> None:
    """Add the positions of a node and of all in it to `marks`. Raises ScenarioError: it is larger
    than any scenario, or has a tag.
    """
    _check_node(node, key, marks)
    if node.kind == "scalar":
        return
    here = marks.setdefault(key, node.place)
    inner: Mapping[Any, tuple[str, _Node]] = {i: (n.place, n) for i, n in enumerate(node.parts)}
    if node.kind == "mapping":
        inner = node.fields
    for name, (place, _) in inner.items():
        marks[*key, name] = place or here
    for name, (_, item) in inner.items():
        _mark(item, (*key, name), marks)


def _check_node(node: _Node, key: Key, marks: Marks) -> None:
    shown = key[:3]
    if len(key) > DEEPEST:
        words = f"is nested more than {DEEPEST} deep; a scenario needs far less"
    elif len(marks) > MOST_VALUES:
        words = f"brings the file to more than {MOST_VALUES} values; a scenario needs far less"
    elif node.tag and node.tag not in _PLAIN:
        shown = key
        words = f"has the tag {node.tag}; a scenario holds plain values only"
    else:
        return
    raise ScenarioError.at(place_of(key, marks, node.file), ".".join(map(str, shown)), words)


def _value(node: _Node) -> Any:
    """A node as plain dicts, lists and scalars."""
    if node.kind == "scalar":
        return _scalar(node)
    if node.kind == "list":
        return [_value(item) for item in node.parts]
    return {name: _value(value) for name, (_, value) in node.fields.items()}


def bundled_mapping(path: Path) -> dict[str, Any]:
    """The mapping in one of the files of the installation, which needs no check and no position; {}
    of an empty file.
    """
    tree = _tree(path.read_text(encoding="utf-8"), str(path))
    return {} if tree is None else _value(tree)


def respelled(text: str, file: str, values: Any) -> str:
    """YAML text with other values in place of its words, by the plain values that it should have;
    comments and layout stay.
    """
    tree = _tree(text, file)
    changed = {} if tree is None else dict(_changed(tree, values))
    for (start, end), value in sorted(changed.items(), reverse=True):
        if not re.fullmatch(r"[A-Za-z_./\\][\w./\\+-]*", value):
            value = json.dumps(value, ensure_ascii=False)
        text = text[:start] + value + text[end:]
    return text


def _changed(node: _Node, value: Any) -> Iterator[tuple[tuple[int, int], str]]:
    if node.kind == "mapping" and isinstance(value, dict):
        for name, (_, inner) in node.fields.items():
            yield from _changed(inner, value.get(name))
    elif node.kind == "list" and isinstance(value, list):
        for inner, one in zip(node.parts, value, strict=False):
            yield from _changed(inner, one)
    elif isinstance(value, str) and value != node.text:
        yield (node.start.index, node.end.index), value


def read_value(text: str) -> object:
    """The value of YAML text (`1e-3`, `[1, 2]`, `{kind: oracle}`, `raw`), for `--set`."""
    try:
        with foreign("--set", "a value that is nested less deeply"):
            tree = _tree(text, "")
            if tree is None:
                return None
            _mark(tree, (), {})
            return _value(tree)
    except ScenarioError as error:
        raise ParameterError("--set", f"value {error.mistakes[0].sentence}", text) from None


def override(
    plain: dict[str, Any],
    dotted: str,
    value: object,
    marks: Marks,
    own: Mapping[Key, str] = FROM_PYTHON,
) -> None:
    """Set the value at a dotted path of a mapping; missing blocks on the path are created, a bare
    kind becomes a block. marks: positions of the keys, which are changed, too. own: of the value,
    and of the keys in it relative to it.
    Raises ScenarioError: the path goes through a value, or to an item that a list does not have.
    """
    where = own[()]
    *before, name = parts = dotted.split(".")
    if "" in parts:
        raise ScenarioError.at(where, dotted, "is no path to a field, such as law.gain")
    here: Any = plain
    key: Key = ()
    for part in before:
        step = _step(here, part, dotted, where)
        key += (step,)
        child = here.get(step) if isinstance(here, dict) else here[step]
        if child is None:
            marks[key] = where
        here[step] = block = _as_block(child)
        if not isinstance(block, dict | list):
            words = f"{'.'.join(map(str, key))} is a value, not a block, got {short(child)}"
            raise ScenarioError.at(where, dotted, words)
        here = block
    last = _step(here, name, dotted, where)
    key += (last,)
    # a later override may go inside it, and must not change the caller's
    here[last] = copy.deepcopy(value)
    # The positions under the old value are gone with it.
    for old in [k for k in marks if k[: len(key)] == key]:
        del marks[old]
    marks.update({(*key, *inner): place for inner, place in own.items()})


def _as_block(value: Any) -> Any:
    """The block that a bare kind stands for, an empty one of nothing; another value as it is."""
    if value is None:
        return {}
    if isinstance(value, str) and any(value in registry.members for registry in REGISTRIES):
        return {"kind": value}
    return value


def _step(here: Any, part: str, dotted: str, where: str) -> str | int:
    """One part of a dotted path: a key of a block, or the index of an existing item of a list."""
    if not isinstance(here, list):
        return part
    if not (part.isdecimal() and int(part) < len(here)):
        words = f"there is no item {part} in a list of {len(here)} (the first is item 0)"
        raise ScenarioError.at(where, dotted, words)
    return int(part)


def overlap(one: str, other: str) -> bool:
    """Whether two dotted paths are of one field, or of a block and a field in it."""
    return f"{one}.".startswith(f"{other}.") or f"{other}.".startswith(f"{one}.")


def from_option(paths: Iterable[str]) -> dict[str, Marks]:
    """The places of overrides that come from the command line, for `load`."""
    return {path: dict(FROM_OPTION) for path in paths}


def place_of(key: Key, marks: Mapping[Key, str], file: str, otherwise: str = "") -> str:
    """The position of a key, or of the nearest block above it, else the file's first line."""
    for n in range(len(key), -1, -1):
        if key[:n] in marks:
            return marks[key[:n]]
    return otherwise or f"{file}:1:1"


def marks_under(key: Key, marks: Mapping[Key, str]) -> Marks:
    """The positions of a value and of the keys in it, relative to it;
    `--set` where no file has it.
    """
    inner = {k[len(key) :]: place for k, place in marks.items() if k[: len(key)] == key}
    return {(): place_of(key, marks, "", FROM_OPTION[()])} | inner


def build(cls: type[T], plain: dict[str, Any], marks: Marks, file: str) -> T:
    """An object of the spec class `cls` from the YAML as plain values, with the positions of its
    keys and the file's name for messages.
    Raises ScenarioError: all mistakes at once, each with its position in the file.
    """
    try:
        made = validator_of(cls).validate_python(plain)
        found = list(converted(plain, to_mapping(made), ()))
        if not found:
            return made
    except pydantic.ValidationError as error:
        found = all_messages(error, plain, cls)
    mistakes = [
        Mistake(place_of(key, marks, file), ".".join(map(str, key)), words)
        for key, words in dict.fromkeys(found)
    ]
    raise ScenarioError(sorted(mistakes, key=_reading_order))


def _reading_order(mistake: Mistake) -> tuple[int, ...]:
    """Sort key (line, column) of a mistake; those of --set, which have no position, come last."""
    place = mistake.where.rsplit(":", 2)[1:]
    return tuple(int(n) for n in place) if len(place) == 2 else (1 << 31,)


def put_over(
    plain: dict[str, Any], values: Mapping[str, object], marks: Marks, places: Mapping[str, Marks]
) -> None:
    """Put values over a scenario's mapping, in place and in their order, by dotted path. marks:
    positions of its keys, also changed. places: of the values, and of the keys in them. Raises
    ScenarioError: see `override`.
    """
    for path, value in values.items():
        override(plain, path, value, marks, places.get(path, FROM_PYTHON))
