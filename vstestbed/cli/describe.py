"""What `describe` prints: equation, source, fields, use and an example of a kind or a block, in the
width of the terminal.
"""

from __future__ import annotations

import re
import shlex
import textwrap
import typing
from collections.abc import Iterator, Sequence

from rich.console import Console
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from vstestbed.core.errors import ParameterError, nearest
from vstestbed.core.fields import DIMENSIONLESS, SchemaField, class_text, fields, without_unit
from vstestbed.core.registry import Registry
from vstestbed.loop.columns import column_texts, text_of
from vstestbed.scenario.catalogue import (
    Entry,
    FieldPlace,
    bundled_uses,
    catalogue,
    example_block,
    examples_of,
    looked_up,
)
from vstestbed.scenario.dump import block_text, flow_text
from vstestbed.scenario.plugins import load_plugins
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.metrics import KNOWN, RUN_COLUMNS, own_metrics

_ITEM = re.compile(r"- |\d+\. |\S.{0,15}?  ")
"""The beginning of an item of a list, or of a row of definitions, whose few first words are set
off: `xn, yn, an     xg/sqrt(a)`.
"""


_WORD = re.compile(r"`[^`]*`\S*|\S*")
"""The first word of a line, or what stands in backquotes there, which stays in one piece."""
FILLED = 96
"""Columns that a class's docstring fills: the 100 of a line less its indentation."""


def described(kind: str, plugins: Sequence[str]) -> str:
    """All that is known of a word: a kind, a block, a field, or what a run's record holds. Raises
    ParameterError: there is no such word.
    """
    load_plugins(plugins)
    console = Console(highlight=False)
    with console.capture() as text:
        if kind in ("log", "summary", "table") or kind.startswith("log."):
            describe_record(kind, console)
        else:
            _describe_part(kind, console)
    return "\n".join(line.rstrip() for line in text.get().splitlines())


def _describe_part(kind: str, console: Console) -> None:
    """Print what is known of a part of a scenario, or of a comparison."""
    entries = catalogue(scenario=Scenario)
    try:
        found = looked_up(kind, entries)
    except ParameterError:
        # here: most words are of a scenario, and it takes 0.3 s to import
        from vstestbed.studies.comparison import Comparison

        entries = catalogue(scenario=Scenario, comparison=Comparison)
        found = looked_up(kind, entries)
    if isinstance(found, Entry):
        describe_entry(found, entries, console)
    else:
        describe_field(found, entries, console)


def describe_entry(entry: Entry, entries: dict[str, Entry], console: Console) -> None:
    """Print all that is known of an entry; `entries`: the whole catalogue, for the names of the
    blocks in it.
    """
    console.print(Text(entry.name, style="bold"))
    cls = entry.cls
    if cls is None:
        assert entry.registry is not None  # an entry has a class, or is a registry
        _kinds(entry, entry.registry, console)
        return
    _text(cls, console)
    console.print()
    table, names = _field_table("field"), _names(entries)
    # What makes it this kind comes before what all kinds have.
    for name in sorted(class_text(cls).fields, key=lambda name: name not in cls.__annotations__):
        if name != "kind":
            table.add_row(Text(name, style="cyan"), *_cells(cls, name, names))
    console.print(table)
    if entry.registry is not None and _common(entry.registry) is not None:
        console.print()
        _wrapped(
            f"vstestbed describe {entry.registry.what} has what all kinds have in common.", console
        )
    _use(entry, console)


def describe_record(word: str, console: Console) -> None:
    """Print what a run's record holds: `log` its columns, `log.NAME` one of them, `summary` the
    numbers of `summary.json`, and `table` the columns of `comparison.parquet`. Raises
    ParameterError: there is no such column.
    """
    console.print(Text(word, style="bold"))
    console.print()
    table = _columns_of_log(word) if word.startswith("log") else _numbers_of_runs(word)
    console.print(table)
    if word == "log":
        console.print()
        _wrapped(
            "An effect or a law may add columns of its own: vstestbed describe KIND says which.",
            console,
        )


def _columns_of_log(word: str) -> Table:
    """All columns of a log, or that of `log.NAME`."""
    if word == "log":
        found = list(column_texts())
    else:
        name = word.removeprefix("log.")
        one = text_of(name)
        if one is None:
            names = [each for text in column_texts() for each in text.shown.split(", ")]
            raise ParameterError.unknown(word, "column of a log", nearest(name, names))
        found = [one]
    table = _table("column", "unit", "of", "what it is")
    for text in found:
        shown = Text(text.shown, style="cyan")
        table.add_row(shown, Text(text.unit), Text(text.whose), Text(f"{text.words}."))
    return table


def _numbers_of_runs(word: str) -> Table:
    """The numbers of `summary.json`; of `table` what a row says besides."""
    table = _table("number", "shown in", "better", "what it is")
    if word == "table":
        for name, words in RUN_COLUMNS.items():
            table.add_row(Text(name, style="cyan"), Text(""), Text(""), Text(f"{words}."))
    for metric in (*KNOWN.values(), *own_metrics().values()):
        better = {1: "more", -1: "less", 0: ""}[metric.better]
        only = f"; only of {metric.where}" if metric.where else ""
        name = Text(metric.name, style="cyan")
        table.add_row(name, Text(metric.unit), Text(better), Text(f"{metric.title}{only}."))
    return table


def _text(cls: type, console: Console) -> None:
    words = class_text(cls)
    for paragraph in filter(
        None,
        [
            words.summary,
            *words.text.split("\n\n"),
            *(f"Source: {source}" for source in words.sources),
        ],
    ):
        console.print()
        for line in _lines(paragraph):
            _wrapped(line, console)


def _common(registry: Registry) -> type | None:
    """The block from which all kinds come, if it says more than what it is; None else."""
    return registry.base if registry.base is not None and class_text(registry.base).text else None


def describe_field(field: FieldPlace, entries: dict[str, Entry], console: Console) -> None:
    """Print a field: its sentence, default, unit and an example, and the blocks that have it; then
    the block that it holds.
    """
    names = _names(entries)
    console.print(Text(field.path, style="bold"))
    console.print()
    alike = _print_cells(field, names, console)
    console.print()
    if alike and "scenario" not in field.owners:
        _wrapped(f"A field of {', '.join(field.owners)}.", console)
    cls = next(iter(field.owners.values()))
    example = next(examples_of(cls, field.name, bundled_uses()), None)
    if example is not None:
        text = flow_text(example)
        setting = f"--set {shlex.quote(f'{field.path}={text}')}"
        _wrapped(f"Example: {setting if field.settable else f'{field.name}: {text}'}", console)
    held = {_inner(fields(owner)[field.name], names) for owner in field.owners.values()}
    if len(held) == 1 and (inner := held.pop()):
        console.print()
        describe_entry(entries[inner], entries, console)


def _print_cells(field: FieldPlace, names: dict[type, str], console: Console) -> bool:
    """One row where all blocks say the same of a field, else one for each that differs; whether
    they do.
    """
    rows: dict[tuple[str, ...], list[str]] = {}
    for name, owner in field.owners.items():
        said = tuple(map(str, _cells(owner, field.name, names)))
        rows.setdefault(said, []).append(name)
    alike = len(rows) == 1
    table = _field_table("field" if alike else "field of")
    for same in rows.values():
        title = Text(field.name if alike else "\n".join(same), style="cyan")
        table.add_row(title, *_cells(field.owners[same[0]], field.name, names))
    console.print(table)
    return alike


def _names(entries: dict[str, Entry]) -> dict[type, str]:
    return {e.cls: e.name for e in reversed(entries.values()) if e.cls is not None}


def _kinds(entry: Entry, registry: Registry, console: Console) -> None:
    table = _table("kind", "what it is")
    for kind, cls in registry.members.items():
        table.add_row(Text(kind, style="cyan"), Text(class_text(cls).summary))
    console.print(table)
    if (common := _common(registry)) is not None:
        _text(common, console)
    console.print()
    field = entry.field.removesuffix("[]")
    place = "" if field == registry.what else f" In a scenario the field is called {field}."
    _wrapped(
        (
            f"vstestbed describe {registry.what}.{next(iter(registry.members))} shows"
            f" one of them.{place}"
        ),
        console,
    )


def _lines(paragraph: str) -> Iterator[str]:
    """The lines of a paragraph as they are to be wrapped: those that a docstring's width has ended
    are joined.
    """
    whole = ""
    lines = paragraph.splitlines()
    for line, following in zip(lines, [*lines[1:], ""], strict=True):
        if whole and _ITEM.match(line):
            yield whole
            whole = ""
        whole = f"{whole} {line.strip()}" if whole else line
        # A line with room for the next word ends where its writer wanted it to end, as a line of an
        # equation does.
        word = next(_WORD.finditer(following.lstrip()))
        if len(line) + 1 + word.end() <= FILLED:
            yield whole
            whole = ""
    if whole:
        yield whole


def _wrapped(line: str, console: Console) -> None:
    number = re.match(r"- |\d+\. ", line)
    indent = (
        " " * len(number[0])
        if number
        else "  "
        if "  " in line or line.startswith(("Source:", "Used in:"))
        else ""
    )
    for part in textwrap.wrap(
        line,
        console.width,
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
    ):
        console.print(Text(part), soft_wrap=True)


def _table(*columns: str) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="bold")
    for column in columns:
        table.add_column(column, overflow="fold")
    table.columns[0].no_wrap = True
    return table


def _field_table(first: str) -> Table:
    table = _table(first, "default", "unit", "what it is")
    table.columns[1].max_width, table.columns[2].max_width = 16, 14
    table.columns[3].ratio = 1
    return table


def _cells(cls: type, name: str, names: dict[type, str]) -> tuple[Text, Text, Text]:
    text, field = class_text(cls).fields[name], fields(cls)[name]
    default = Text("required", style="yellow") if field.needed else Text(_default(field))
    words = Text(without_unit(text.description))
    choices = [str(word) for word in field.node.words]
    if not all(word in text.description for word in choices):
        words.append(f" One of {', '.join(choices)}.")
    if inner := _inner(field, names):
        words.append(f" See {inner}.", style="dim")
    return default, Text(text.unit if text.unit != DIMENSIONLESS else ""), words


def _default(field: SchemaField) -> str:
    """A default in few characters: of a block its kind,
    or the number that is a shorthand for it.
    """
    value = field.default
    if not isinstance(value, dict):
        return "none" if value is None else flow_text(value)
    for registry, _ in field.node.blocks():
        if registry is not None:
            kind, inner = registry.number or ("", "")
            return flow_text(value[inner]) if value["kind"] == kind else value["kind"]
    return ""


def _inner(field: SchemaField, names: dict[type, str]) -> str:
    """The name of the block, or of the list of kinds, that a field holds;
    "" where it holds none.
    """
    return next(
        (
            names[inner] if registry is None else registry.what
            for registry, inner in field.node.blocks()
        ),
        "",
    )


def _use(entry: Entry, console: Console) -> None:
    cls = typing.cast(type, entry.cls)
    uses = bundled_uses()
    files = uses.files.get(cls, [])
    console.print()
    key, block = uses.blocks.get(cls, (entry.field, None))
    if files:
        _wrapped(f"Used in: {', '.join(files)}", console)
        console.print()
    title = f"Example, from {files[0]}:" if files else "Example:"
    if key == "scenario":
        _wrapped("Example: vstestbed list scenarios has them all.", console)
        return
    shown = example_block(cls, uses) if block is None else block
    while key.endswith("[]"):
        key, shown = key[:-2], [shown]
    console.print(title)
    text = (
        block_text({key: shown}, console.width - 6)
        if isinstance(shown, dict | list)
        else f"{key}: {flow_text(shown)}"
    )
    console.print(Padding(Text(text, style="green"), (0, 0, 0, 2)), soft_wrap=True)
