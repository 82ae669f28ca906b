"""What people and tools look for at the top of the repository: that it is there, can be read, and
agrees with the rest.
"""

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
    assert [author["name"] for author in citation["authors"]] == [
        re.search(r"\(c\) \d+ (.*)", (TOP / "LICENSE").read_text())[1]
    ]


def test_the_workflow_tests_every_python_that_is_promised() -> None:
    jobs = YAML(typ="safe").load(TOP / ".github/workflows/ci.yml")["jobs"]
    promised = [
        c.rpartition(" ")[2]
        for c in PROJECT["project"]["classifiers"]
        if re.search(r"Python :: 3\.\d", c)
    ]
    assert jobs["linux"]["strategy"]["matrix"]["python"] == promised


WORKFLOWS = sorted((TOP / ".github/workflows").glob("*.yml"))
MAY_WRITE = {
    ("publish.yml", "publish"): {"id-token": "write"},
    ("site.yml", "publish"): {"pages": "write", "id-token": "write"},
}
"""The jobs that may do more than read: each publishes what another one has built, and runs nothing
of it.
"""


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_workflows_take_actions_by_their_hash_and_may_only_read(path: Path) -> None:
    """A tag can be moved to other code; the commit of a version cannot. Its version stands beside
    it, for whoever renews it.
    """
    text = path.read_text(encoding="utf-8")
    used = [line.strip() for line in text.splitlines() if re.search(r"\buses:", line)]
    assert (
        used
        and [
            line
            for line in used
            if not re.fullmatch(
                r"(- )?uses: [\w.-]+(/[\w.-]+)+@[0-9a-f]{40} # v\d+\.\d+\.\d+", line
            )
        ]
        == []
    )
    workflow = YAML(typ="safe").load(text)
    assert workflow["permissions"] == {"contents": "read"}
    asked = {
        (path.name, name): job["permissions"]
        for name, job in workflow["jobs"].items()
        if "permissions" in job
    }
    assert asked == {place: rights for place, rights in MAY_WRITE.items() if place[0] == path.name}
    assert not any("run" in step for _, name in asked for step in workflow["jobs"][name]["steps"])


def test_one_action_has_one_hash() -> None:
    found = {
        match
        for path in WORKFLOWS
        for match in re.findall(r"uses: ([\w/.-]+)@(\S+)", path.read_text(encoding="utf-8"))
    }
    assert len(found) == len({action for action, _ in found})


def test_the_workflow_of_strangers_code_has_nothing_to_give_away() -> None:
    """It runs laws of pull requests: no secrets, no token in a file, no cache, and the judge is not
    of the pull request.
    """
    text = (TOP / ".github/workflows/suite.yml").read_text(encoding="utf-8")
    workflow = YAML(typ="safe").load(text)
    on = workflow.get("on", workflow.get(True))  # YAML 1.1 reads the word as yes
    assert list(on) == ["pull_request"] and "secrets" not in text and "cache:" not in text
    steps = [step for job in workflow["jobs"].values() for step in job["steps"]]
    taken = [step["with"] for step in steps if step.get("uses", "").startswith("actions/checkout@")]
    assert all(given["persist-credentials"] is False for given in taken)
    assert {given.get("path", ""): given.get("ref", "") for given in taken} == {
        "": "${{ github.event.pull_request.base.sha }}",
        "handed_in": "",
    }
    # what strangers name is never part of a command
    assert not any("${{" in step.get("run", "") for step in steps)


def test_what_the_contributors_page_installs_is_what_the_project_lists() -> None:
    listed = PROJECT["project"]["optional-dependencies"]["dev"]
    for name in re.findall(
        r"[\w\[\]-]+==[\d.]+", (TOP / "CONTRIBUTING.md").read_text(encoding="utf-8")
    ):
        assert name in listed
