"""Frames for tests of monitors and of the termination: a run under way in which all is well, but
for what is given.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from vstestbed.camera import Perspective
from vstestbed.core.geometry import Array, Pose
from vstestbed.core.outcome import Verdict
from vstestbed.endings import Termination
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import Command
from vstestbed.robots import Allocation
from vstestbed.robots.allocation import Limit, Order
from vstestbed.sim.base import Truth
from vstestbed.tasks.frame import Frame, FrameTiming, ImageError
from vstestbed.tasks.monitor import TaskMonitor

PERIOD_S = 0.04
CORNERS = np.array([[-0.1, -0.1, 0], [0.1, -0.1, 0], [0.1, 0.1, 0], [-0.1, 0.1, 0]])
GOAL = Goal.from_view(Perspective(), CORNERS, Pose(xyz=(0, 0, 1)).T)
"""Four markers, seen squarely from 1 m."""
I4 = np.eye(4)
NOTHING = np.zeros(0)


def back_from_target(distance_m: float) -> Array:
    """T_world_camera (4, 4) of a camera that looks along the world's z, so far before a target at
    the origin [m].
    """
    return Pose(xyz=(0, 0, -distance_m)).T


def observed(T_camera_target: Array, t: float = 0.0, place: Array | None = None) -> Observation:
    """What is seen of the four markers from a pose (4, 4), with that pose as the estimate."""
    view = Goal.from_view(GOAL.camera, CORNERS, T_camera_target)
    return Observation(
        t, view.uv, view.xy, view.depth, T_camera_target=T_camera_target, place=place
    )


def frame(
    t: float = 0.0,
    *,
    rms_px: float = 5.0,
    lost: bool = False,
    all_seen: bool = True,
    rest_reason: str = "",
    speed_mps: float = 0.1,
    scale: float = 1.0,
    limit: Limit = "",
    T_world_camera: Array | None = None,
    T_world_target: Array = I4,
    contact: str = "",
    feet: str = "",
    goal: Goal = GOAL,
    seen: Observation | None = None,
) -> Frame:
    """One frame at a time t [s].

    Args:
        rms_px, lost, all_seen: the error in the image. rest_reason, speed_mps: the law's command.
        scale, limit: of the allocation. T_world_camera: 1 m before the target by default. contact,
            feet: what touches.
        goal: the reference. seen: the observation; the goal's own view by default.
    """
    twist = np.array([speed_mps, 0, 0, 0, 0, 0])
    T = back_from_target(1.0) if T_world_camera is None else T_world_camera
    truth = Truth(
        T,
        T_world_target,
        twist,
        NOTHING,
        NOTHING,
        NOTHING,
        CORNERS,
        np.zeros(4, dtype=bool),
        contact,
        feet,
        NOTHING,
        np.zeros(3),
    )
    return Frame(
        timing=FrameTiming(round(t / PERIOD_S), t, t),
        observation=observed(goal.T_camera_target, t) if seen is None else seen,
        goal=goal,
        error=ImageError(lost, all_seen, np.nan if lost else rms_px),
        command=Command(u=twist, twist=twist, rest_reason=rest_reason),
        allocation=(
            allocation := Allocation(setpoint=twist, twist=twist * scale, scale=scale, limit=limit)
        ),
        order=Order.of(allocation),
        truth=truth,
        image=None,
        row=NOTHING,
    )


def first_verdict(
    monitor: TaskMonitor, ends: Termination, frames: Iterable[Frame]
) -> tuple[Verdict, float] | None:
    """The first verdict on frames in turn, and the time at which it fell [s]; None where all may go
    on.
    """
    for each in frames:
        monitor.measure(each)
        if verdict := ends.verdict(each):
            return verdict, each.t
    return None


def times(until_s: float, from_s: float = 0.0) -> list[float]:
    """Times of frames at 25 Hz, both ends included [s]."""
    return [from_s + k * PERIOD_S for k in range(round((until_s - from_s) / PERIOD_S) + 1)]
