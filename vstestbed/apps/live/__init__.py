"""The live view: a session, or a recorded run, in a browser."""

from vstestbed.core.apps import App

APP = App(commands={"live": "vstestbed.apps.live.commands:live"})
