"""Intrinsics and hand-eye poses from pictures of a board."""

from vstestbed.core.apps import App

APP = App(commands={"calibrate": "vstestbed.apps.calibrate.commands:calibrate"})
