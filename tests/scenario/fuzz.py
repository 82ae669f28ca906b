"""Random scenarios for the fuzz tests: values drawn from the spec classes, put into bundled
scenarios; and YAML text that is damaged.

A `Case` is the content of a scenario file. It is drawn by hypothesis, so that a failing one is
shrunk to the smallest that fails.
"""

from __future__ import annotations

import copy
import dataclasses
import functools
import io
import re
import time
import traceback
import types
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, Union

import numpy as np
from hypothesis import strategies as st
from ruamel.yaml import YAML

import vstestbed as vs
from vstestbed.core.errors import ScenarioError, VstestbedError
from vstestbed.core.named_files import bundled_scenarios
from vstestbed.core.registry import Registry
from vstestbed.scenario import load as loader
from vstestbed.scenario.plugins import registries
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.yaml_marks import plain_mapping

FILES = bundled_scenarios()
TYPES = (
    list(registries()["robots"].members)
    + list(registries()["laws"].members)
    + list(registries()["goals"].members)
)

FLOATS = st.sampled_from(
    [
        0.0,
        -0.0,
        1.0,
        -1.0,
        1e-308,
        5e-324,
        -1e-308,
        1e-12,
        1e-6,
        1e-3,
        0.5,
        10.0,
        89.999,
        90.0,
        180.0,
        360.0,
        1e3,
        1e6,
        1e9,
        1e15,
    ]
    + [
        1e154,
        1e155,
        1e308,
        -1e308,
        1.7976931348623157e308,
        float("nan"),
        float("inf"),
        float("-inf"),
        -1e6,
        -1e154,
    ]
)
INTS = st.sampled_from(
    [
        0,
        1,
        -1,
        2,
        3,
        7,
        8,
        24,
        255,
        256,
        8192,
        2**31,
        2**53,
        2**63 - 1,
        2**63,
        -(2**63),
        10**30,
        10**400,
        -(10**400),
    ]
)
WORDS = st.sampled_from(
    [
        "",
        " ",
        "none",
        "pnp",
        "oracle",
        "ibvs",
        "µ",
        "日本語",
        "\u202e",
        "../../etc",
        "a/b",
        "~",
        "null",
        "x" * 5000,
        "\U0001f600",
    ]
)
ODD = st.one_of(
    st.none(),
    st.booleans(),
    FLOATS,
    INTS,
    WORDS,
    st.sampled_from(TYPES),
    st.just([]),
    st.just({}),
    st.just([[]]),
    st.just([None] * 3),
    st.lists(FLOATS, max_size=7),
    st.dictionaries(st.sampled_from(["kind", "x", "", "1"]), st.one_of(FLOATS, WORDS), max_size=2),
    st.just([0] * 500),
)


@functools.cache
def plain_of(name: str) -> dict[str, Any]:
    """The content of a bundled scenario; it is shared, to be copied."""
    return plain_mapping(loader.text_of(FILES[name]), name, "")[0]


def numbers(meta: list[Any], whole: bool) -> st.SearchStrategy[Any]:
    """Numbers within the bounds of a field, at them, and beyond."""
    lows = [
        float(v)
        for m in meta
        for name in ("ge", "gt", "low")
        if (v := getattr(m, name, None)) is not None
    ]
    highs = [
        float(v)
        for m in meta
        for name in ("le", "lt", "high")
        if (v := getattr(m, name, None)) is not None
    ]
    low, high = max(lows, default=-10.0), min(highs, default=10.0)
    low, high = (low, max(low, high)) if lows else (min(low, high), high)
    ordinary = st.floats(max(low, -10.0), max(min(high, 10.0), max(low, -10.0))).map(
        lambda x: float(f"{x:.4g}")
    )
    if whole:
        return st.one_of(
            st.integers(int(low), max(int(low), int(min(high, 1000)))),
            INTS,
            st.sampled_from([int(low), int(high)]),
            FLOATS,
        )
    return st.one_of(
        ordinary,
        ordinary,
        ordinary,
        ordinary,
        st.floats(low, high),
        st.sampled_from([low, high]),
        FLOATS,
        INTS,
    )


def values(hint: Any, depth: int = 0) -> st.SearchStrategy[Any]:
    """Plain values for a field's type: mostly of the right kind, from the edges of its domain and
    beyond.
    """
    return st.integers(0, 7).flatmap(lambda n: right(hint, [], depth) if n else ODD)


def right(hint: Any, meta: list[Any], depth: int) -> st.SearchStrategy[Any]:
    """Values of the type, whatever their size."""
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        rooms = [m for m in args[1:] if isinstance(m, Registry)]
        return room_values(rooms[0], depth) if rooms else right(args[0], [*meta, *args[1:]], depth)
    if origin in (Union, types.UnionType):
        return st.one_of([right(arg, meta, depth) for arg in args])
    if origin is Literal:
        return st.sampled_from(args)
    if origin is tuple:
        return listed(args[0], meta, depth)
    if origin is dict:
        return st.dictionaries(WORDS, values(args[1], depth + 1), max_size=2)
    if dataclasses.is_dataclass(hint):
        return blocks(typing.cast(type, hint), depth)
    simple = {
        bool: st.booleans(),
        str: WORDS,
        type(None): st.none(),
        float: numbers(meta, False),
        int: numbers(meta, True),
    }
    return simple[hint]


def listed(item: Any, meta: list[Any], depth: int) -> st.SearchStrategy[Any]:
    """Lists of a valid length, and others."""
    lengths = [m for m in meta if hasattr(m, "min_length")]
    least, most = (lengths[0].min_length, lengths[0].max_length or 3) if lengths else (0, 3)
    inner = values(item, depth + 1) if least < 5 else right(item, [], depth + 1)
    same = right(item, [], depth + 1).map(lambda v: [v] * max(least, 1))
    return st.one_of(
        st.lists(inner, min_size=least, max_size=min(most, least + 2)),
        same,
        st.lists(inner, max_size=2),
    )


def room_values(room: Registry, depth: int) -> st.SearchStrategy[Any]:
    """Blocks of each kind of a room, and the bare words;
    of a room without kinds what it refuses.
    """
    if not room.members:
        return st.one_of(WORDS, st.just({}))
    return st.one_of(
        st.sampled_from(list(room.members.values())).flatmap(lambda cls: blocks(cls, depth)),
        st.sampled_from(list(room.members)),
    )


def hints_of(cls: type) -> dict[str, Any]:
    """Types of a spec class's fields, by name."""
    hints = typing.get_type_hints(cls, include_extras=True)
    return {f.name: hints[f.name] for f in dataclasses.fields(cls) if f.init}


@st.composite
def blocks(draw: st.DrawFn, cls: type, depth: int = 0) -> dict[str, Any]:
    """A block of a spec class: required fields, and some of the others."""
    made: dict[str, Any] = {}
    optional: list[str] = []
    hints = hints_of(cls)
    for f in dataclasses.fields(cls):
        if f.name == "kind":
            made["kind"] = f.default
        elif (
            f.init and f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING
        ):
            made[f.name] = draw(right(hints[f.name], [], depth + 1))
        elif f.init:
            optional.append(f.name)
    if optional and depth < 4:
        for name in draw(st.lists(st.sampled_from(optional), max_size=2, unique=True)):
            made[name] = draw(right(hints[name], [], depth + 1))
    return made


def member_of(hint: Any, plain: Any) -> Any:
    """The spec class of the block `plain` in a field of this type, or the item type of a list; None
    for scalars.
    """
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        for room in (m for m in args[1:] if isinstance(m, Registry)):
            given = plain.get("kind") if isinstance(plain, dict) else None
            kind = given or next((k for f, k in room.fields.items() if f in plain), room.default)
            return room.members.get(kind) if isinstance(kind, str) else None
        return member_of(args[0], plain)
    if origin in (Union, types.UnionType):
        return next((found for arg in args if (found := member_of(arg, plain)) is not None), None)
    return hint if dataclasses.is_dataclass(hint) else None


def item_type(hint: Any) -> Any:
    """The item type of a list's type."""
    for arg in (hint, *typing.get_args(hint)):
        if typing.get_origin(arg) is tuple:
            return typing.get_args(arg)[0]
        if typing.get_origin(arg) in (Union, types.UnionType, Annotated):
            found = (
                item_type(typing.get_args(arg)[0]) if typing.get_origin(arg) is Annotated else None
            )
            if found is not None:
                return found
    return None


def _change(draw: st.DrawFn, plain: dict[str, Any], cls: type) -> None:
    """Replace one value somewhere in a block by one drawn from its field's type."""
    here, hints = plain, hints_of(cls)
    while True:
        name = draw(st.sampled_from(sorted(hints)))
        hint, inside = hints[name], here.get(name)
        if (
            isinstance(inside, list)
            and inside
            and (item := item_type(hint)) is not None
            and draw(st.integers(0, 2))
        ):
            i = draw(st.integers(0, len(inside) - 1))
            deeper = member_of(item, inside[i]) if isinstance(inside[i], dict) else None
            if deeper is None:
                # of `just` every draw is the same object
                inside[i] = copy.deepcopy(draw(values(item)))
                return
            here, hints = inside[i], hints_of(deeper)
            continue
        deeper = member_of(hint, inside) if isinstance(inside, dict) else None
        if deeper is None or not draw(st.integers(0, 3)):
            here[name] = copy.deepcopy(draw(values(hint)))
            return
        here, hints = inside, hints_of(deeper)


def as_yaml(plain: Any) -> bytes:
    """YAML text of plain values, whatever they are."""
    out = io.StringIO()
    yaml = YAML(typ="safe", pure=True)
    yaml.allow_unicode = True
    # huge integers, of more digits than Python turns to text by default, are no business of these
    # tests' own writer
    yaml.dump(plain, out)
    return out.getvalue().encode()


@st.composite
def specs(draw: st.DrawFn) -> bytes:
    """A bundled scenario with one to three values replaced."""
    plain = copy.deepcopy(plain_of(draw(st.sampled_from(sorted(FILES)))))
    for _ in range(draw(st.integers(1, 3))):
        _change(draw, plain, Scenario)
    return as_yaml(plain)


SNIPPETS = [
    "\t", "\x00", "\x07", "\x1b[31m", "\x85", "\ufeff", "\u2028", "&a ", "*a", "&a [*a]",
    "!!python/object:os.system ", "!!binary ", "!!set ", "!!omap ", "!!int ", "!!float ",
    "!!timestamp ", "!tag ", "<<: *a\n", "? ", ": ", "- ", "| ", "> ", "{", "}", "[", "]", "{{",
    "'", '"', "#", "%YAML 3.0\n", "%TAG ! x\n", "---\n", "...\n", "? [1, 2]\n: 3\n",
    "? {a: b}\n: 3\n", "~: 1\n", "1: 2\n", "true: 1\n", "2001-01-01: 1\n",
    "2001-12-14t21:59:43.10-05:00", "0x7fffffffffffffffff", "0b1", "0o17", "1_000", "1e999",
    "-.inf", ".nan", "12:30:45", "=", "@", "`", "9" * 5000, "\\", "\r", "\r\n", "é", "\U0001f600",
    "[" * 40 + "]" * 40, "[" * 3000, "{a: " * 500, "- " * 2000, "&" + "a" * 2000 + " x",
    "x" * 50_000, "# " + "x" * 50_000 + "\n", "\n" * 10_000, "!!merge x", "<<: [1]\n", "<<: x\n",
    "!<tag:yaml.org,2002:int> x", "2001-99-99", "!!timestamp 2001-99-99", "!!int 0x", "!!float x",
    "!!bool 3", "0x", "1e", "0b2",
]  # fmt: skip
BOMB = "\n".join(
    ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    + [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 9)]
)
MERGES = "\n".join(
    ["m0: &m0 {a: 1}"]
    + [f"m{i}: &m{i} {{<<: [{', '.join([f'*m{i - 1}'] * 9)}]}}" for i in range(1, 9)]
)
BYTES = [
    b"\xff",
    b"\xfe\xff",
    b"\xc3",
    b"\xed\xa0\x80",
    b"\xf8\x88\x80\x80\x80",
    b"\x00",
    b"\xef\xbb\xbf",
]


def _lines(draw: st.DrawFn, text: str) -> str:
    """Delete, duplicate, swap, indent or cut a line."""
    lines = text.splitlines(keepends=True) or [""]
    i, j = draw(st.integers(0, len(lines) - 1)), draw(st.integers(0, len(lines) - 1))
    match draw(st.sampled_from(["delete", "duplicate", "swap", "indent", "cut", "tab"])):
        case "delete":
            del lines[i]
        case "duplicate":
            lines.insert(j, lines[i])
        case "swap":
            lines[i], lines[j] = lines[j], lines[i]
        case "indent":
            lines[i] = " " * draw(st.integers(1, 5)) + lines[i]
        case "tab":
            lines[i] = lines[i].replace(" ", "\t", 1)
        case _:
            lines[i] = lines[i][: draw(st.integers(0, len(lines[i])))]
    return "".join(lines)


def _insert(draw: st.DrawFn, text: str) -> str:
    """Put a snippet where a value begins, or anywhere."""
    starts = [m.end() for m in re.finditer(r"[:\[{,\-] |^", text, flags=re.MULTILINE)]
    at = draw(st.one_of(st.sampled_from(starts), st.integers(0, len(text))))
    return text[:at] + draw(st.sampled_from(SNIPPETS)) + text[at:]


def _replace_number(draw: st.DrawFn, text: str) -> str:
    """Another number, or a word, in the place of one that stands there."""
    found = list(re.finditer(r"-?\d+\.?\d*", text))
    if not found:
        return text
    one = draw(st.sampled_from(found))
    new = draw(
        st.one_of(
            FLOATS.map(repr),
            st.sampled_from(
                [
                    "1e308",
                    "-1e308",
                    "1e-308",
                    ".inf",
                    ".nan",
                    "0",
                    "-0.0",
                    "true",
                    "null",
                    "'1'",
                    "[]",
                    "{}",
                    "9" * 400,
                ]
            ),
        )
    )
    return text[: one.start()] + new + text[one.end() :]


def _whole(draw: st.DrawFn, text: str) -> str:
    """Truncate, double, or add what grows."""
    match draw(st.sampled_from(["truncate", "double", "bomb", "merges", "many", "strip"])):
        case "truncate":
            return text[: draw(st.integers(0, len(text)))]
        case "double":
            return text + text
        case "bomb":
            return text + "\n" + BOMB
        case "merges":
            return text + "\n" + MERGES + "\n<<: *m8\n"
        case "many":
            return text + "".join(
                f"k{i}: 1\n" for i in range(draw(st.sampled_from([10, 1000, 5000])))
            )
        case _:
            return text.replace(draw(st.sampled_from([" ", "\n", ":", "{", "}", "[", "]"])), "")


@st.composite
def texts(draw: st.DrawFn) -> bytes:
    """The text of a bundled scenario with one to three damages."""
    text = loader.text_of(FILES[draw(st.sampled_from(sorted(FILES)))])
    for _ in range(draw(st.integers(1, 3))):
        text = draw(st.sampled_from([_lines, _insert, _replace_number, _whole]))(draw, text)
    raw = text.encode(errors="surrogatepass")
    if not draw(st.integers(0, 7)):
        at = draw(st.integers(0, len(raw)))
        raw = raw[:at] + draw(st.sampled_from(BYTES)) + raw[at:]
    return raw


cases = st.one_of(specs(), specs(), texts())
"""Contents of files, two in three from the spec classes."""

FAULT = "fault: "
"""How a finding begins that has to be mended; others are normal."""
CPU_S = 5.0
"""Longest time that the loading of a scenario may take [s]."""
PLACED = re.compile(r".*:\d+:\d+: \S.*")


def loading(raw: bytes, path: Path) -> str:
    """What comes of a file with this content: `loads`, `refused`, or a fault."""
    path.write_bytes(raw)
    began = time.process_time()
    try:
        loader.load(path)
        found = "loads"
    except ScenarioError as error:
        lost = [line for line in str(error).split("\n") if not PLACED.fullmatch(line)]
        found = f"{FAULT}no place: {lost[0].replace(str(path), path.name)}" if lost else "refused"
    except Exception as error:
        found = _bug(error)
    return found if time.process_time() - began < CPU_S else f"{FAULT}slow"


def running(raw: bytes, path: Path) -> str:
    """What comes of some frames of a file's scenario: `dear` where they would take too long, its
    outcome, or a fault.
    """
    path.write_bytes(raw)
    scenario = loader.load(path)
    period = scenario.camera.period
    shown = min(scenario.stop.duration_s, max(3 * period, min(1.0, 12 * period)))
    scenario = dataclasses.replace(
        scenario, stop=dataclasses.replace(scenario.stop, duration_s=shown)
    )
    pixels = sum(panel.lens.width * panel.lens.height for panel in scenario.camera.panels) * max(
        scenario.camera.multisampling, 1
    )
    timing = scenario.timing
    exposed = (
        2 * timing.readout_pictures
        if scenario.camera.readout_s
        else timing.exposure_pictures
        if timing.exposure_s
        else 1
    )
    if shown / scenario.clock[0] > 20_000 or pixels * exposed > 2e6:
        return "dear"
    try:
        recording = vs.run(scenario)
        faults = [*_not_numbers(recording), *_lies(recording)]
    except VstestbedError as error:
        return f"refused: {error}"
    except Exception as error:
        return _bug(error)
    return FAULT + ", ".join(faults) if faults else recording.outcome.name


def _bug(error: Exception) -> str:
    where = traceback.extract_tb(error.__traceback__)[-1]
    return f"{FAULT}{type(error).__name__} in {Path(where.filename).name}:{where.name}: {error}"[
        :300
    ]


UNKNOWN = re.compile(
    r"(u|v|u_true|v_true|u_goal|v_goal|depth|theta|phi)_\d+|error_px|level_error_px|touch_mps|est_(position_m|rotation_rad|x|y|heading)"
)
"""Columns that may be unknown: measured or estimated while nothing is seen, pixels outside the
lens's field of view, a landing to come.
"""


def _not_numbers(recording: vs.Recording) -> Iterator[str]:
    """Columns that hold no number where one is promised."""
    on_line = recording.scenario.target.painted_route is not None  # a line has no goal pose
    further = "|".join(map(re.escape, recording.scenario.cameras)) or "(?!)"
    # of a further camera, also before its first picture
    of_further = re.compile(rf"(?:{further})_(?:t|{UNKNOWN.pattern})")
    for name, column in zip(recording.columns, recording.table.T, strict=True):
        may = UNKNOWN.fullmatch(name) or of_further.fullmatch(name)
        may = may or (on_line and name in ("position_error_m", "rotation_error_rad"))
        if np.isinf(column).any() or (np.isnan(column).any() and not may):
            yield f"no number in {re.sub('[0-9]+', 'N', name)}"


def _lies(recording: vs.Recording) -> Iterator[str]:
    """A simulation that broke, and a success whose error is over its limit."""
    if recording.outcome is vs.Outcome.crashed:
        yield "crashed"
    summary = recording.summary()
    error, limit = summary["judged_error"], summary["judged_limit"]
    if recording.outcome is vs.Outcome.converged and not (
        isinstance(error, float) and isinstance(limit, float) and error < limit
    ):
        yield f"success with an error of {error}, limit {limit}"
