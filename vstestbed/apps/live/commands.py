"""The command `live`."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vstestbed.cli import complete
from vstestbed.cli.options import Plugins, Settings, settings_of
from vstestbed.cli.progress import show_notes
from vstestbed.core.errors import EnvironmentLackError, ParameterError

if TYPE_CHECKING:
    from vstestbed.apps.live.app import LiveApp
    from vstestbed.apps.live.playback import PlaybackApp


def live(
    what: Annotated[
        str,
        typer.Argument(
            metavar="SCENARIO|RUN_DIR",
            help="A bundled scenario's name, a YAML file, or a run's folder.",
            autocompletion=complete.scenarios,
        ),
    ],
    set_: Settings = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Draw the start and the noise from this seed.")
    ] = None,
    port: Annotated[
        int | None, typer.Option(min=1, max=65535, help="Port on 127.0.0.1. [default: a free one]")
    ] = None,
    no_open: Annotated[bool, typer.Option("--no-open", help="Do not open a browser.")] = False,
    plugin: Plugins = None,
) -> None:
    """The run in a browser, with its gains under your fingers; a run's folder is played back.
    Ctrl-C ends it.
    """
    if importlib.util.find_spec("viser") is None:
        raise EnvironmentLackError(
            "the live view needs viser, which is not installed", "pip install 'vstestbed[live]'"
        )
    show_notes(True)
    folder = Path(what)
    app: PlaybackApp | LiveApp
    if (folder / "scenario.yaml").is_file():
        if set_ or seed is not None:
            raise ParameterError.only_for(
                "--set" if set_ else "--seed", "a scenario; what a folder holds has run already"
            )
        from vstestbed.apps.live import playback

        app = playback.PlaybackApp(folder, port, plugin or [])
    else:
        from vstestbed.apps.live import app as running

        settings = running.Settings(what, settings_of(set_), seed, plugin or [])
        app = running.LiveApp(settings, port)
    typer.echo(f"{app.address}   (Ctrl-C ends it)", err=True)
    if not no_open and sys.stderr.isatty():
        import webbrowser

        webbrowser.open(app.address)
    app.serve()
