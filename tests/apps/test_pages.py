"""The pages: their rendered parts are those of the kept results; their commands parse, their
scenarios exist, their links lead somewhere.
"""

from __future__ import annotations

import os
import re
import shlex
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import polars as pl
import pytest
import typer.main
from typer.testing import CliRunner

import vstestbed as vs
from docs.build.kept import FOLDER, REPOSITORY, Kept, place_of
from docs.build.marks import MARK, differences, filled, shown
from docs.build.pages import environment, pages
from docs.build.suite import PLACE, Suite
from tests.scenario.schemas import whole_schema
from vstestbed.cli.app import program
from vstestbed.cli.options import settings_of
from vstestbed.core.named_files import bundled_scenarios

TEXTS = {page: (REPOSITORY / page).read_text(encoding="utf-8") for page in pages()}
PAGES = {page: shown(text) for page, text in TEXTS.items()}
"""What a reader sees of each."""
READ = [page for page in PAGES if page.name not in ("CHANGELOG.md", "CONTRIBUTING.md")]
"""Their commands are carried out: not those of the history, nor those with a contributor's own
names.
"""
COMMANDS: Any = typer.main.get_command(program())
WHOLE = {"list", "schema", "doctor"}
"""Commands that need no more words; others without any are spoken of, not given."""
SHORT = {"list", "schema", "describe", "doctor"}
"""Commands that take a second; those of the pages are carried out."""
NOT_LITERAL = re.compile(r"`[^`]*`|\]\([^)]*\)")
"""What is no literal number in a line: code, links."""
RENDERED = re.compile(
    r"^<!-- build.*?^<!-- end -->\n|<!--[a-z][\w.]*-->.*?<!--/-->", re.MULTILINE | re.DOTALL
)


def commands(text: str) -> Iterator[list[str]]:
    """The vstestbed commands of a page: lines of code, and `code` that begins with the word;
    without comments and redirections.
    """
    text = text.replace("\\\n", " ")
    shown = re.findall(r"^(?:    )?(vstestbed .*)$", text, re.MULTILINE) + re.findall(
        r"`(vstestbed [^`]+)`", text.replace("\n", " ")
    )
    for line in shown:
        if not re.search(r"\.\.\.|[A-Z]{3,}|\|", line):  # a pattern of a command, not a command
            words = shlex.split(line.partition(" > ")[0].partition(";")[0], comments=True)[1:]
            if len(words) > 1 or words[0] in WHOLE or words[0].startswith("-"):
                yield words


def test_rendered_parts_are_what_the_kept_results_give_and_no_result_is_left_over() -> None:
    kept = Kept(may_run=False)
    known, other = environment(kept), list[str]()
    for page, text in TEXTS.items():
        other += differences(page, text, filled(text, known))
    assert not other, "\n".join(["python -m docs.build fills these anew:", *other])
    places = [place_of(command) for command in kept.used]
    assert len(places) == len(set(places)) and set(places) == set(FOLDER.glob("*.json"))


def test_no_line_begins_with_the_mark_of_a_value_since_it_would_be_html_to_its_end() -> None:
    for page, text in TEXTS.items():
        assert not re.findall(r"^ *<!--(?:[a-z][\w.]*|/)-->.*", text, re.MULTILINE), page


def test_no_block_stands_within_a_list_or_a_paragraph_which_it_would_end() -> None:
    for page, text in TEXTS.items():
        before = re.findall(r"^(.*)\n<!-- (?:values|build)\b", text, re.MULTILINE)
        assert not [line for line in before if line and not re.search(r"^#|-->$", line)], page


def sentences(text: str) -> Iterator[str]:
    """The sentences of a page's paragraphs, of 60 characters or more; without code, tables,
    headings, pictures and comments.
    """
    prose = re.sub(
        r"<!--.*?-->|^```.*?^```|^(?: {4}|\||#|!\[).*?$", "", text, flags=re.MULTILINE | re.DOTALL
    )
    for paragraph in re.split(r"\n\s*\n", prose):
        yield from (
            one for one in re.split(r"(?<=[.:;])\s+", " ".join(paragraph.split())) if len(one) >= 60
        )


def test_no_sentence_stands_twice_as_after_a_merge_that_kept_both_sides() -> None:
    for page, text in PAGES.items():
        found = Counter(sentences(text))
        assert not {one for one, times in found.items() if times > 1}, page


def test_files_that_the_page_of_the_code_names_are_there() -> None:
    package = REPOSITORY / "vstestbed"
    named = re.findall(
        r"`([a-z_]+/[\w/]+\.py)`", (package / "README.md").read_text(encoding="utf-8")
    )
    assert len(named) > 50
    assert not [
        name
        for name in named
        if not (package / name).is_file() and not (REPOSITORY / name).is_file()
    ]


def test_decimals_in_a_table_are_made_by_a_command_or_said_to_be_given() -> None:
    """Above a table with literal decimals stands `<!-- given ... -->`: inputs, not results; or
    `<!-- held by tests -->`. Of the pages with rendered parts.
    """
    for paragraph in (
        paragraph
        for text in TEXTS.values()
        if MARK.search(text)
        for paragraph in RENDERED.sub("", text).split("\n\n")
    ):
        rows = [line for line in paragraph.splitlines() if line.startswith("|")]
        literal = [row for row in rows if re.search(r"(?<![\w.])\d*\.\d", NOT_LITERAL.sub("", row))]
        assert not literal or "<!-- given" in paragraph or "<!-- held by" in paragraph, literal
        for row in rows[2:] if "<!-- held by tests -->" in paragraph else ():
            files = re.findall(r"`([\w/]+\.py)`", row)
            assert files and all((REPOSITORY / "tests" / file).is_file() for file in files), row


def test_commands_of_the_pages_parse_and_their_scenarios_exist() -> None:
    for name, *rest in {tuple(words) for page in READ for words in commands(PAGES[page])}:
        if name.startswith("-"):
            continue
        assert name in COMMANDS.commands, f"no command {name}"
        given = COMMANDS.commands[name].make_context(name, list(rest)).params
        plain = given.get("scenario")
        if (
            isinstance(plain, str)
            and name == "run"
            and not given.get("plugin")
            and "." not in plain
        ):
            vs.load(plain, settings_of(given.get("set_")))


@pytest.mark.opengl
def test_short_commands_of_the_pages_do_what_they_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    # made once for all tests
    monkeypatch.setattr("vstestbed.scenario.catalogue.schema_of", whole_schema)
    given = {tuple(words) for page in READ for words in commands(PAGES[page])}
    found = {
        words for words in given if words[0] in SHORT and not words[-1].endswith((".xml", ".py"))
    }
    assert found
    for words in sorted(found):
        done = CliRunner().invoke(program(), list(words))
        assert done.exit_code == 0, (words, done.output)


def test_links_of_the_pages_lead_somewhere() -> None:
    texts = {page: re.sub(r"```.*?```", "", text, flags=re.DOTALL) for page, text in PAGES.items()}
    for page, link in (
        (page, link)
        for page, text in texts.items()
        for link in re.findall(r"\]\(([^)\s]+)\)", text)
    ):
        file, _, place = link.partition("#")
        if not link.startswith(("http://", "https://")):
            there = (REPOSITORY / page).parent / file if file else REPOSITORY / page
            assert there.exists(), (page, link)
            aim = there.read_text(encoding="utf-8") if place else ""
            headings = {
                re.sub(r"[^\w\- ]", "", h.lower()).replace(" ", "-")
                for h in re.findall(r"^#+ (.*)$", aim, re.MULTILINE)
            }
            assert not place or place in headings | set(re.findall(r'<a id="([^"]+)">', aim)), (
                page,
                link,
            )


def test_every_page_is_in_the_index_and_has_a_way_back() -> None:
    index = PAGES[Path("docs/README.md")]
    for page, text in PAGES.items():
        if page.parts[0] in ("docs", "scenarios", "models") and page != Path("docs/README.md"):
            back = text.splitlines()[2]
            assert re.fullmatch(r"\[\w+\]\((\.\./)+(docs/)?README\.md(#\w+)?\)", back), (page, back)
            assert f"({Path(os.path.relpath(page, 'docs')).as_posix()})" in index, page


def test_the_first_pages_are_short() -> None:
    for page, lines in (("README.md", 160), ("docs/README.md", 100)):
        assert len(PAGES[Path(page)].splitlines()) <= lines


def test_every_bundled_scenario_is_on_the_page_of_scenarios() -> None:
    page = PAGES[Path("scenarios/README.md")]
    assert not [name for name in bundled_scenarios() if f"[`{name}`]({name}.yaml)" not in page]


def test_the_page_of_the_suite_says_whether_its_runs_are_of_a_former_flight() -> None:
    suite, page = Suite(), PAGES[Path("docs/research/suite.md")]
    assert ("The numbers on this page are of a former flight" in page) == suite.former
    assert ("**4. The published network of CNS" in page) == suite.beside()


def test_the_suite_s_scores_are_those_of_its_kept_runs():
    found = {(s.law, s.task): s for s in Suite().scores}
    there = pl.read_csv(PLACE / "scores.csv")
    assert len(there) == len(found)
    for row in there.iter_rows(named=True):
        score = found[row["law"], row["task"]]
        assert (row["reached"], row["runs"]) == (
            round(score.rate.mean * score.rate.n),
            score.rate.n,
        )
        assert (
            row["value_mean"] == pytest.approx(score.value.mean)
            and row["rank_mean"] == score.rank.mean
        )
    assert all(
        (PLACE / name).stat().st_size
        for name in ("report.html", "ranks.png", "profile.png", "scores.tex", "cns.csv")
    )
