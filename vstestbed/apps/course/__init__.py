"""Marks of students' files by a lab's tasks."""

from vstestbed.core.apps import App

APP = App(commands={"grade": "vstestbed.apps.course.commands:grade"})
