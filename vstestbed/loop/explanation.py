"""Why a run ended as it did: where its markers were lost and what would help; a loop that was
unstable.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from vstestbed.camera import Perspective
from vstestbed.core.errors import VstestbedError
from vstestbed.core.geometry import Array, inverse
from vstestbed.core.outcome import Outcome, Verdict
from vstestbed.laws import IBVS, QP, Hybrid, Law, Partitioned
from vstestbed.loop.controller import GUESS
from vstestbed.loop.stability import Stability
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.monitor import timed_out_words

__all__ = ["Explanation", "LostMarkers"]

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


DRIVEN_TO = (Outcome.target_lost, Outcome.diverged, Outcome.collided)
"""Ends to which a loop that swings or grows may drive a robot before its time is over."""


class Explanation:
    """Says of a run that ends badly where its markers were lost, and whether its loop was unstable.

    before: tells what stands before points. stability: None where the commands are not the law's.
    """

    def __init__(self, scenario: Scenario, before: Before):
        self._duration_s = scenario.stop.duration_s
        self._markers = LostMarkers(scenario, before)
        self.stability: Stability | None = Stability(scenario)

    def add(self, frame: Frame) -> None:
        """One more frame."""
        self._markers.add(frame)
        if self.stability is not None:
            self.stability.add(frame)

    def lost(self, verdict: Verdict) -> str:
        """The reason of a task that was given up, with where its markers were lost."""
        outcome, reason = verdict
        return self._markers.explained(reason) if outcome is Outcome.target_lost else reason

    def explained(self, verdict: Verdict) -> Verdict:
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
