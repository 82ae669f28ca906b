"""The notebooks: whole, without kept outputs, with links that lead somewhere;
as a study, executed.
"""

from __future__ import annotations

import ast
import json
import re
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "docs" / "notebooks").glob("*.ipynb"))


def cells(path: Path, kind: str) -> list[str]:
    return [
        "".join(cell["source"])
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]
        if cell["cell_type"] == kind
    ]


def test_each_is_code_that_parses_and_says_where_it_belongs() -> None:
    assert len(NOTEBOOKS) == 10
    for path in NOTEBOOKS:
        code, words = cells(path, "code"), cells(path, "markdown")
        assert "pip install" in code[0] and words[0].startswith("# ")
        for cell in code:
            ast.parse(re.sub(r"^( *)%.*$", r"\1pass", cell, flags=re.MULTILINE))
        for link in re.findall(r"\]\((?![a-z]+:)([^)#]+)", "\n".join(words)):
            assert (path.parent / link).is_file(), (path.name, link)


def test_none_keeps_what_a_machine_of_one_day_printed() -> None:
    for path in NOTEBOOKS:
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
            assert not cell.get("outputs") and cell.get("execution_count") is None


@pytest.mark.study
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_each_runs_from_its_first_cell_to_its_last(path: Path, tmp_path: Path) -> None:
    pytest.importorskip("nbclient", reason="the extra docs runs notebooks")
    from docs.build.notebooks import execute

    execute(path, tmp_path / path.name)
    done = json.loads((tmp_path / path.name).read_text(encoding="utf-8"))
    assert (
        sum(
            "image/png" in output.get("data", {})
            for cell in done["cells"]
            for output in cell.get("outputs", ())
        )
        > 0
    )
