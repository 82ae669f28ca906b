"""What people and tools look for at the top of the repository: that it is there, can be read, and agrees with the rest."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from ruamel.yaml import YAML

TOP = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8"))
GITHUB = sorted((TOP / ".github").rglob("*.yml"))


@pytest.mark.parametrize("path", [TOP / "CITATION.cff", *GITHUB], ids=lambda path: path.name)
def test_files_for_tools_are_yaml(path: Path) -> None:
    assert isinstance(YAML(typ="safe").load(path), dict)


def test_the_citation_is_of_this_version() -> None:
    citation = YAML(typ="safe").load(TOP / "CITATION.cff")
    assert citation["version"] == PROJECT["project"]["version"]
    assert citation["license"] == PROJECT["project"]["license"]
    assert [author["name"] for author in citation["authors"]] == [re.search(r"\(c\) \d+ (.*)", (TOP / "LICENSE").read_text())[1]]


def test_the_workflow_tests_every_python_that_is_promised() -> None:
    jobs = YAML(typ="safe").load(TOP / ".github/workflows/ci.yml")["jobs"]
    promised = [c.rpartition(" ")[2] for c in PROJECT["project"]["classifiers"] if re.search(r"Python :: 3\.\d", c)]
    assert jobs["linux"]["strategy"]["matrix"]["python"] == promised


def test_what_the_contributors_page_installs_is_what_the_project_lists() -> None:
    listed = PROJECT["project"]["optional-dependencies"]["dev"]
    for name in re.findall(r"[\w\[\]-]+==[\d.]+", (TOP / "CONTRIBUTING.md").read_text(encoding="utf-8")):
        assert name in listed
