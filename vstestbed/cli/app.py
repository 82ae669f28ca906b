"""The command line: `run`, `render`, `report`, and what starts all commands.

Heavy imports are inside the functions: `--help` must answer within 0.4 s.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, NoReturn

import typer
import typer.core

from vstestbed.cli import complete, tools
from vstestbed.cli.compare import compare
from vstestbed.cli.ending import exit_code
from vstestbed.cli.options import (
    Json,
    Plugins,
    Quiet,
    ScenarioName,
    Settings,
    load_scenario,
    must_hold,
)
from vstestbed.core import apps
from vstestbed.core.errors import PluginError

FilmChoice = Literal["camera", "overview", "both", "none"]
Fine = Annotated[
    bool,
    typer.Option(
        "--fine", help="Films of 1280x720 with shadows and every frame, in place of quick drafts."
    ),
]


def _version(value: bool) -> None:
    if value:
        from vstestbed.core.provenance import vstestbed_version

        typer.echo(f"vstestbed {vstestbed_version()}")
        raise typer.Exit


def _options(
    # taken out by `main`
    debug: Annotated[
        bool, typer.Option("--debug", help="Show tracebacks; may stand anywhere.")
    ] = False,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Options of the program itself."""


def run(
    scenario: ScenarioName,
    set_: Settings = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Draw the start and the noise from this seed.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the results. [default: runs/SCENARIO/NUMBER]"),
    ] = None,
    video: Annotated[FilmChoice, typer.Option(help="Which films to make.")] = "both",
    fine: Fine = False,
    as_json: Json = False,
    quiet: Quiet = False,
    plugin: Plugins = None,
) -> None:
    """One closed-loop run, with its folder of results."""
    from vstestbed.cli.running import flown

    chosen = load_scenario(scenario, set_, plugin, seed)
    raise typer.Exit(flown(chosen, out, video, fine, as_json, quiet))


def render(
    run_dir: Annotated[Path, typer.Argument(metavar="RUN_DIR", help="A run's folder.")],
    camera: Annotated[
        str, typer.Option(metavar="NAME", help="eye, overview, or another camera of model.xml.")
    ] = "overview",
    view: Annotated[
        str | None,
        typer.Option(
            metavar="AZ,EL,DIST[,X,Y,Z]",
            help="Look from there, as MuJoCo's viewer says it [deg, deg, m], at a point [m].",
        ),
    ] = None,
    size: Annotated[
        str | None, typer.Option(metavar="WxH", help="Size of the film in pixels.")
    ] = None,
    fine: Fine = False,
    gif: Annotated[
        bool, typer.Option("--gif", help="Make a GIF under 3 MB that repeats, for a README.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The film. [default: RUN_DIR/NAME.mp4 or .gif]"),
    ] = None,
    quiet: Quiet = False,
    plugin: Plugins = None,
) -> None:
    """Film a recorded run again, from any camera, without simulating."""
    from vstestbed.cli import rendering

    ending = ".gif" if gif else ".mp4"
    rendering.must_end_in(ending, out)
    shot = rendering.shot_of(camera, view, size)
    path = out or run_dir / f"{camera if view is None else 'view'}{ending}"
    must_hold(run_dir, "scenario.yaml")  # before the scenario is loaded, for a clearer message
    film = rendering.filmed(run_dir, shot, path, fine, plugin or [], quiet)
    if not quiet:
        typer.echo(str(film), err=True)


def report(
    folder: Annotated[
        Path, typer.Argument(metavar="DIR", help="A run's folder, a comparison's or a search's.")
    ],
    figures: Annotated[
        bool,
        typer.Option("--figures/--no-figures", help="A comparison's figures for a paper, too."),
    ] = True,
    quiet: Quiet = False,
    plugin: Plugins = None,
) -> None:
    """Write report.html again."""
    from vstestbed.core.files import only_writer

    known = (*apps.offered("reports"), *apps.WORDS["reports"])
    must_hold(folder, "comparison.yaml", "scenario.yaml", *known)
    of_apps = [name for name in known if (folder / name).is_file()]
    with only_writer(folder):
        # each with its own imports: those of a comparison take as long as the report of a run
        if (folder / "comparison.yaml").is_file():
            from vstestbed.studies.comparison import report_again

            page = report_again(folder, plugin or [], figures)
        elif of_apps:
            write = apps.loaded("reports", of_apps[0])
            page = write(folder, plugin or [])
        else:
            from vstestbed.report import write_report

            page = write_report(folder, plugins=plugin or [])
    if not quiet:
        typer.echo(str(page), err=True)


COMMANDS: dict[str, Callable[..., None]] = {
    command.__name__.rstrip("_").replace("_", "-"): command
    for command in (
        run,
        render,
        report,
        compare,
        tools.new,
        tools.list_,
        tools.schema,
        tools.describe,
        tools.doctor,
        tools.optical_flow,
    )
}
"""The kernel's commands; all others are of apps."""


class Groups(typer.core.TyperGroup):
    """Shows the kernel's commands, those of apps, and apps that cannot be imported."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the lists, each command with the beginning of its help."""
        width = formatter.width - 6 - max(map(len, self.commands))
        of_kernel: list[tuple[str, str]] = []
        of_apps: list[tuple[str, str]] = []
        for name, one in self.commands.items():
            rows = of_kernel if name in COMMANDS else of_apps
            rows.append((name, one.get_short_help_str(width)))
        broken = [(name, str(error)) for name, error in apps.left_out().items()]
        for title, rows in (("Experiments", of_kernel), ("Apps", of_apps), ("Left out", broken)):
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


def program(*names: str) -> typer.Typer:
    """The command line with these commands, by default all: typer takes 0.1 s to read the
    signatures of all.
    """
    app = _without_commands()
    app.callback()(_options)
    for name in names:
        app.command(name)(_command(name))
    if not names:
        for name in (*COMMANDS, *apps.offered("commands")):
            app.command(name)(_command_or_refusal(name))
    return app


def _overview() -> typer.Typer:
    """The command line where no command is given, or one that is not there: all commands with
    their help, but without their signatures.
    """
    app = _without_commands()
    app.callback()(_options)
    for name in (*COMMANDS, *apps.offered("commands")):
        app.command(name, help=_command_or_refusal(name).__doc__)(_not_given)
    return app


def _not_given() -> None:
    """Stands for every command, of which none is carried out."""


def _without_commands() -> typer.Typer:
    return typer.Typer(
        cls=Groups,
        help="Visual servoing meets real dynamics: run scenarios, film them, look at the results.",
        no_args_is_help=True,
        add_completion=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )


def _command(name: str) -> Callable[..., None]:
    """A command by its word. Raises PluginError: it is of another package, and broken."""
    if name in COMMANDS:
        return COMMANDS[name]
    command = apps.loaded("commands", name)
    if not any(name in app.commands for app in apps.bundled().values()):
        _must_be_readable(name, command)
    return command


def _must_be_readable(name: str, command: Callable[..., None]) -> None:
    """Refuse a command of another package that typer cannot read: it would stop the list of all."""
    alone = _without_commands()
    alone.command(name)(command)
    try:
        typer.main.get_command(alone)
    except Exception as error:  # of any kind: it is the code of others
        place = apps.offered("commands")[name]
        raise PluginError(place, f"cannot be a command: {error}", apps.REMEDY) from error


def _command_or_refusal(name: str) -> Callable[..., None]:
    """A command for the list of all; a broken one of another package only says what is wrong."""
    try:
        return _command(name)
    except PluginError as error:
        refused = error

    def refusal() -> NoReturn:
        raise refused

    refusal.__doc__ = f"Cannot be used: {refused}"
    return refusal


def _program_for(words: list[str]) -> typer.Typer:
    """What a command line needs: its command, or the list of all where nobody has the command."""
    name = words[0] if words else "--help"
    if name == "--help":
        return _overview()
    if name.startswith("-"):
        return program()
    if name in COMMANDS or apps.loaded("commands", name) is not None:
        return program(name)
    apps.must_be_complete()
    return _overview()


def main(argv: list[str] | None = None) -> NoReturn:
    """Run the command line and exit: 0 goal reached, 1 a bug, 2 bad input, 3 not reached, 4
    environment, 5 worse than the baseline, 130 interrupted.
    """
    # importing makes 10^5 objects that stay: looking through them takes a tenth of a start
    gc.set_threshold(100_000, 50, 100)
    # the search for plugins reads the metadata of every installed package
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "1")
    arguments = sys.argv[1:] if argv is None else argv
    if complete.asked(arguments):
        program()(arguments, prog_name="vstestbed")
    # --debug may stand anywhere
    given = [argument for argument in arguments if argument != "--debug"]

    def command() -> object:
        app = _program_for(given)
        return app(given, prog_name="vstestbed", standalone_mode=False)

    sys.exit(exit_code(command, debug=len(given) < len(arguments)))
