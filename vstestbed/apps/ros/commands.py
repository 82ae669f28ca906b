"""The commands `ros` and `replay`: nodes of ROS 2, and recorded bags. Heavy imports are inside the
functions.
"""

from __future__ import annotations

import logging
import signal
import threading
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from vstestbed.cli.options import Plugins, ScenarioName, Settings, load_scenario
from vstestbed.core.apps import must_be_here
from vstestbed.core.errors import EnvironmentLackError, ParameterError
from vstestbed.core.shares import STOPS

if TYPE_CHECKING:
    from vstestbed.apps.ros.link import Link
    from vstestbed.apps.ros.robot import Pace
    from vstestbed.scenario.scenario import Scenario

Role = Literal["robot", "law", "excite", "start", "stop", "reset"]
Remap = Annotated[
    list[str] | None,
    typer.Option(
        "--remap",
        "-r",
        metavar="NAME:=OTHER",
        help="Another name of a topic or service, such as image_raw:=/cam/image.",
    ),
]
RosArgs = Annotated[
    bool, typer.Option("--ros-args", help="Begins arguments of ROS, of which -r and -p are known.")
]
Parameters = Annotated[
    list[str] | None,
    typer.Option(
        "--param",
        "-p",
        metavar="NAME:=VALUE",
        help="A parameter of ROS: use_sim_time alone, which changes nothing here.",
    ),
]


def ros(
    scenario: ScenarioName,
    role: Annotated[
        Role,
        typer.Option(
            help=(
                "robot: simulate it. law: servo. excite: the motion of `excite`."
                " start, stop, reset: tell nodes."
            )
        ),
    ],
    set_: Settings = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Draw the start and the noise from this seed.")
    ] = None,
    backend: Annotated[
        Literal["auto", "rclpy", "zenoh"],
        typer.Option(help="auto: rclpy where ROS 2 is, else zenoh."),
    ] = "auto",
    pace: Annotated[
        Literal["lockstep", "wall"],
        typer.Option(help="robot: time waits for commands, or goes with the clock."),
    ] = "lockstep",
    start: Annotated[
        bool, typer.Option("--start", help="law: servo at once, without waiting for ~/start.")
    ] = False,
    watchdog: Annotated[
        float | None,
        typer.Option(
            min=0.01, metavar="SECONDS", help="Rest after so long without the other side."
        ),
    ] = None,
    bag: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="robot: record what is told and commanded as rosbag2."),
    ] = None,
    truth: Annotated[
        bool, typer.Option("--truth", help="robot: tell true poses under /truth.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="robot: folder of the run. [default: runs/SCENARIO/NUMBER]"
        ),
    ] = None,
    remap: Remap = None,
    ros_args: RosArgs = False,
    param: Parameters = None,
    connect: Annotated[
        list[str] | None,
        typer.Option(metavar="tcp/HOST:PORT", help="zenoh: the other side's address."),
    ] = None,
    listen: Annotated[
        list[str] | None,
        typer.Option(metavar="tcp/HOST:PORT", help="zenoh: the address to be found at."),
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no words.")] = False,
    plugin: Plugins = None,
) -> None:
    """The simulated robot, or the law, as a node of ROS 2."""
    from vstestbed.apps.ros.law import command_topic
    from vstestbed.apps.ros.link import connected, rules_of
    from vstestbed.cli.progress import show_notes

    # who waits for commands has not ended
    idle = ["stop.rest_after_s=null"] if role == "robot" else []
    given, ended = load_scenario(scenario, [*idle, *(set_ or [])], plugin, seed), threading.Event()
    show_notes(not quiet)
    _heed(param or [])
    # one that is ignored (`nohup`) stays so
    before = {
        number: handler
        for number in STOPS
        if (handler := signal.getsignal(number)) != signal.SIG_IGN
    }
    for number in before:
        signal.signal(number, lambda *_: ended.set())
    try:
        node = f"vstestbed_{role}"
        with connected(node, backend, rules_of(remap or []), connect or (), listen or ()) as link:
            if role == "law":
                from vstestbed.apps.ros.law import LawNode

                servo = LawNode(given, link, watchdog, start)
                _waits(quiet, "waits for pictures")
                servo.spin(ended)
                if not quiet:
                    typer.echo(
                        (
                            f"{len(servo.took_s)}"
                            f" twists{_after(servo.took_s, 'after its picture each')}"
                        ),
                        err=True,
                    )
                    for line in servo.servo.senses.passed.lines():
                        typer.echo(line, err=True)
            elif role == "excite":
                must_be_here("identify", "--role excite")
                from vstestbed.apps.identify.identification import motion_of
                from vstestbed.apps.ros.law import excite

                link.publishes(command_topic(given))
                motion = motion_of(given).drop("t").to_numpy()
                _waits(quiet, f"sends {len(motion)} commands, one a picture's period")
                typer.echo(
                    f"{excite(given, link, motion, ended)} of {len(motion)} commands were sent",
                    err=True,
                )
            elif role == "robot":
                _fly(given, link, pace, truth, watchdog, bag, out, quiet, ended)
            else:
                _tell(link, role)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _waits(quiet: bool, words: str) -> None:
    """Say what a node does until it is ended: it may be for ever."""
    if not quiet:
        typer.echo(f"{words}   (Ctrl-C ends it)", err=True)


def _heed(parameters: list[str]) -> None:
    """Parameters of ROS: use_sim_time, which launch files give to every node, is passed over with a
    word; others are refused.
    """
    for words in parameters:
        name, _, value = words.partition(":=")
        if name != "use_sim_time" or value.lower() not in ("true", "false"):
            raise ParameterError(
                "--param",
                "is known as use_sim_time:=true or false alone; --set gives fields of the scenario",
                words,
            )
        note = (
            "%s changes nothing: nodes go by the stamps of the messages,"
            " and waits are counted by this computer's own clock"
        )
        logging.getLogger("vstestbed").warning(note, words)


def _after(took_s: list[float], words: str) -> str:
    """`, 1.20 ms WORDS (median)`; nothing where nothing was timed."""
    from vstestbed.apps.ros.law import median_ms

    return f", {median_ms(took_s):.2f} ms {words} (median)" if took_s else ""


def _tell(link: Link, service: str) -> None:
    from vstestbed.apps.ros.link import NODES

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


def _fly(
    given: Scenario,
    link: Link,
    pace: Pace,
    truth: bool,
    watchdog: float | None,
    bag: Path | None,
    out: Path | None,
    quiet: bool,
    ended: threading.Event,
) -> None:
    from vstestbed.apps.ros.bag import Bag
    from vstestbed.apps.ros.robot import RobotNode
    from vstestbed.cli.ending import GOAL_REACHED, NOT_REACHED
    from vstestbed.cli.progress import Progress, summary_text
    from vstestbed.core.files import make_parents, must_be_new
    from vstestbed.loop.episode import BY_HAND
    from vstestbed.studies.run_folder import new_folder, run_into

    if bag is not None:
        must_be_new(bag, "give a new folder with --bag")
    # refuses before anything is written
    node = RobotNode(given, link, pace, truth, watchdog, ended)
    _waits(quiet, f"simulates {given.name}")
    folder = new_folder(given, out)
    # before it flies: it is written first
    given = given.but(description=f"{given.description} {BY_HAND} commanded from outside.".strip())
    with (
        Progress(given, shown=not quiet) as progress,
        nullcontext() if bag is None else Bag(make_parents(bag)) as node.record,
    ):
        recording = run_into(folder, given, "none", [progress], progress.say, fly=node.fly)
    if not quiet:
        typer.echo(summary_text(recording, folder, filmed=False), err=True)
        words = (
            f"{len(node.answered_s)} pictures were"
            f" answered{_after(node.answered_s, 'after they were sent')}"
        )
        dropped = f"; {node.dropped} commands were dropped: {node.refused}" if node.dropped else ""
        typer.echo(f"{words}; at most {node.behind_s:.3f} s behind the clock{dropped}", err=True)
    raise typer.Exit(GOAL_REACHED if recording.outcome.success else NOT_REACHED)


def replay(
    bag: Annotated[
        Path,
        typer.Argument(
            metavar="BAG",
            help="A folder of rosbag2, its MCAP or .db3 file, or one of `export --to mcap`.",
        ),
    ],
    scenario: ScenarioName,
    set_: Settings = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="A new folder for page and table. [default: BAG_replay]"),
    ] = None,
    remap: Remap = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress, no words.")] = False,
    plugin: Plugins = None,
) -> None:
    """A recorded bag through a scenario's controller: where its twists differ from the recorded
    ones.
    """
    from vstestbed.apps.ros.bag import replay as replayed
    from vstestbed.apps.ros.bag import write_replay
    from vstestbed.apps.ros.link import remapped
    from vstestbed.cli.progress import show_notes
    from vstestbed.cli.results import command_line
    from vstestbed.core.files import must_be_new, whole_folder

    given, beside = load_scenario(scenario, set_, plugin, None), bag.resolve()
    path = out or beside.with_name(f"{beside.stem}_replay")
    must_be_new(path, "give a new folder with --out")
    show_notes(not quiet)
    found = replayed(bag, given, remapped(remap or []))
    with whole_folder(path) as folder:
        write_replay(folder, found, bag.name, command_line())
    if not quiet:
        differs = found.differs
        words = (
            f"; of {len(differs)} recorded twists the largest difference is {differs.max():.3g}"
            if len(differs)
            else ""
        )
        typer.echo(f"{len(found.table)} pictures{words}\n{path / 'report.html'}", err=True)
