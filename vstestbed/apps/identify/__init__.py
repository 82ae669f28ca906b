"""Motions that show what a robot is, and its parameters from a record of them."""

from vstestbed.core.apps import App

APP = App(
    commands={
        "excite": "vstestbed.apps.identify.commands:excite",
        "identify": "vstestbed.apps.identify.commands:identify",
    }
)
