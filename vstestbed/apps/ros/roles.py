"""What `ros` does in each role: the node of a law, of a robot, of a motion, and words to nodes."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import typer

from vstestbed.apps.ros.law import LawNode, command_topic, excite, median_ms
from vstestbed.apps.ros.link import NODES, Link
from vstestbed.apps.ros.robot import RobotNode
from vstestbed.cli.ending import GOAL_REACHED, NOT_REACHED
from vstestbed.cli.running import Progress, summary_text
from vstestbed.core.apps import must_be_here
from vstestbed.core.errors import EnvironmentLackError
from vstestbed.core.files import make_parents, must_be_new
from vstestbed.core.shares import STOPS
from vstestbed.loop.episode import BY_HAND
from vstestbed.scenario.scenario import Scenario
from vstestbed.studies import run_folder


@contextmanager
def ended_by_signals() -> Iterator[threading.Event]:
    """An event that Ctrl-C, SIGTERM and SIGHUP set; one that is ignored (`nohup`) stays so."""
    ended = threading.Event()
    before = {
        number: handler
        for number in STOPS
        if (handler := signal.getsignal(number)) != signal.SIG_IGN
    }
    for number in before:
        signal.signal(number, lambda *_: ended.set())
    try:
        yield ended
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def servo(node: LawNode, quiet: bool, ended: threading.Event) -> None:
    """The law at work, until it is ended."""
    _waits(quiet, "waits for pictures")
    node.spin(ended)
    if not quiet:
        words = f"{len(node.took_s)} twists{_after(node.took_s, 'after its picture each')}"
        typer.echo(words, err=True)
        for line in node.servo.senses.passed.lines():
            typer.echo(line, err=True)


def excited(given: Scenario, link: Link, quiet: bool, ended: threading.Event) -> None:
    """Send the motion of `excite`, one command a picture's period."""
    must_be_here("identify", "--role excite")
    from vstestbed.apps.identify.identification import motion_of

    link.publishes(command_topic(given))
    motion = motion_of(given).drop("t").to_numpy()
    _waits(quiet, f"sends {len(motion)} commands, one a picture's period")
    sent = excite(given, link, motion, ended)
    typer.echo(f"{sent} of {len(motion)} commands were sent", err=True)


def _waits(quiet: bool, words: str) -> None:
    """Say what a node does until it is ended: it may be for ever."""
    if not quiet:
        typer.echo(f"{words}   (Ctrl-C ends it)", err=True)


def _after(took_s: list[float], words: str) -> str:
    """`, 1.20 ms WORDS (median)`; nothing where nothing was timed."""
    return f", {median_ms(took_s):.2f} ms {words} (median)" if took_s else ""


def tell(link: Link, service: str) -> None:
    """Tell the nodes of law and robot to start, stop or reset. Raises EnvironmentLackError: none
    has answered.
    """
    link.publishes(*(f"/{name}/{service}" for name in NODES[:2]))
    answers = [
        f"{name}: {answer[1]}" for name in NODES[:2] if (answer := link.call(f"/{name}/{service}"))
    ]
    if not answers:
        raise EnvironmentLackError(
            "no node has answered",
            "start `vstestbed ros ... --role law`; is --connect its address?",
        )
    typer.echo("\n".join(answers))


def simulate(
    node: RobotNode, given: Scenario, bag: Path | None, out: Path | None, quiet: bool
) -> int:
    """The simulated robot at work: a run whose commands come from outside; the exit code."""
    if bag is not None:
        must_be_new(bag, "give a new folder with --bag")
    _waits(quiet, f"simulates {given.name}")
    folder = run_folder.new_folder(given, out)
    # before it flies: it is written first
    given = given.but(description=f"{given.description} {BY_HAND} commanded from outside.".strip())
    with Progress(given, shown=not quiet) as progress, _recorded(node, bag):
        recording = run_folder.run_into(
            folder, given, "none", [progress], progress.say, fly=node.fly
        )
    if not quiet:
        typer.echo(summary_text(recording, folder, filmed=False), err=True)
        words = (
            f"{len(node.answered_s)} pictures were"
            f" answered{_after(node.answered_s, 'after they were sent')}"
        )
        dropped = f"; {node.dropped} commands were dropped: {node.refused}" if node.dropped else ""
        typer.echo(f"{words}; at most {node.behind_s:.3f} s behind the clock{dropped}", err=True)
    return GOAL_REACHED if recording.outcome.success else NOT_REACHED


@contextmanager
def _recorded(node: RobotNode, bag: Path | None) -> Iterator[None]:
    """Record what a robot tells and is told, where a bag is asked for."""
    if bag is None:
        yield
        return
    from vstestbed.apps.ros.bag import Bag  # here: it imports what draws, which a law does without

    with Bag(make_parents(bag)) as node.record:
        yield
