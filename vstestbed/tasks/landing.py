"""Landing on the target's pad: a reference that descends, and the verdict on the touch-down."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose, inverse, rotation_angle
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.core.quantity import PositiveAngle, PositiveLength, PositiveSpeed
from vstestbed.core.spec import spec
from vstestbed.features.observation import Goal, Observation
from vstestbed.robots.base import Supervisor
from vstestbed.targets import Target
from vstestbed.tasks.base import Log, Task, view_from
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.judged import JudgedError, at_the_end, largest
from vstestbed.tasks.monitor import Setup, TaskMonitor
from vstestbed.tasks.stop import Stop

# the reference descends to this share of its initial height, below the pad: the craft is commanded
# to sink until it stands
DEEPEST = -0.25


class Descent(NamedTuple):
    """State of the reference: the remaining share of the initial height, and the time of the last
    frame [s].
    """

    setup: Setup
    share: float = 1.0
    t: float = math.nan


@spec
class GoalLanding(Task):
    """Land on the target's origin: from the view `above` the reference descends while the craft is
    over the pad.

    Args:
        above: T_camera_target of the view from which the descent starts; its translation shrinks.
        descend_mps: descent rate [m/s].
        within_m, within_deg: the reference waits while the estimated lateral error or rotation
            error is larger [m, deg].
        commit_m: nearer than this to the pad the reference no longer waits [m].
        pad_m, touch_mps: largest distance from the pad's centre, and largest relative speed, of a
            successful touch-down [m, m/s].
    """

    kind: Literal["landing"] = "landing"
    above: Pose
    descend_mps: PositiveSpeed = 0.3
    within_m: PositiveLength = 0.15
    within_deg: PositiveAngle = 15.0
    commit_m: PositiveLength = 0.4
    pad_m: PositiveLength = 0.2
    touch_mps: PositiveSpeed = 0.5
    asks = "landing"
    bases = frozenset({"floating"})
    lands = True
    ends = Outcome.landed
    view_fields = ("goal.above",)

    def check(self, setup: Setup) -> None:
        super().check(setup)
        if setup.target.pad is None:
            raise ParameterError.missing(
                "target.pad", "goal of kind landing needs one, e.g. {side: 0.9}"
            )

    def goal_poses(self, target: Target, mount: Array) -> tuple[Array, ...]:
        return (self.above.T,)

    def goal_pose_at(self, setup: Setup, poses: tuple[Array, ...], t: float, view: int) -> Array:
        """Where the craft stands on the pad: the camera over its centre, the base at its standing
        height.
        """
        T = poses[view].copy()
        T[:3, 3] = 0.0
        # the base in the target's frame, whose z points down
        below_m = float(inverse(setup.camera.mount.T @ T)[2, 3])
        standing_m = setup.robot.body.standing_m if setup.robot.body else 0.0
        T[:3, 3] = (standing_m + below_m) * T[:3, 2]
        return T

    def begin(self, setup: Setup, views: tuple[Goal, ...]) -> Descent:
        return Descent(setup)

    def reference(self, state: Descent, seen: Observation) -> tuple[Descent, Goal]:
        """The view, which descends while the craft is over its pad by its own estimate."""
        setup = state.setup
        share = state.share
        goal = self._view_at(setup, share)
        # The first frame has no duration yet. Without an estimate the reference waits, too: `_over`
        # is False.
        if not math.isnan(state.t) and self._over(goal.T_camera_target, seen):
            height = float(np.linalg.norm(self.above.T[:3, 3]))
            share = max(DEEPEST, share - self.descend_mps * (seen.t - state.t) / height)
            goal = self._view_at(setup, share)
        return Descent(setup, share, seen.t), goal

    def _view_at(self, setup: Setup, share: float) -> Goal:
        """The view at a share of the initial height, with the errors of the calibration that the
        first view has.
        """
        T = self.above.T.copy()
        T[:3, 3] *= share
        return view_from(setup, lambda _: T)

    def _over(self, reference: Array, seen: Observation) -> bool:
        """Whether the craft tracks the reference (4, 4) closely enough for it to descend, or is
        nearer than `commit_m`.
        """
        T = seen.T_camera_target
        if T is None:
            return False
        whole = self.above.T
        down = whole[:3, 3] / np.linalg.norm(whole[:3, 3])
        # Both in the camera's frame: `away` is the tracking error of position, `down` the direction
        # of the descent.
        away = T[:3, 3] - reference[:3, 3]
        if float(T[:3, 3] @ down) < self.commit_m:
            return True
        # Along the descent twice as much: the craft lags behind a reference that sinks.
        sideways = away - (away @ down) * down
        turned = rotation_angle(T[:3, :3].T @ reference[:3, :3])
        ready = np.linalg.norm(sideways) < self.within_m and abs(away @ down) < 2 * self.within_m
        return bool(ready and np.degrees(turned) < self.within_deg)

    def monitor(self, setup: Setup, supervisor: Supervisor) -> LandingMonitor:
        return LandingMonitor(self, setup, supervisor)

    def judged(self, log: Log, stop: Stop) -> JudgedError:
        """True distance from the pad's centre, or speed, at the first contact: the one that is
        larger compared with its limit.
        """
        away = at_the_end(log, "task_error_m", self.pad_m)
        speed = at_the_end(log, "touch_mps", self.touch_mps, "m/s")
        if math.isnan(speed.value):
            return away
        return largest([away, speed])


class LandingMonitor(TaskMonitor):
    """Ends when the craft has set down: landed or collided, by the true place and speed of the
    first contact of a foot.

    Columns `task_error_m`: true horizontal distance of the craft from the pad's centre, from the
    first contact on the distance there [m]; `touch_mps`: its true speed relative to the pad at the
    first contact [m/s], NaN before.

    Attributes:
        offset_m: horizontal distance from the pad's centre at the first contact [m]; speed_mps:
            relative to the pad in the frame before it [m/s]; both NaN before.
    """

    error_columns = ("task_error_m", "touch_mps")

    def __init__(self, goal: GoalLanding, setup: Setup, supervisor: Supervisor):
        super().__init__(setup, 1, supervisor)
        self._goal = goal
        self.offset_m = self.speed_mps = math.nan
        self._t = math.nan
        self._speed = math.nan
        self._away: Array | None = None

    def task_error(self, frame: Frame) -> tuple[float, ...]:
        """Distance and speed; of the first contact, once there is one."""
        truth = frame.truth
        away = self.moved(
            frame.t, frame.T_world_base(self.mount_inverse), truth.T_world_target, bool(truth.feet)
        )
        return away, self.speed_mps

    def moved(self, t: float, T_world_craft: Array, T_world_target: Array, feet: bool) -> float:
        """Distance from the pad's centre [m] at these true poses (4, 4) and a time [s]; that of the
        first contact of `feet`.
        """
        away = T_world_craft[:3, 3] - T_world_target[:3, 3]
        # The speed of the frame before: in the frame of the contact the ground has already slowed
        # the craft.
        if feet and math.isnan(self.offset_m):
            self.offset_m = float(np.hypot(*away[:2]))
            self.speed_mps = self._speed
        if self._away is not None and t > self._t:
            self._speed = float(np.linalg.norm(away - self._away)) / (t - self._t)
        self._t = t
        self._away = away
        return float(np.hypot(*away[:2])) if math.isnan(self.offset_m) else self.offset_m

    def reached(self, frame: Frame) -> Verdict | None:
        """The verdict on the first contact, once the craft has set down; an error in the image does
        not decide a landing.
        """
        return self.on_contact if self.supervisor.down(frame.t) else None

    @property
    def on_contact(self) -> Verdict | None:
        """The verdict on the first contact; None before it."""
        if math.isnan(self.offset_m):
            return None
        goal = self._goal
        where = f"{100 * self.offset_m:.0f} cm from the pad's centre at {self.speed_mps:.2f} m/s"
        if self.offset_m <= goal.pad_m and self.speed_mps <= goal.touch_mps:
            return Outcome.landed, f"touched down {where}"
        far = [f"{100 * goal.pad_m:g} cm"] if self.offset_m > goal.pad_m else []
        fast = [f"{goal.touch_mps:g} m/s"] if self.speed_mps > goal.touch_mps else []
        return Outcome.collided, f"touched down {where}: more than {' and '.join(far + fast)}"
