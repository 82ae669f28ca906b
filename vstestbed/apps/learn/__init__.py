"""Environments for learners, of Gymnasium and dm_env, and their LeRobot datasets."""

from vstestbed.core.apps import App

APP = App()
