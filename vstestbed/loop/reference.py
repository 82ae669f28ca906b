"""What a law is told to want, frame by frame: one view, several in turn, a view that moves along a path or comes down on a pad."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from vstestbed.core.geometry import Array, exp, inverse, rotation_angle
from vstestbed.features import ThetaU
from vstestbed.features.observation import Goal, Observation
from vstestbed.scenario.goal import GoalLanding, GoalPath, GoalViews
from vstestbed.scenario.scenario import Scenario

_TURN = ThetaU()
JERK_PEAK = 15 / 8
"""Greatest over mean speed of a minimum-jerk motion from rest to rest."""
DIFFERENCE_S = 1e-3
"""Half of the time over which the wanted view's velocity is taken [s]."""
LEAST_LEG_S = 0.5
"""A leg takes this long at least [s]."""
LATE_S = 2.0
"""Who flies a path may be ahead of the wanted view, or behind it, by so much [s]."""
DEEPEST = -0.25
"""A landing's view is wanted down to this share of its first height: the order to sink lasts until the craft stands."""


@dataclass
class Course:
    """One view, or several in turn, each left when the error falls under the goal's threshold.

    Attributes:
        scenario: the experiment. view: number of the view that counts. began: it is new: a law begins anew.
    """

    scenario: Scenario
    view: int = 0

    def goal(self, seen: Observation) -> Goal:
        """What is wanted when `seen` was exposed."""
        return self.scenario.goal_views[self.view]

    def passed(self, error_px: float, all_seen: bool) -> bool:
        """Whether this frame takes it on to the next view, for which a law begins anew: all that counts is seen, and its error small."""
        goal = self.scenario.goal
        if isinstance(goal, GoalViews) and all_seen and error_px < goal.threshold_px and self.view + 1 < len(goal.views):
            self.view += 1
            return True
        return False


@dataclass
class PathCourse(Course):
    """The view moves along a path by the clock."""

    def goal(self, seen: Observation) -> Goal:
        """The view of this time."""
        T, self.view = self.path.at(seen.t)
        goal = Goal.from_view(self.scenario.believed_camera, self.scenario.target.points, T)
        return replace(goal, twist=self.path.twist(seen.t))

    @cached_property
    def path(self) -> Path:
        """The path."""
        assert isinstance(self.scenario.goal, GoalPath)
        return Path(self.scenario.goal)


def _smooth(p: float) -> float:
    """The share of a leg that is behind at a share p of its time: minimum jerk."""
    return p**3 * (10 - 15 * p + 6 * p * p)


class Path:
    """The poses along a `GoalPath`."""

    def __init__(self, goal: GoalPath):
        self._ways = [inverse(view.T_camera_target.T) for view in goal.way]
        turn = np.radians(goal.turn_degps)
        times = []
        for a, b in pairwise(self._ways):
            length, angle = np.linalg.norm(b[:3, 3] - a[:3, 3]), rotation_angle(a[:3, :3].T @ b[:3, :3])
            times.append(max(JERK_PEAK * length / goal.speed_mps, JERK_PEAK * angle / turn, LEAST_LEG_S))
        self._lead = goal.lead_s
        self._until = goal.settle_s + np.concatenate([[0.0], np.cumsum(times)])

    @property
    def end_s(self) -> float:
        """When the last view is reached [s]."""
        return float(self._until[-1])

    def at(self, t: float) -> tuple[Array, int]:
        """T_camera_target (4, 4) wanted at a time [s], and the number of the view that the leg leads to."""
        leg = int(np.searchsorted(self._until, t, side="right")) - 1
        if leg < 0:
            return inverse(self._ways[0]), 0
        if leg >= len(self._ways) - 1:
            return inverse(self._ways[-1]), len(self._ways) - 1
        a, b = self._ways[leg], self._ways[leg + 1]
        share = _smooth((t - self._until[leg]) / (self._until[leg + 1] - self._until[leg]))
        T = np.eye(4)
        T[:3, 3] = (1 - share) * a[:3, 3] + share * b[:3, 3]
        turn = share * _TURN.measure(a[:3, :3].T @ b[:3, :3])
        T[:3, :3] = a[:3, :3] @ exp(np.concatenate([np.zeros(3), turn]))[:3, :3]
        return inverse(T), leg + 1

    def twist(self, t: float) -> Array:
        """Velocity of the wanted camera, `lead_s` ahead of a time, in its frame at that time (6,) [m/s, rad/s]."""
        before, after = (inverse(self.at(t + self._lead + h)[0]) for h in (-DIFFERENCE_S, DIFFERENCE_S))
        back = inverse(self.at(t)[0])[:3, :3].T
        v = (after[:3, 3] - before[:3, 3]) / (2 * DIFFERENCE_S)
        w = before[:3, :3] @ _TURN.measure(before[:3, :3].T @ after[:3, :3]) / (2 * DIFFERENCE_S)
        return np.concatenate([back @ v, back @ w])

    def off(self, T_target_camera: Array, t: float) -> float:
        """How far [m] a camera (4, 4) is at a time [s] from the part of the path where the wanted view is within LATE_S of then."""
        until = self._until
        first, last = np.clip([t - LATE_S, t + LATE_S], until[0], until[-1])
        x, nearest = T_target_camera[:3, 3], np.inf
        for leg in range(len(until) - 1):
            began, ended = until[leg], until[leg + 1]
            if began > last or ended < first:
                continue
            a, along = self._ways[leg][:3, 3], self._ways[leg + 1][:3, 3] - self._ways[leg][:3, 3]
            low, high = (_smooth(np.clip((when - began) / (ended - began), 0, 1)) for when in (first, last))
            share = np.clip((x - a) @ along / max(along @ along, 1e-12), low, high)
            nearest = min(nearest, float(np.linalg.norm(x - a - share * along)))
        return nearest


@dataclass
class LandingCourse(Course):
    """The view comes down while the craft is over its pad, by its own estimate."""

    share: float = 1.0
    t: float = field(default=np.nan)

    def goal(self, seen: Observation) -> Goal:
        """The view now wanted."""
        goal = self.scenario.goal
        assert isinstance(goal, GoalLanding)
        whole = goal.above.T
        height = float(np.linalg.norm(whole[:3, 3]))
        if not np.isnan(self.t) and self._over(goal, seen):
            self.share = max(DEEPEST, self.share - goal.descend_mps * (seen.t - self.t) / height)
        self.t = seen.t
        T = whole.copy()
        T[:3, 3] *= self.share
        return Goal.from_view(self.scenario.believed_camera, self.scenario.target.points, T)

    def _over(self, goal: GoalLanding, seen: Observation) -> bool:
        """Whether the craft is over its pad, turned as wanted and as high as wanted; or so near that it goes on."""
        T = seen.T_camera_target
        if T is None:
            return False
        whole = goal.above.T
        down = whole[:3, 3] / np.linalg.norm(whole[:3, 3])
        away = T[:3, 3] - self.share * whole[:3, 3]
        if float(T[:3, 3] @ down) < goal.commit_m:
            return True
        sideways = away - (away @ down) * down
        turned = rotation_angle(T[:3, :3].T @ whole[:3, :3])
        ready = np.linalg.norm(sideways) < goal.within_m and abs(away @ down) < 2 * goal.within_m
        return bool(ready and np.degrees(turned) < goal.within_deg)


def course_of(scenario: Scenario) -> Course:
    """The course that a scenario's goal asks for."""
    match scenario.goal:
        case GoalPath():
            return PathCourse(scenario)
        case GoalLanding():
            return LandingCourse(scenario)
        case _:
            return Course(scenario)
