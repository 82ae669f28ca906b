"""The frozen suite of tasks, by which laws are ranked, and submissions to it."""

from vstestbed.core.apps import App

APP = App(
    commands={
        "suite": "vstestbed.apps.suite.commands:suite",
        "submit": "vstestbed.apps.suite.commands:submit",
    }
)
