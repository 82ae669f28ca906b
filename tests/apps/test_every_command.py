"""Every command on every bundled scenario and comparison, in its smallest form: it ends with an
outcome, or with a sentence.

Commands, their arguments and options are those of the command line itself, and what an argument may
be is what a shell would offer for it: a new command, scenario or kind is covered without a word
here. Folders that commands leave are given to those that take one.

    python -m pytest -s -m study tests/apps/test_every_command.py
        # VSTESTBED_CODES=FILE keeps the codes, one a line
"""

from __future__ import annotations

import itertools
import json
import os
import re
import signal
import subprocess
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import typer

from tests.apps.suite.test_suite import OWN, PLAN
from tests.conftest import Ended
from tests.laws.onnx_file import linear
from tests.laws.test_policy import HOMES
from tests.robots.arms import where_installed
from vstestbed.cli.app import program
from vstestbed.core.named_files import bundled_comparisons, bundled_scenarios
from vstestbed.studies.comparison.plan import read_comparison

pytestmark = [pytest.mark.study, pytest.mark.usefixtures("here", "own_kinds")]

SMALLEST = {
    "--set": "stop.duration_s=.2",
    "--seeds": "1",
    "--jobs": "1",
    "--trials": "1",
    "--batch": "1",
    "--check": "0",
    "--repeats": "1",
    "--n": "2",
    "--frames": "0",
    "--video": "none",
    "--no-film": "",
    "--no-open": "",
    "--x": "x=-0.1:0.1",
    "--y": "y=-0.1:0.1",
    "--suite": "",  # set by `small_suite`: the bundled one flies for hours
}
"""Options of the smallest form, wherever a command has them."""
VARIED = "stop.lost_after_s=1,2", "stop.lost_after_m=1,2"
"""Fields of every scenario, for the options `--vary`."""
ANOTHER = {"replay", "identify", "submit"}
"""Commands that take a bag, a record or a suite's folder besides: no smallest command leaves one,
and they have tests of their own.
"""
GIVEN = dict.fromkeys(("name", "lab", "student", "bag", "record"), "mine")
"""Values of required arguments for which a shell offers none: of files, one that is not there."""
UNTIL_STOPPED = "Ctrl-C ends it"
"""What a command says of itself that runs until it is interrupted."""
KNOWN_CACHES = re.compile(r"/mesa_shader_cache[^/]*/|/\.nv/|/matplotlib/fontlist-[^/]*\.json$")
"""What libraries keep in the user's cache, so that the next process starts sooner: a driver's
shaders, Matplotlib's list of fonts.
"""
OF_A_LIBRARY = re.compile(r"\w*Warning: |^Exception ignored|^Traceback|^  File ", re.MULTILINE)
"""What no user is to read on standard error: a warning with its line of code, and the lines of a
traceback.
"""
CODES = {0, 2, 3, 4}
LONGEST_S = 1800.0
SHOWN = (DeprecationWarning, PendingDeprecationWarning, ImportWarning, ResourceWarning)
"""Warnings that Python does not show a user."""
EXPERIMENTS = [*bundled_scenarios(), *bundled_comparisons()]

Command = Callable[..., Ended]


@pytest.fixture(scope="module", autouse=True)
def small_suite(tmp_path_factory: pytest.TempPathFactory) -> None:
    """A suite of one task and two laws."""
    folder = tmp_path_factory.mktemp("suite")
    (folder / "plan.yaml").write_text(PLAN)
    (folder / "own.yaml").write_text(OWN)
    SMALLEST["--suite"] = str(folder / "own.yaml")


class Form(NamedTuple):
    """A command in its smallest form; `folder`: it takes one, which comes after the words."""

    words: tuple[str, ...]
    folder: bool
    until_stopped: bool


def forms(experiment: str | None) -> Iterator[Form]:
    """All commands that take an experiment, or a folder; of None those that take neither."""
    for name, command in typer.main.get_command(program()).commands.items():  # type: ignore[attr-defined] - a group
        if command.hidden:
            continue
        context = command.make_context(name, [], resilient_parsing=True)
        offered = {
            p: [item.value for item in p.shell_complete(context, "")] for p in command.params
        }
        arguments = [p for p in command.params if p.param_type_name == "argument"]
        folder = any("DIR" in (p.metavar or "") for p in arguments)
        takes = any(bundled_scenarios().keys() <= set(offered[p]) for p in arguments)
        ends = {"until_stopped": UNTIL_STOPPED in (command.help or "")}
        choices = [p for p in command.params if p.required and p not in arguments and offered[p]]
        required = [[(p.opts[0], value) for value in offered[p]] for p in choices]
        every = [*itertools.product(*required)]
        # of many runs one export
        for options in every[-1:] if experiment in bundled_comparisons() else every:
            said = (name, *itertools.chain(*options), *_options(command, experiment))
            of_folder = (name, *itertools.chain(*options), *_options(command, None))
            if experiment is None and not (takes or folder):
                values = [
                    offered[p] + [""] * (not p.required) or [GIVEN[p.name]] for p in arguments
                ]
                yield from (
                    Form((*said, *filter(None, chosen)), False, **ends)
                    for chosen in itertools.product(*values)
                )
            elif experiment is not None and folder:
                yield Form(of_folder, True, **ends)
            if any(experiment in offered[p] for p in arguments) and takes:
                yield Form((*said, str(experiment)), False, **ends)


def _options(command: Any, experiment: str | None) -> list[str]:
    """The options of the smallest form that a command has."""
    wanted, varied = dict(SMALLEST), VARIED
    if experiment is None:  # what a folder holds has run already
        without_value = {option: value for option, value in SMALLEST.items() if not value}
        wanted, varied = without_value | {"--suite": SMALLEST["--suite"]}, ()
    elif experiment in bundled_comparisons():
        plan = read_comparison(bundled_comparisons()[experiment])
        # of each axis one value
        varied = tuple(f"{path}={json.dumps(values[0])}" for path, values in plan.axes.items())
        if plan.tasks:  # in place of seeds
            del wanted["--seeds"]
            wanted["--limit"] = "1"
    has = {
        option
        for p in command.params
        if p.param_type_name == "option"
        for option in (*p.opts, *p.secondary_opts)
    }
    given = (*wanted.items(), *(("--vary", axis) for axis in varied))
    return [word for option, value in given if option in has for word in (option, value) if word]


@contextmanager
def _interrupted_at_last() -> Iterator[None]:
    """Ctrl-C half a second after a command has said that it waits for it; and after LONGEST_S,
    whatever it does.
    """
    echo, patch = typer.echo, pytest.MonkeyPatch()
    timers: list[threading.Timer] = []

    def said(message: Any = None, *given: Any, **named: Any) -> None:
        echo(message, *given, **named)
        if UNTIL_STOPPED in str(message):
            timers.append(threading.Timer(0.5, signal.raise_signal, [signal.SIGINT]))
            timers[-1].start()

    def hangs(*_: object) -> None:
        raise TimeoutError(f"no end after {LONGEST_S:g} s")

    before = signal.signal(signal.SIGALRM, hangs)
    patch.setattr(typer, "echo", said)
    signal.setitimer(signal.ITIMER_REAL, LONGEST_S)
    try:
        yield
    finally:
        for timer in timers:  # of a command that has ended by itself
            timer.cancel()
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        patch.undo()


@contextmanager
def _standard_error_of_workers() -> Iterator[Path]:
    """A file that holds what other processes, and C code, write to standard error, which Python's
    own stream does not see.
    """
    before = os.dup(2)
    with tempfile.NamedTemporaryFile() as taken:
        os.dup2(taken.fileno(), 2)
        try:
            yield Path(taken.name)
        finally:
            os.dup2(before, 2)
            os.close(before)


def fault(form: Form, words: tuple[str, ...], command: Command) -> tuple[Ended, str]:
    """How a command ended, and what is wrong with it; "" where nothing is."""
    began = time.process_time()
    with (
        warnings.catch_warnings(record=True) as raised,
        _interrupted_at_last(),
        _standard_error_of_workers() as file_of_workers,
    ):
        warnings.simplefilter("always")
        ended = command(*words)
        below = file_of_workers.read_text(encoding="utf-8", errors="replace")
    shown = [str(w.message) for w in raised if not issubclass(w.category, SHOWN)]
    codes = CODES | ({130} if form.until_stopped else set())
    found = [
        "lines of a library" if OF_A_LIBRARY.search(ended.err + below) else "",
        "a traceback" if "Traceback" in ended.err + ended.out else "",
        f"exit code {ended.code}" if ended.code not in codes else "",
        "no sentence" if ended.code and not ended.err.strip() else "",
        f"warnings {shown}" if shown else "",
    ]
    said = ", ".join(filter(None, found))
    sentence = ended.err.strip().splitlines()[-1 if ended.code in (0, 3) else 0 :]
    line = (
        f"{time.process_time() - began:6.1f} s {ended.code} {' '.join(words)}:"
        f" {' / '.join(sentence)[-300:]} {said and 'FAULT ' + said}"
    )
    if file := os.environ.get("VSTESTBED_CODES"):
        with Path(file).open("a", encoding="utf-8") as codes_file:
            codes_file.write(line.rstrip() + "\n")
    return ended, f"{' '.join(words)}: {said}: {ended.err[-2000:]}" if said else ""


def carried_out(
    all_forms: Iterator[Form], command: Command
) -> dict[tuple[str, ...], tuple[Ended, str]]:
    """End and fault of each command; those that take a folder get each
    that the others have left.
    """
    every, done = list(all_forms), {}
    for form in every:
        if not form.folder:
            done[form.words] = fault(form, form.words, command)
    left = sorted(Path("runs").glob("*/*/"))
    for form in every:
        if form.folder:
            for folder in left:
                words = (*form.words, str(folder))
                done[words] = fault(form, words, command)
    return done


def faults(done: dict[tuple[str, ...], tuple[Ended, str]]) -> list[str]:
    return [what for _, what in done.values() if what]


@pytest.mark.parametrize("experiment", where_installed(EXPERIMENTS))
def test_an_experiment_ends_with_an_outcome_or_a_sentence(
    experiment: str, command: Command, request: pytest.FixtureRequest
) -> None:
    if experiment in bundled_scenarios():  # the bundled comparisons draw all figures
        request.getfixturevalue("one_figure")
    done = carried_out(forms(experiment), command)
    assert done and faults(done) == []
    # of which each command is for; with the commands' words, so that none can leave the study
    if experiment == "ibvs_book":
        assert {words[0] for words, (ended, _) in done.items() if ended.code in (0, 3, 130)} >= {
            form.words[0] for form in forms(experiment)
        } - ANOTHER


def test_commands_without_an_experiment_end_with_a_sentence(
    command: Command, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = {}
    for form in forms(None):
        monkeypatch.chdir(tmp_path_factory.mktemp(form.words[0]))  # none meets the files of another
        done[form.words] = fault(form, form.words, command)
    assert faults(done) == []
    # words for several things, which `describe` names; a file that is not there
    refused = [ended.err for ended, _ in done.values() if ended.code == 2]
    expected = ("give one of these names\n", "cannot be read (No such file or directory)\n")
    assert all(said.endswith(expected) for said in refused)
    assert len(refused) < len(done) / 4


def test_a_command_leaves_nothing_elsewhere(
    tmp_path: Path, vstestbed_process: tuple[list[str], dict[str, str]]
) -> None:
    """Each command in a process of its own, with a home of its own: what it writes is in the
    current folder, but for known caches.
    """
    elsewhere, here = tmp_path / "home", tmp_path / "here"
    homes = {name: str(elsewhere / name) for name in HOMES}
    for folder in (*homes.values(), here):
        Path(folder).mkdir(parents=True)
    (here / "net.onnx").write_bytes(linear(np.zeros((8, 6))))
    policy = (
        "run",
        "ibvs_book",
        "--video",
        "none",
        "--set",
        "stop.duration_s=.2",
        "--set",
        "law={kind: policy, file: net.onnx}",
    )
    each = {
        form.words[:3] if "--to" in form.words else form.words[0]: form
        for form in (*forms("ibvs_book"), *forms(None))
    }
    done = [Form(policy, False, False), *sorted(each.values(), key=lambda form: form.folder)]
    left: dict[str, set[str]] = {}
    for form in done:
        words = [
            *vstestbed_process[0],
            *form.words,
            *(["runs/ibvs_book/001"] if form.folder else []),
        ]
        before = files_in(elsewhere)
        process = subprocess.Popen(
            words, cwd=here, env=vstestbed_process[1] | homes, stderr=subprocess.PIPE, text=True
        )
        assert process.stderr is not None
        if form.until_stopped:
            while UNTIL_STOPPED not in process.stderr.readline():
                pass
            process.send_signal(signal.SIGINT)
        said = process.stderr.read()
        assert process.wait() in CODES | {130}, said
        left[" ".join(form.words)] = {
            name for name in files_in(elsewhere) - before if not KNOWN_CACHES.search(name)
        }
    assert len(done) > 15 and {words: names for words, names in left.items() if names} == {}


def files_in(folder: Path) -> set[str]:
    return {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}


def test_no_command_is_left_out() -> None:
    every = {
        name
        for name, command in typer.main.get_command(program()).commands.items()  # type: ignore[attr-defined] - a group
        if not command.hidden
    }
    assert {
        form.words[0] for experiment in (None, "arm_ibvs") for form in forms(experiment)
    } == every
