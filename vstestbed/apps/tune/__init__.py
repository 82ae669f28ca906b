"""The settings with which a scenario, or each law of a comparison, does best."""

from vstestbed.core.apps import App

APP = App(
    commands={"tune": "vstestbed.apps.tune.commands:tune"},
    reports={"tuning.yaml": "vstestbed.apps.tune.tuning:report_again"},
)
