"""A hook of mkdocs (`docs/mkdocs.yml`): pages of the repository outside `docs/`, links to its other files, and the reference of kinds."""

from __future__ import annotations

import os
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[2]
PAGES = {
    "README.md": "index.md",
    "scenarios/README.md": "scenarios.md",
    "models/README.md": "models.md",
    "tests/README.md": "accuracy.md",
    "vstestbed/README.md": "rooms.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changes.md",
}
"""Pages outside `docs/` by their places in the repository, and on the site."""
FILES = "files"  # folder of the site with files of the repository to which pages link
LINK = re.compile(r"(?<=\]\()([^)\s]+)(?=\))")
FENCE = re.compile(r"^( {4}|```)", re.MULTILINE)


def on_files(files: Any, config: Any) -> Any:
    """Add the pages outside `docs/`, the pages of the reference, and every file to which a page links."""
    pages = {f"docs/{file.src_uri}": file.src_uri for file in files.documentation_pages()} | PAGES
    for inside, uri in PAGES.items():
        files.append(File.generated(config, uri, content=(ROOT / inside).read_text(encoding="utf-8")))
    for uri, text in (("reference/kinds.md", kinds_page()), ("reference/python.md", python_page())):
        files.append(File.generated(config, uri, content=text))
    for inside in pages:
        for target in _targets(inside, (ROOT / inside).read_text(encoding="utf-8")):
            uri = f"{FILES}/{target}"
            if target not in pages and (ROOT / target).is_file() and not target.startswith("docs/media/") and files.get_file_from_path(uri) is None:
                files.append(File.generated(config, uri, abs_src_path=str(ROOT / target)))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Links between the repository's files become links between the site's."""
    inside = {uri: path for path, uri in PAGES.items()}.get(page.file.src_uri, f"docs/{page.file.src_uri}")
    here = posixpath.dirname(page.file.src_uri)

    def changed(found: re.Match[str]) -> str:
        target, anchor = _target(inside, found[1])
        if target is None:
            return found[1]
        uri = PAGES.get(target) or (target.removeprefix("docs/") if files.get_file_from_path(target.removeprefix("docs/")) else f"{FILES}/{target}")
        if files.get_file_from_path(uri) is None:  # a folder, which is none of the site
            return found[1]
        return os.path.relpath(uri, here or ".").replace(os.sep, "/") + anchor

    return LINK.sub(changed, markdown)


def _targets(inside: str, text: str) -> Iterator[str]:
    for link in LINK.findall(text):
        target, _ = _target(inside, link)
        if target is not None:
            yield target


def _target(inside: str, link: str) -> tuple[str | None, str]:
    """Place in the repository that a link of a page leads to, and its anchor; None for a link elsewhere, or within the page."""
    path, mark, anchor = link.partition("#")
    if not path or re.match(r"[a-z]+:|/", path):
        return None, ""
    return posixpath.normpath(posixpath.join(posixpath.dirname(inside), path)), mark + anchor


def python_page() -> str:
    """The public names of `import vstestbed as vs`, by the rooms that they come from; mkdocstrings writes what each is."""
    import vstestbed as vs

    lines = ["# Python", "", "`import vstestbed as vs` has these names. [A scenario in Python](../guides/python.md) shows how they go together.", ""]
    homes: dict[str, list[str]] = vs._HOMES  # noqa: SLF001 - the table of contents of the package
    for home, names in homes.items():
        for name in names:
            if not name.isupper() and name != "Array":
                lines += [f"::: {home}.{name}", ""]
    return "\n".join(lines)


def kinds_page() -> str:
    """Every kind and block of a scenario with its equation, source and fields: `vstestbed describe` as one page."""
    from vstestbed.scenario.catalogue import catalogue
    from vstestbed.scenario.scenario import Scenario
    from vstestbed.studies.comparison import Comparison

    entries = catalogue(scenario=Scenario, comparison=Comparison)
    words = "Every block and kind of a scenario, of a comparison, and their fields; `vstestbed describe NAME` prints the same in a terminal."
    lines = ["# Kinds and fields", "", words, ""]
    names = {entry.cls: entry.name for entry in reversed(entries.values()) if entry.cls is not None}
    for entry in entries.values():
        lines += _kind_list(entry) if entry.cls is None else _block(entry, names)
    return "\n".join(lines)


def _kind_list(entry: Any) -> list[str]:
    from vstestbed.core.fields import class_text

    rows = [f"| [`{kind}`](#{_anchor(f'{entry.name}.{kind}')}) | {_cell(class_text(cls).summary)} |" for kind, cls in entry.registry.members.items()]
    return [f"## {entry.name} {{ #{_anchor(entry.name)} }}", "", *(["| kind | what it is |", "|---|---|", *rows] if rows else ["None is bundled."]), ""]


def _block(entry: Any, names: dict[type, str]) -> list[str]:
    from vstestbed.core.fields import DIMENSIONLESS, class_text, fields, without_unit

    text = class_text(entry.cls)
    level = "###" if entry.registry is not None else "##"
    lines = [f"{level} {entry.name} {{ #{_anchor(entry.name)} }}", "", text.summary, ""]
    lines += [paragraph if not paragraph.startswith(" ") else f"```text\n{paragraph}\n```" for paragraph in text.text.split("\n\n") for paragraph in (paragraph, "")]
    rows = []
    for name, field in fields(entry.cls).items():
        words = text.fields[name]
        held = [names.get(inner) if registry is None else registry.what for registry, inner in field.node.blocks()]
        see = "".join(f" See [{word}](#{_anchor(word)})." for word in dict.fromkeys(held) if word)
        default = "" if field.needed else _default(field)
        unit = words.unit if words.unit != DIMENSIONLESS else ""
        if name != "kind":
            rows.append(f"| `{name}` | {_cell(default)} | {_cell(unit)} | {_cell(without_unit(words.description))}{see} |")
    if rows:
        lines += ["| field | default | unit | what it is |", "|---|---|---|---|", *rows, ""]
    return lines + [f"Source: {source}\n" for source in text.sources]


def _default(field: Any) -> str:
    from vstestbed.cli.describe import _default as shown

    return shown(field)


def _anchor(name: str) -> str:
    return name.replace(".", "-").replace("_", "-").lower()


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("<", "&lt;").replace("\n", " ")
