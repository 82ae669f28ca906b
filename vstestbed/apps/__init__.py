"""Tools on experiments, each whole in its folder; nothing below knows them (`core/apps.py`)."""
