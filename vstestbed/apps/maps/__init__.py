"""From where a law reaches its goal, and at which gains and delays."""

from vstestbed.core.apps import App

APP = App(
    commands={
        "basin": "vstestbed.apps.maps.commands:basin",
        "gain-limit": "vstestbed.apps.maps.commands:gain_limit",
        "sweep": "vstestbed.apps.maps.commands:sweep",
    }
)
