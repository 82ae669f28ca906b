"""Tasks, one file for each kind of goal: the reference frame by frame, and when the task is
completed or failed.
"""

from vstestbed.core.registry import Contract, Registry
from vstestbed.tasks.base import Task, TaskBase
from vstestbed.tasks.following import GoalGap, GoalLine
from vstestbed.tasks.insertion import GoalInsertion
from vstestbed.tasks.landing import GoalLanding
from vstestbed.tasks.monitor import Setup
from vstestbed.tasks.path import GoalPath, GoalViews
from vstestbed.tasks.view import VIEWS, GoalPlace, GoalTrack, GoalView, GoalViewFrom

FIELDS = {
    "T_camera_target": "view",
    "view_from": "view_from",
    "views": "views",
    "pose": "pose",
    "gap_m": "gap",
    "offset_m": "line",
    "way": "path",
    "above": "landing",
    "tip_m": "insertion",
}
"""The kind of a goal block without `kind`, recognised by one of its fields."""
KINDS = (
    GoalView,
    GoalViewFrom,
    GoalViews,
    GoalPlace,
    GoalGap,
    GoalLine,
    GoalPath,
    GoalLanding,
    GoalInsertion,
    GoalTrack,
)
GOALS = Registry("goal", *KINDS, fields=FIELDS, contract=Contract(Task, base=Task))

__all__ = [
    "GOALS",
    "VIEWS",
    "GoalGap",
    "GoalInsertion",
    "GoalLanding",
    "GoalLine",
    "GoalPath",
    "GoalPlace",
    "GoalTrack",
    "GoalView",
    "GoalViewFrom",
    "GoalViews",
    "Setup",
    "Task",
    "TaskBase",
]
