"""The commands `ros` and `replay`: nodes of ROS 2, and recorded bags."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Annotated, Literal

import typer

from vstestbed.cli.options import Plugins, Quiet, ScenarioName, Settings, load_scenario
from vstestbed.cli.progress import show_notes
from vstestbed.cli.results import command_line
from vstestbed.core import files
from vstestbed.core.errors import ParameterError

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
    quiet: Quiet = False,
    plugin: Plugins = None,
) -> None:
    """The simulated robot, or the law, as a node of ROS 2."""
    from vstestbed.apps.ros import link, roles

    # who waits for commands has not ended
    idle = ["stop.rest_after_s=null"] if role == "robot" else []
    given = load_scenario(scenario, [*idle, *(set_ or [])], plugin, seed)
    show_notes(not quiet)
    _heed(param or [])
    name, rules = f"vstestbed_{role}", link.rules_of(remap or [])
    with (
        roles.ended_by_signals() as ended,
        link.connected(name, backend, rules, connect or (), listen or ()) as others,
    ):
        if role == "law":
            roles.servo(roles.LawNode(given, others, watchdog, start), quiet, ended)
        elif role == "excite":
            roles.excited(given, others, quiet, ended)
        elif role == "robot":
            # refuses before anything is written
            robot = roles.RobotNode(given, others, pace, truth, watchdog, ended)
            raise typer.Exit(roles.simulate(robot, given, bag, out, quiet))
        else:
            roles.tell(others, role)


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
    quiet: Quiet = False,
    plugin: Plugins = None,
) -> None:
    """A recorded bag through a scenario's controller: where its twists differ from the recorded
    ones.
    """
    from vstestbed.apps.ros import bag as bags
    from vstestbed.apps.ros.link import remapped

    given = load_scenario(scenario, set_, plugin, None)
    beside = bag.resolve()
    path = out or beside.with_name(f"{beside.stem}_replay")
    files.must_be_new(path, "give a new folder with --out")
    show_notes(not quiet)
    found = bags.replay(bag, given, remapped(remap or []))
    with files.whole_folder(path) as folder:
        bags.write_replay(folder, found, bag.name, command_line())
    if not quiet:
        differs = found.differs
        words = (
            f"; of {len(differs)} recorded twists the largest difference is {differs.max():.3g}"
            if len(differs)
            else ""
        )
        typer.echo(f"{len(found.table)} pictures{words}\n{path / 'report.html'}", err=True)
