"""Safety monitors, which end a run whatever its task: collision, divergence, a crossed target plane, joint limit, singularity."""

from __future__ import annotations

import math
from operator import mul

from vstestbed.core.geometry import Array
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.robots.supervisor import Supervisor
from vstestbed.sim.base import Truth
from vstestbed.targets import Target
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.monitor import HoldTimer
from vstestbed.tasks.monitors import Monitor
from vstestbed.tasks.stop import Stop

FAR_M = 200.0
"""Distance from the target beyond which the camera has diverged [m]."""
FAR_WORDS = f"the camera is more than {FAR_M:g} m away from the target"
CROSSED_WORDS = "the camera crossed the plane of the target"
BEHIND_WORDS = "the camera starts behind the plane of the target, whose face it cannot see; start in front of it, or turn target.pose"
TURNED_WORDS = "the target turned its back to the camera, or moved past it"
BLOCKED_S = 1.0
"""How long a limit must block the robot before the run ends [s]."""
BLOCKED_SCALE = 0.02
"""A command scaled to less than this is blocked by the limit."""


class Collision:
    """The robot touches something, or its feet do before they are allowed to."""

    def __init__(self, supervisor: Supervisor):
        self._supervisor = supervisor

    def touches(self, truth: Truth) -> str:
        """What touches now, as `forearm and floor`; "" where nothing does that may not."""
        return truth.contact or ("" if self._supervisor.may_touch else truth.feet)

    def update(self, frame: Frame) -> Verdict | None:
        """Collided, with the reason of an earlier abort."""
        return self.verdict(frame.truth)

    def verdict(self, truth: Truth) -> Verdict | None:
        """The same, of the truth alone."""
        touching = self.touches(truth)
        if not touching:
            return None
        aborted = self._supervisor.aborted
        return Outcome.collided, f"contact of {touching}{f', after {aborted[1]}' if aborted else ''}"


class Divergence:
    """The camera is very far from its target."""

    def update(self, frame: Frame) -> Verdict | None:
        """Diverged, beyond FAR_M."""
        if math.hypot(*_from_target(frame)) > FAR_M:
            return Outcome.diverged, FAR_WORDS
        return None


class PlaneCrossed:
    """The camera is behind a target that has markers on its front only."""

    def __init__(self) -> None:
        self._T_world_target: Array | None = None

    def update(self, frame: Frame) -> Verdict | None:
        """Lost: from there no marker can be seen."""
        before, self._T_world_target = self._T_world_target, frame.truth.T_world_target
        if not _is_behind(frame, self._T_world_target):
            return None
        if before is None:
            return Outcome.target_lost, BEHIND_WORDS
        return Outcome.target_lost, CROSSED_WORDS if _is_behind(frame, before) else TURNED_WORDS


class LimitReached:
    """A joint limit or a singular configuration leaves nearly nothing of the command."""

    def __init__(self) -> None:
        self._timer = HoldTimer()

    def update(self, frame: Frame) -> Verdict | None:
        """The limit's outcome, after BLOCKED_S."""
        # "speed" is no such limit: a command that is merely too fast is carried out more slowly.
        limit = frame.allocation.limit
        blocked = limit in ("joint_limit", "singular") and frame.allocation.scale < BLOCKED_SCALE
        if self._timer.lasting(blocked, frame.t) < BLOCKED_S:
            return None
        return Outcome[limit], f"for {BLOCKED_S:g} s {Outcome[limit].value}"


def _is_behind(frame: Frame, T_world_target: Array) -> bool:
    """Whether the camera is behind the front of a target at a pose (4, 4), whose z points away from a camera in front of it."""
    away = (frame.truth.T_world_camera[:3, 3] - T_world_target[:3, 3]).tolist()
    return sum(map(mul, away, T_world_target[:3, 2].tolist())) >= 0


def _from_target(frame: Frame) -> list[float]:
    """The camera's position from the target's origin, in world axes (3,) [m]."""
    return (frame.truth.T_world_camera[:3, 3] - frame.truth.T_world_target[:3, 3]).tolist()


def safety_monitors(target: Target, collision: Collision, stop: Stop) -> tuple[Monitor, ...]:
    """The monitors of a run in the order of their precedence; a target out of sight is the supervisor's matter."""
    return collision, Divergence(), *((PlaneCrossed(),) if target.one_sided and stop.loss_ends else ()), LimitReached()
