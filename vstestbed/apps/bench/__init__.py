"""Where time goes, beside the floor."""

from vstestbed.core.apps import App

APP = App(commands={"bench": "vstestbed.apps.bench.commands:bench"})
