"""Recorded runs for other tools: MCAP, LeRobot datasets, CSV."""

from vstestbed.core.apps import App

APP = App(
    commands={"export": "vstestbed.apps.export.commands:export"},
    exports={
        "mcap": "vstestbed.apps.export.mcap_file:MCAP",
        "lerobot": "vstestbed.apps.export.lerobot:LEROBOT",
        "csv": "vstestbed.apps.export.csv_files:CSV",
    },
)
