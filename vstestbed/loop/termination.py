"""Termination: the verdict on each frame, from the task's monitor, the tests of safety and the
scenario's monitors.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from operator import mul
from typing import Any, NamedTuple

import numpy as np

from vstestbed.camera import Perspective
from vstestbed.core.errors import VstestbedError
from vstestbed.core.geometry import Array, inverse
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.laws import IBVS, QP, Hybrid, Law, Partitioned
from vstestbed.loop.controller import GUESS
from vstestbed.loop.stability import Stability
from vstestbed.robots.base import Supervisor
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.base import Truth
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.monitor import Setup, TaskMonitor, has_held, held_since, timed_out_words
from vstestbed.tasks.monitors import Monitor, checked

__all__ = ["FAR_M", "LostMarkers", "Termination"]

FAR_M = 200.0  # distance from the target beyond which the camera has diverged [m]
BLOCKED_S = 1.0  # how long a limit must block the robot before the run ends [s]
BLOCKED_SCALE = 0.02  # a command scaled to less than this is blocked by the limit

SIDES = "left", "top", "right", "bottom"  # the borders of a picture, as `Camera.borders` has them
# a marker whose image has less than so many times the least area is too small: its edge pixels do
# not count as its colour
SMALL = 1.5
POINTS = 32  # points of a marker's rim
Before = Callable[[Array, Array], tuple[str, ...]]
"""What stands before each of points (N, 3) of a camera at a pose (4, 4) (`Plant.names_before`)."""

BACK, LENS, BORDER, HIDDEN, TINY, UNKNOWN = range(6)
REMEDIES = {
    BACK: "start in front of the target, or turn target.pose",
    LENS: "a start that looks at the target, or a wider camera, would show it",
    BORDER: "a wider camera{law} would help",
    HIDDEN: "move what hides them, the start or the goal",
    TINY: (
        "larger markers (target.marker.radius), a nearer start or a longer focal length would help"
    ),
    UNKNOWN: (
        "why is not known: noise, light, or another object of their colour may be it;"
        " the film shows the picture"
    ),
}
"""What would help, by what happened; {law}: what `_minding` says."""
START = ", from the start on"


class Loss(NamedTuple):
    """Why a marker is not seen: which of the kinds above, in words, since when [s], and its radius
    in the picture [px] (NaN: not told).
    """

    kind: int
    words: str
    since_s: float
    radius_px: float = math.nan


def _from(t: float) -> str:
    return f"from {t:.2f} s on" if t else "from the start on"


class LostMarkers:
    """Remembers of each marker that is not seen where it was lost. before: tells what stands before
    points.
    """

    def __init__(self, scenario: Scenario, before: Before):
        self._scenario = scenario
        self._before = before
        detector = scenario.detector
        target = scenario.target
        # Others find points of the picture, a whole picture, an outline or lines: none of their
        # rows is lost by itself.
        single = detector.rows is None and not target.outlined and not target.stripes
        self._of_markers = single and not detector.needs_sheet and len(target.points) > 0
        self._limited = getattr(detector, "field_of_view", "limited") == "limited"
        self._least_area_px: float = getattr(detector, "least_area_px", None) or 0.0
        self._seen = np.ones(len(target.points), dtype=bool)
        self._whole = True
        self._lost: dict[int, Loss] = {}

    def add(self, frame: Frame) -> None:
        """Note which markers this frame lost, and which it found again."""
        # The usual frame first: nothing is lost, and nothing was.
        if not self._of_markers or (self._whole and frame.error.all_seen):
            return
        seen = frame.observation.seen
        if frame.goal.counted is not None:
            seen = seen | ~frame.goal.counted
        if (seen == self._seen).all():
            return
        for i in np.flatnonzero(seen).tolist():
            self._lost.pop(i, None)
        new = np.flatnonzero(self._seen & ~seen).tolist()
        if new:
            names = ("",) * len(seen)
            if self._limited:
                names = self._before(frame.truth.T_world_camera, frame.truth.p_camera)
            self._lost |= {i: self._loss(frame, i, names[i]) for i in new}
        self._seen = seen
        self._whole = bool(seen.all())

    def explained(self, reason: str) -> str:
        """A reason for which the run is over, with the sentence, which takes the place of what the
        robot could only guess.
        """
        where = self.sentence()
        if not where:
            return reason
        known = reason.replace(GUESS, "")
        if START.lstrip(", ") in where:
            known = known.removesuffix(START)
        return f"{known}; {where}"

    def sentence(self) -> str:
        """Which markers were lost where, when, and what would help; "" where none is lost."""
        groups: dict[tuple[int, str], list[int]] = {}
        for i, loss in sorted(self._lost.items()):
            groups.setdefault((loss.kind, loss.words), []).append(i)
        said = [self._group(members, words) for (_, words), members in groups.items()]
        kinds = sorted({kind for kind, _ in groups})
        law = _minding(self._scenario) if BORDER in kinds else ""
        return "; ".join(said + [REMEDIES[kind].format(law=law) for kind in kinds])

    def _group(self, members: list[int], words: str) -> str:
        """Of which markers what happened, and since when."""
        called = ", ".join(self._scenario.target.called(i) for i in members)
        head = f"marker {called} was" if len(members) == 1 else f"markers {called} were"
        losses = [self._lost[i] for i in members]
        sizes = sorted({f"{loss.radius_px:.2g}" for loss in losses}, key=float)
        size = sizes[0] if len(sizes) == 1 else f"{sizes[0]} to {sizes[-1]}"
        first = _from(min(loss.since_s for loss in losses))
        last = _from(max(loss.since_s for loss in losses))
        said = f"{head} {words.format(px=size)} {first}"
        return said if last == first else f"{said}, the last one {last}"

    def _loss(self, frame: Frame, i: int, name: str) -> Loss:
        target = self._scenario.target
        truth = frame.truth
        T_target_camera = inverse(truth.T_world_target) @ truth.T_world_camera
        if target.one_sided and T_target_camera[2, 3] >= 0:
            return Loss(BACK, "seen from behind", frame.t)
        rim = self._rim(truth.p_camera[i], T_target_camera, i)
        uv = self._scenario.camera.project(rim)
        if self._limited and (beyond := self._out_of_view(uv, truth.p_camera[i])):
            return Loss(*beyond, frame.t)
        if name:
            return Loss(HIDDEN, f"hidden by {name}", frame.t)
        if truth.hidden[i] or target.hides(T_target_camera)[i]:
            return Loss(HIDDEN, "hidden", frame.t)
        u, v = (uv - uv.mean(axis=0)).T
        # of a circle of its area
        radius = math.sqrt(abs(float(u @ np.roll(v, -1) - v @ np.roll(u, -1))) / (2 * math.pi))
        if radius**2 * math.pi < SMALL * self._least_area_px:
            least = math.sqrt(self._least_area_px / math.pi)
            finds = f"{self._scenario.detector.kind} finds {least:.2g} px and more"
            words = f"too small (a radius of {{px}} px; {finds}, of full colour)"
            return Loss(TINY, words, frame.t, radius)
        words = "not found although in the picture (with a radius of {px} px)"
        return Loss(UNKNOWN, words, frame.t, radius)

    def _rim(self, p_camera: Array, T_target_camera: Array, i: int) -> Array:
        """Points (POINTS, 3) round the rim of marker i, whose centre is at p_camera (3,): in its
        plane, of a ball across the ray.
        """
        target = self._scenario.target
        is_ball = target.marker.height_m >= target.marker.radius  # as high as wide
        facing = p_camera if is_ball else T_target_camera[:3, :3].T @ target.normals[i]
        a = np.cross(facing, np.eye(3)[int(np.argmin(np.abs(facing)))])
        b = np.cross(facing, a)
        a /= np.linalg.norm(a)
        b /= np.linalg.norm(b)
        angles: Array = np.linspace(0, 2 * math.pi, POINTS, endpoint=False)[:, None]
        return np.asarray(
            p_camera + target.marker.radius * (np.cos(angles) * a + np.sin(angles) * b), dtype=float
        )

    def _out_of_view(self, rim: Array, p_camera: Array) -> tuple[int, str] | None:
        """How a marker with a rim (POINTS, 2) [px] is outside of the picture; None where it is
        whole in it.
        """
        camera = self._scenario.camera
        if not np.isfinite(rim).all():
            behind = isinstance(camera, Perspective) and p_camera[2] <= 0
            return LENS, "behind the camera" if behind else "outside of what the lens sees"
        clear = camera.borders(rim)[0]
        side = int(np.argmin(clear.min(axis=0)))
        if len(camera.panels) > 1 or clear[:, side].min() >= 0:
            return None
        border = f"the {SIDES[side]} border" if clear.shape[1] == len(SIDES) else "the border"
        how = "beyond" if clear[:, side].max() < 0 else "cut by"
        return BORDER, f"{how} {border} of the picture"


def _minding(scenario: Scenario) -> str:
    """What else would help at the border: a nearer start, and those fields and laws that mind it
    and that the scenario takes.
    """
    law = scenario.law
    found: list[str] = []
    if isinstance(law, IBVS | Partitioned | Hybrid) and law.visibility.margin_px == 0:
        least = replace(law, visibility=replace(law.visibility, margin_px=1.0))
        if _takes(scenario, least):
            found.append("law.visibility")
    if not isinstance(law, QP) and _takes(scenario, QP()):
        found.append("law: qp")
    start = "a start nearer to the goal view"
    if not found:
        return f" or {start}"
    return f", {start}, or a law that minds the border ({', '.join(found)})"


def _takes(scenario: Scenario, law: Law[Any]) -> bool:
    try:
        replace(scenario, law=law)
    except VstestbedError:
        return False
    return True


def is_behind(T_world_target: Array, away: list[float]) -> bool:
    """Whether a camera `away` [m] from a target at a pose (4, 4) is behind its front, from which
    the target's z points away.
    """
    return sum(map(mul, away, T_world_target[:3, 2].tolist())) >= 0


DRIVEN_TO = (Outcome.target_lost, Outcome.diverged, Outcome.collided)
"""Ends to which a loop that swings or grows may drive a robot before its time is over."""


class Termination:
    """Decides by truth, measurements and commands whether a run is over; nothing of it comes back
    to the law.

    Precedence of several outcomes in one frame: a task aborted by the supervisor (unless the robot
    touches something), a task that is reached, the tests of safety in their order, the scenario's
    monitors, a task that is missed.

    task: has already measured the frame. setup: with the limits of the run, and the target.
    monitors: the scenario's, each with its kind. stability: tells a run that would end as
    `timed_out`, and is unstable. markers: tells where those are lost that are not seen.
    """

    def __init__(
        self,
        task: TaskMonitor,
        setup: Setup,
        supervisor: Supervisor,
        monitors: Sequence[tuple[str, Monitor]] = (),
        stability: Stability | None = None,
        markers: LostMarkers | None = None,
    ):
        self._task = task
        self._supervisor = supervisor
        self._duration_s = setup.stop.duration_s
        self._monitors = monitors
        self.stability = stability
        self._markers = markers
        # Where no loss ends a run, the camera may go behind its target.
        self._one_sided = setup.target.one_sided and setup.stop.loss_ends
        self._T_before: Array | None = None
        self._blocked_since = math.inf

    def verdict(self, frame: Frame) -> Verdict | None:
        """The outcome after this frame with its reason, or None to go on."""
        # All tests see every frame, whichever decides: they measure durations, and a tolerance that
        # was violated while the task was aborted stays violated when the supervisor resumes it.
        reached = self._task.reached(frame)
        missed = self._task.missed(frame)
        unsafe = self.unsafe(frame)
        ruled = [checked(kind, monitor.update(frame)) for kind, monitor in self._monitors]
        if self._markers is not None:
            self._markers.add(frame)
        if self.stability is not None:
            self.stability.add(frame)
        if self._supervisor.aborted and not self._touching(frame.truth):
            return self._after_abort(frame.t, self._supervisor.aborted)
        verdict = reached or unsafe or next(filter(None, ruled), None) or missed
        return verdict and self._told_apart(verdict)

    def unsafe(self, frame: Frame) -> Verdict | None:
        """The first of: a collision, divergence, the plane of the target crossed, a limit reached;
        to be asked once a frame. A target out of sight is the supervisor's matter.
        """
        truth = frame.truth
        T_target = truth.T_world_target
        away = (truth.T_world_camera[:3, 3] - T_target[:3, 3]).tolist()
        crossed = self._crossed(truth, T_target, away) if self._one_sided else None
        # A joint limit or a singular configuration has left nearly nothing of the command. "speed"
        # is no such limit: a command that is merely too fast is carried out more slowly.
        limit = frame.allocation.limit
        holds = limit in ("joint_limit", "singular") and frame.allocation.scale < BLOCKED_SCALE
        self._blocked_since = held_since(self._blocked_since, holds, frame.t)
        if collided := self._collision(truth):
            return collided
        if math.hypot(*away) > FAR_M:
            return Outcome.diverged, f"the camera is more than {FAR_M:g} m away from the target"
        if crossed:
            return crossed
        if not has_held(self._blocked_since, frame.t, BLOCKED_S):
            return None
        return Outcome[limit], f"for {BLOCKED_S:g} s {Outcome[limit].value}"

    def _touching(self, truth: Truth) -> str:
        """What touches now, as `forearm and floor`; "" where nothing does that may not: feet may
        not before they are to.
        """
        return truth.contact or ("" if self._supervisor.may_touch else truth.feet)

    def _collision(self, truth: Truth) -> Verdict | None:
        """Collided, with the reason of an earlier abort."""
        if not (touching := self._touching(truth)):
            return None
        words = f"contact of {touching}"
        if aborted := self._supervisor.aborted:
            words += f", after {aborted[1]}"
        return Outcome.collided, words

    def _crossed(self, truth: Truth, T_target: Array, away: list[float]) -> Verdict | None:
        """Lost, where the camera, `away` [m] from the target, is behind its front: from there no
        marker can be seen.
        """
        before, self._T_before = self._T_before, T_target
        if not is_behind(T_target, away):
            return None
        if before is None:
            words = "the camera starts behind the plane of the target, whose face it cannot see"
            return Outcome.target_lost, f"{words}; start in front of it, or turn target.pose"
        away_before = (truth.T_world_camera[:3, 3] - before[:3, 3]).tolist()
        crossed = is_behind(before, away_before)  # also of the target where it stood before
        words = (
            "the camera crossed the plane of the target"
            if crossed
            else "the target turned its back to the camera, or moved past it"
        )
        return Outcome.target_lost, words

    def _told_apart(self, verdict: Verdict) -> Verdict:
        """Unstable, of a run that has timed out because its loop swings or grows; where that drove
        it elsewhere, the reason says so. Where the frames do not tell, the reason at least names a
        gain over the limit of theory.
        """
        outcome, reason = verdict
        if self.stability is None or outcome not in (Outcome.timed_out, *DRIVEN_TO):
            return verdict
        how = self.stability.unstable(seen=outcome in DRIVEN_TO)
        if not how:
            over = self.stability.over_limit()
            return outcome, f"{reason}; {over}" if over else reason
        if outcome in DRIVEN_TO:
            return outcome, f"{reason}; before, the loop was unstable: {how}"
        if reason == timed_out_words(self._duration_s):
            return Outcome.unstable, how
        return Outcome.unstable, f"{reason}; {how}"

    def without_picture(self, t: float, truth: Truth) -> Verdict | None:
        """The outcome while no picture arrives [s]: of a collision, of an aborted task, or of the
        end of the duration.
        """
        if verdict := self._collision(truth):
            return verdict
        if self._supervisor.aborted:
            return self._after_abort(t, self._supervisor.aborted)
        if not self._over(t):
            return None
        return Outcome.timed_out, timed_out_words(self._duration_s)

    def _over(self, t: float) -> bool:
        return t >= self._duration_s - 1e-9

    def _after_abort(self, t: float, aborted: Verdict) -> Verdict | None:
        down = self._supervisor.down(t)
        if not (down or self._over(t)):
            return None
        outcome, reason = aborted
        if self._markers is not None and outcome is Outcome.target_lost:
            reason = self._markers.explained(reason)
        how = self._supervisor.DOWN[0 if down else 1]
        return self._told_apart((outcome, f"{reason}; {how}" if how else reason))
