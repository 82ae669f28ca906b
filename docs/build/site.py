"""A hook of mkdocs (`docs/mkdocs.yml`): what the site has beside the pages of `docs/`.

The pages of the repository outside that folder, the files to which pages link, a page of each
bundled scenario (with film and report where `vstestbed run NAME` has left them in `runs/`), and the
reference of names, kinds and fields.
"""

from __future__ import annotations

import html
import json
import os
import posixpath
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File

from docs.build.kept import REPOSITORY, place_of, read
from docs.build.marks import shown
from docs.build.render import judged
from vstestbed.cli.describe import _default
from vstestbed.core.fields import DIMENSIONLESS, class_text, fields, without_unit
from vstestbed.core.named_files import bundled_scenarios
from vstestbed.scenario.catalogue import Entry, catalogue
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.yaml_marks import bundled_mapping
from vstestbed.studies.comparison import Comparison

PAGES = {
    "README.md": "index.md",
    "docs/README.md": "documentation.md",  # mkdocs would make a second index of it
    "scenarios/README.md": "scenarios/README.md",
    "models/README.md": "models.md",
    "tests/README.md": "accuracy.md",
    "vstestbed/README.md": "rooms.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changes.md",
    **{
        f"scenarios/{path.name}": f"scenarios/{name}.md"
        for name, path in bundled_scenarios().items()
    },
}
"""Pages outside `docs/`, and scenarios, by their places in the repository and on the site."""
NOTEBOOKS = sorted((REPOSITORY / "docs" / "notebooks").glob("*.ipynb"))
FILES = "files"  # folder of the site with the other files of the repository to which pages link
LINK = re.compile(r"(?<=\]\()([^)\s]+)(?=\))")
FILMS = {"overview.mp4": "From outside", "camera.mp4": "What the camera sees"}


def on_config(config: Any) -> Any:
    """Name the pages of scenarios and kinds in the navigation, which `mkdocs.yml` leaves open with
    `scenarios` and `kinds`.
    """
    open_ends = {
        "scenarios": [f"scenarios/{name}.md" for name in bundled_scenarios()],
        "kinds": list(kind_pages()),
    }

    def filled(nav: Any) -> Any:
        if isinstance(nav, dict):
            return {
                title: open_ends[inner]
                if isinstance(inner, str) and inner in open_ends
                else filled(inner)
                for title, inner in nav.items()
            }
        return [filled(each) for each in nav] if isinstance(nav, list) else nav

    config.nav = filled(config.nav)
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add what is outside `docs/`, and what is made here."""
    pages = {f"docs/{file.src_uri}" for file in files.documentation_pages()} | {
        path for path in PAGES if path.endswith(".md")
    }
    made = {
        uri: (REPOSITORY / path).read_text(encoding="utf-8")
        for path, uri in PAGES.items()
        if path in pages
    }
    made |= {
        f"scenarios/{name}.md": scenario_page(name, path)
        for name, path in bundled_scenarios().items()
    }
    made |= {
        f"notebooks/{path.stem}.md": notebook_page(path, config.repo_url or "")
        for path in NOTEBOOKS
    }
    made |= kind_pages() | {"reference/python.md": python_page()}
    for uri, text in made.items():
        files.append(File.generated(config, uri, content=text))
    linked = {
        target
        for path in sorted(pages)
        for target in _targets(path, (REPOSITORY / path).read_text(encoding="utf-8"))
    }
    copies = {f"{FILES}/{path}": REPOSITORY / path for path in linked if _is_other(path, pages)}
    copies |= {
        f"scenarios/{name}/{file.name}": file for name in bundled_scenarios() for file in _ran(name)
    }
    for uri, place in copies.items():
        files.append(File.generated(config, uri, abs_src_path=str(place)))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """The page without its marks; links between the repository's files become links between the
    site's.
    """
    here = posixpath.dirname(page.file.src_uri)
    inside = {uri: path for path, uri in PAGES.items()}.get(
        page.file.src_uri, f"docs/{page.file.src_uri}"
    )

    def changed(found: re.Match[str]) -> str:
        target, anchor = _target(inside, found[1])
        if target is None:
            return found[1]
        within = target.removeprefix("docs/")
        if not here.startswith("notebooks"):  # a notebook's page links to the file itself
            within = within.replace(".ipynb", ".md")
        uri = PAGES.get(target) or (
            within if files.get_file_from_path(within) else f"{FILES}/{target}"
        )
        # a folder is none of the site
        known = files.get_file_from_path(uri) is not None
        return (
            os.path.relpath(uri, here or ".").replace(os.sep, "/") + anchor if known else found[1]
        )

    return (
        markdown
        if page.file.src_uri.startswith(("reference/", "scenarios/")) and inside not in PAGES
        else LINK.sub(changed, shown(markdown))
    )


def _is_other(path: str, pages: Iterable[str]) -> bool:
    """Whether a link leads to a file that is on the site neither as a page nor as a picture."""
    return (
        path not in pages
        and path not in PAGES
        and not path.startswith("docs/media/")
        and (REPOSITORY / path).is_file()
    )


def _targets(inside: str, text: str) -> Iterator[str]:
    for link in LINK.findall(text):
        target, _ = _target(inside, link)
        if target is not None:
            yield target


def _target(inside: str, link: str) -> tuple[str | None, str]:
    """Place in the repository that a link of a page leads to, and its anchor; None for a link
    elsewhere, or within the page.
    """
    path, mark, anchor = link.partition("#")
    if not path or re.match(r"[a-z]+:|/", path):
        return None, ""
    return posixpath.normpath(posixpath.join(posixpath.dirname(inside), path)), mark + anchor


# A page of each scenario.
def scenario_page(name: str, path: Path) -> str:
    """What it shows, how it ends, its film and report where it has been run, and its file."""
    lines = [
        f"# {name}",
        "",
        str(bundled_mapping(path)["description"]),
        "",
        f"    vstestbed run {name}",
        "",
    ]
    if (kept := place_of(f"run {name}")).is_file():
        it = read(kept)
        lines += [
            "| ends as | after [s] | judged error (its limit) |",
            "|---|---|---|",
            f"| `{it['outcome']}` | {it['sim_time_s']:.1f} | {judged(it)} |",
            "",
        ]
    there = {file.name for file in _ran(name)}
    for film, words in FILMS.items():
        if film in there:
            lines += [
                f"## {words}",
                "",
                (
                    '<video controls muted loop preload="metadata" width="100%"'
                    f' src="{name}/{film}"></video>'
                ),
                "",
            ]
    if "report.html" in there:
        lines += [f'<a class="md-button" href="{name}/report.html">The report of this run</a>', ""]
    return "\n".join(
        [*lines, "## Its file", "", "```yaml", path.read_text(encoding="utf-8").rstrip(), "```", ""]
    )


def _ran(name: str) -> list[Path]:
    """Films and report of the last run of a scenario in this checkout; nothing where it was not
    run.
    """
    runs = sorted((REPOSITORY / "runs" / name).glob("[0-9]*/report.html"))
    return (
        [runs[-1], *(file for film in FILMS if (file := runs[-1].with_name(film)).is_file())]
        if runs
        else []
    )


# A page of each notebook.
def notebook_page(path: Path, repository: str) -> str:
    """Its words and code, and its figures and tables where it has been executed
    (`docs.build.notebooks`).
    """
    done = REPOSITORY / "runs" / "notebooks" / path.name
    cells = json.loads((done if done.is_file() else path).read_text(encoding="utf-8"))["cells"]
    links = [f"[Download the notebook]({path.name})"]
    if repository:
        address = repository.replace(
            "https://github.com/", "https://colab.research.google.com/github/"
        )
        badge = "https://colab.research.google.com/assets/colab-badge.svg"
        links.append(f"[![Open in Colab]({badge})]({address}/blob/main/docs/notebooks/{path.name})")
    first, *rest = cells
    lines = ["".join(first["source"]), "", " ".join(links), ""]
    for cell in rest:
        source = "".join(cell["source"])
        lines += (
            [source, ""] if cell["cell_type"] == "markdown" else ["```python", source, "```", ""]
        )
        lines += [line for output in cell.get("outputs", ()) for line in _shown(output)]
    return (
        "\n".join(lines)
        .replace(".ipynb)", ".md)")
        .replace(f"({path.stem}.md)", f"({path.name})", 1)
    )


def _shown(output: dict[str, Any]) -> list[str]:
    """What a cell printed or drew; a report is too large for a page."""
    if "image/png" in output.get("data", {}):
        return [
            (
                '<img alt="figure"'
                f' src="data:image/png;base64,{"".join(output["data"]["image/png"]).strip()}">'
            ),
            "",
        ]
    return (
        ["```text", "".join(output["text"]).rstrip(), "```", ""]
        if output["output_type"] == "stream"
        else []
    )


# The reference.
def python_page() -> str:
    """The public names of `import vstestbed as vs`, by the rooms that they come from; mkdocstrings
    writes what each is.
    """
    import vstestbed as vs

    words = (
        "`import vstestbed as vs` has these names."
        " [A scenario in Python](../guides/python.md) shows how they go together."
    )
    homes: dict[str, tuple[str, ...]] = vs._HOMES
    names = [
        f"{home}.{name}"
        for home, names in homes.items()
        for name in names
        if not name.isupper() and name != "Array"
    ]
    return "\n".join(
        ["# Python", "", words, "", *(line for name in names for line in (f"::: {name}", ""))]
    )


def kind_pages() -> dict[str, str]:
    """Every kind and block with its equation, source and fields, as `vstestbed describe` has them:
    a page for each list of kinds.
    """
    entries = catalogue(scenario=Scenario, comparison=Comparison).values()
    names = {entry.cls: entry.name for entry in reversed(list(entries)) if entry.cls is not None}
    found: dict[str, list[str]] = {}
    for entry in entries:
        lines = found.setdefault(
            _page_of(entry.name), [f"# {_page_of(entry.name).capitalize()}", ""]
        )
        lines += _kind_list(entry) if entry.cls is None else _block(entry, names)
    return {f"reference/{page}.md": "\n".join(lines) for page, lines in found.items()}


def _page_of(name: str) -> str:
    """`law` for `law`, `law.ibvs` and `law.solve`."""
    return name.partition(".")[0]


def _kind_list(entry: Entry) -> list[str]:
    assert entry.registry is not None
    rows = [
        f"| {_link(f'{entry.name}.{kind}', kind)} | {_cell(class_text(cls).summary)} |"
        for kind, cls in entry.registry.members.items()
    ]
    words = (
        ["| kind | what it is |", "|---|---|", *rows]
        if rows
        else ["None is bundled: plugins add them."]
    )
    return [*words, ""]


def _block(entry: Entry, names: dict[type, str]) -> list[str]:
    assert entry.cls is not None
    text = class_text(entry.cls)
    lines = [f"## {entry.name} {{ #{_anchor(entry.name)} }}", "", _plain(text.summary), ""]
    for paragraph in filter(None, text.text.split("\n\n")):
        lines += [
            f"```text\n{paragraph}\n```" if paragraph.startswith(" ") else _plain(paragraph),
            "",
        ]
    rows = []
    for name, field in fields(entry.cls).items():
        if name == "kind":
            continue
        words, held = (
            text.fields[name],
            [
                names.get(inner) if registry is None else registry.what
                for registry, inner in field.node.blocks()
            ],
        )
        see = "".join(f" See {_link(word)}." for word in dict.fromkeys(held) if word)
        unit, default = (
            "" if words.unit == DIMENSIONLESS else words.unit,
            "" if field.needed else _default(field),
        )
        rows.append(
            f"| `{name}` | {_cell(default)} | {_cell(unit)} |"
            f" {_cell(without_unit(words.description))}{see} |"
        )
    table = (
        ["| field | default | unit | what it is |", "|---|---|---|---|", *rows, ""] if rows else []
    )
    return [*lines, *table, *(f"Source: {_plain(source)}\n" for source in text.sources)]


def _link(name: str, words: str = "") -> str:
    """To a block or a list of kinds, from any page of the reference."""
    return f"[`{words or name}`]({_page_of(name)}.md{f'#{_anchor(name)}' if '.' in name else ''})"


def _anchor(name: str) -> str:
    return re.sub(r"[._]", "-", name).lower()


def _cell(text: str) -> str:
    return _plain(text).replace("|", "\\|").replace("\n", " ")


def _plain(text: str) -> str:
    """Words in which Markdown is to see nothing but `code`: s* is no emphasis, and < no element."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(
        part
        if part.startswith("`")
        else re.sub(r"([*_\[\]])", r"\\\1", html.escape(part, quote=False))
        for part in parts
    )
