"""Overlay of a run's films: markers, trails, a line of numbers. Drawn in place, at the same cost
for every frame.

Pixels follow the project's convention, which is OpenCV's: (0, 0) is the centre of the first pixel.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.geometry import Array, inverse, pose_from
from vstestbed.core.lazy import cv2
from vstestbed.loop.columns import POSE
from vstestbed.report.video.writer import Image
from vstestbed.scenario.distributions import GOAL_STREAM
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.base import SceneState
from vstestbed.sim.replay import Replay
from vstestbed.tasks.frame import Frame

__all__ = [
    "ALARM",
    "GOOD",
    "HOLD_S",
    "INK",
    "PAPER",
    "SHIFT",
    "SMALL",
    "UNIT",
    "Color",
    "FilmFrame",
    "Overlay",
    "Residual",
    "captioned",
    "draw_banner",
    "draw_ending",
    "draw_text",
    "named",
    "overlay_of",
    "shortened",
    "strip_height",
    "text_width",
]

Color = tuple[int, int, int]

INK: Color = (18, 20, 24)
PAPER: Color = (245, 246, 248)
MUTED: Color = (186, 192, 200)
ALARM: Color = (200, 30, 45)
GOOD: Color = (24, 122, 62)
GOAL: Color = (72, 214, 255)
"""Of goals that have no colour of their own, and of a region's, which would not stand out from the
region in its colour.
"""
WAY: Color = (255, 255, 255)
WAYS = 8  # At most so many of the points of an outline have such a line
HOLD_S = 1  # How long the last picture of a film stays [s]
SHIFT = 4
UNIT = 1 << SHIFT  # OpenCV draws on a grid of 1/16 px
# Height up to which an image, as an inset, has symbols without a dark edge, which would hide their
# colours [px]
SMALL = 240
OPEN = 0.6  # Share of a cross that is open in its middle, where the marker is
LEAST = 5.0, 11.0
"""Least size of a symbol in an inset, and in a larger image, whose thicker lines would otherwise
close over the marker [px].
"""
MOST_POINTS = 512  # of a trail, so that each frame takes as long to draw


class Trail:
    """Trajectory of one marker in the image: the last MOST_POINTS points, a new one every few
    pixels.
    """

    def __init__(self, spacing_px: float):
        self._spacing = spacing_px
        self._points = np.empty((0, 2))

    def add(self, uv: Array) -> None:
        """Extend to pixel uv (2,); NaN (not seen) leaves a gap."""
        last = self._points[-1] if len(self._points) else np.full(2, np.nan)
        if math.hypot(*(uv - last)) < self._spacing or (
            np.isnan(uv).any() and np.isnan(last).any()
        ):
            return
        self._points = np.vstack([self._points, uv])[-MOST_POINTS:]

    def polylines(self) -> list[NDArray[np.int32]]:
        """The polylines to draw, each (K, 1, 2) on the grid of 1/16 px."""
        known = np.flatnonzero(np.isfinite(self._points).all(axis=1))
        whole = np.rint(self._points[known] * UNIT).astype(np.int32)[:, None]
        return [
            piece for piece in np.split(whole, np.flatnonzero(np.diff(known) > 1) + 1) if len(piece)
        ]


class Overlay:
    """Draws on the servo camera's images: a cross at each measured marker, its trail, and a diamond
    at its goal.

    Of a region both outlines, white as measured and cyan at the goal, thin lines between some of
    their points, and the trail of its middle.

    Args:
        width, height: image size [px]; all sizes scale with the height. colors: the markers'
            colours, shape (N, 3) in 0..1.
        outlined: the markers are the outline of a region (`Target.outlined`).
        joined: draw the polygon through the measured markers, the outline of a plane tracked whole.
    """

    def __init__(
        self, width: int, height: int, colors: Array, outlined: bool = False, joined: bool = False
    ):
        self.size = (width, height)
        self._joined = joined
        self._colors = _bytes(colors)
        # lighter, or blue and violet would not stand out from their dark borders
        self._light = _bytes(0.7 * np.asarray(colors) + 0.3)
        self._stroke = max(1, round(height / 480))
        self._edge = self._stroke if height > SMALL else 0
        self._least = LEAST[height > SMALL]
        # yuv420p stores colour for blocks of 2 x 2 pixels: thinner lines turn grey
        self._figure_stroke = math.ceil(height / 240)
        self._outlined = outlined
        self._trails = [
            Trail(max(2.0, height / 240)) for _ in (self._colors[:1] if outlined else self._colors)
        ]

    def draw(self, image: Image, uv: Array, goal_uv: Array | None, lost: bool = False) -> None:
        """Draw one frame's state on `image` (height, width, 3), uint8, RGB, in place.

        `uv`, `goal_uv`: measured markers, NaN where not seen, and their goals, if the task has any
        [px], shape (N, 2). lost: whether the target is lost, which a banner shows.
        """
        self.marks(image, uv, goal_uv)
        if lost:
            draw_banner(image, "TARGET LOST")

    def marks(self, image: Image, uv: Array, goal_uv: Array | None) -> None:
        """Draw trails, goals and measured markers alone."""
        uv = self._drawable(uv)
        if self._outlined:
            self._outlines(image, uv, goal_uv)
            return
        for trail, color, point in zip(self._trails, self._colors, uv, strict=True):
            trail.add(point)
            cv2.polylines(image, trail.polylines(), False, color, self._stroke, cv2.LINE_AA, SHIFT)
        if self._joined and np.isfinite(uv).all():
            outline = [np.rint(uv * UNIT).astype(np.int32)]
            cv2.polylines(image, outline, True, INK, self._stroke + 2, cv2.LINE_AA, SHIFT)
            cv2.polylines(image, outline, True, PAPER, self._stroke, cv2.LINE_AA, SHIFT)
        if goal_uv is not None:
            self._strokes(
                image,
                self._drawable(goal_uv),
                _DIAMOND,
                max(self._least, self.size[1] / 36),
                closed=True,
            )
        self._strokes(image, uv, _CROSS, max(self._least, self.size[1] / 40), closed=False)

    def _outlines(self, image: Image, uv: Array, goal_uv: Array | None) -> None:
        """Draw the outline (N, 2) as measured and at the goal, and the trail of its middle."""
        trail = self._trails[0]
        trail.add(uv.mean(axis=0))
        cv2.polylines(
            image, trail.polylines(), False, self._colors[0], self._stroke, cv2.LINE_AA, SHIFT
        )
        goal = np.full_like(uv, np.nan) if goal_uv is None else self._drawable(goal_uv)
        some = slice(None, None, math.ceil(len(uv) / WAYS))
        self._ways(image, uv[some], goal[some])
        for points, color, width in ((goal, GOAL, self._figure_stroke), (uv, PAPER, self._stroke)):
            if np.isfinite(points).all():
                line = [np.rint(points * UNIT).astype(np.int32)]
                cv2.polylines(
                    image, line, True, INK, width + 2 * max(self._edge, 1), cv2.LINE_AA, SHIFT
                )
                cv2.polylines(image, line, True, color, width, cv2.LINE_AA, SHIFT)

    def _ways(self, image: Image, uv: Array, goal: Array) -> None:
        """Draw a thin line from each point to its goal, both (N, 2), where both are known; one
        under 2 px would only blur its two ends.
        """
        ways = np.stack([goal, uv], axis=1)[np.linalg.norm(goal - uv, axis=1) > 2.0]
        lines = list(np.rint(ways[:, :, None] * UNIT).astype(np.int32))
        for color, width in ((INK, 2 * self._stroke + self._edge), (WAY, self._stroke)):
            cv2.polylines(image, lines, False, color, width, cv2.LINE_AA, SHIFT)

    def _drawable(self, uv: Array) -> Array:
        """The pixels, NaN where they are so far outside that OpenCV's fixed-point integers would
        overflow.
        """
        limit = 4.0 * max(self.size)
        return np.where((np.abs(uv) < limit).all(axis=1, keepdims=True), uv, np.nan)

    def _strokes(self, image: Image, uv: Array, shape: Array, size: float, closed: bool) -> None:
        """Draw a small symbol at every finite pixel, in the marker's colour with a dark border;
        shape: polylines (lines, points, 2).
        """
        seen: NDArray[np.bool_] = np.isfinite(uv[:, 0]) & np.isfinite(uv[:, 1])
        lines = np.rint((uv[seen, None, None] + shape * size) * UNIT).astype(np.int32)
        cv2.polylines(
            image,
            list(lines.reshape(-1, shape.shape[1], 2)),
            closed,
            INK,
            self._figure_stroke + self._edge,
            cv2.LINE_AA,
            SHIFT,
        )
        for color, figure in zip(
            (c for c, s in zip(self._light[: len(uv)], seen, strict=True) if s), lines, strict=True
        ):
            cv2.polylines(
                image, list(figure), closed, color, self._figure_stroke, cv2.LINE_AA, SHIFT
            )


def _bytes(colors: Array) -> list[Color]:
    return [(int(r), int(g), int(b)) for r, g, b in np.rint(np.asarray(colors) * 255)]


_CROSS = np.array(
    [[[i, j], [OPEN * i, OPEN * j]] for i, j in ((-1.0, 0.0), (1.0, 0.0), (0.0, -1.0), (0.0, 1.0))]
)
_DIAMOND = np.array([[[0.0, -1.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0]]])

# OpenCV's own proportional font: no system font is used, so that films are the same bytes
# everywhere
_FONT = cv2.FontFace("sans")


def captioned(image: Image, title: str, strip: int, *, t: float, error: str) -> Image:
    """The image with a strip of this height [px] below it: time [s], error in words and, if there
    is room, a title.
    """
    height, width = image.shape[:2]
    size = text_size(height)
    found = np.empty((height + strip, width, 3), np.uint8)
    found[:height], found[height:] = image, INK
    base, pad = _base(height, strip), round(0.7 * size)
    error_at = pad + round(5.2 * size)
    draw_text(found, f"{t:.2f} s", (pad, base), PAPER, size)
    draw_text(found, error, (error_at, base), PAPER, size)
    title_at = width - pad - text_width(title, size)
    if title and title_at > error_at + 9.5 * size:
        draw_text(found, title, (title_at, base), MUTED, size)
    return found


def draw_ending(image: Image, strip: int, words: str, reason: str, color: Color) -> None:
    """Write how a run ended, in bold, and why, if all of it fits, on the strip below an image,
    right of the time, in place.
    """
    height, width = image.shape[0] - strip, image.shape[1]
    size = text_size(height)
    left, right, base = round(5.4 * size), width - round(0.7 * size), _base(height, strip)
    image[height:, left:] = color
    left += round(0.5 * size)
    draw_text(
        image, shortened(words, size, right - left, 600), (left, base), PAPER, size, weight=600
    )
    at = left + text_width(words, size, 600) + size
    if at + text_width(reason, size) <= right:
        draw_text(image, reason, (at, base), PAPER, size)


def _base(height: int, strip: int) -> int:
    """The base line of text that is centred in the strip below an image of that height [px]."""
    return height + round(0.5 * strip + 0.36 * text_size(height))


def text_size(height: int) -> int:
    """Size of a caption's text below an image of that height [px]."""
    return max(11, round(height / 28))


def strip_height(height: int) -> int:
    """Height of the caption below an image of that height [px], even: H.264 stores colour for 2 x 2
    pixels.
    """
    return 2 * round(0.85 * text_size(height))


def draw_banner(image: Image, words: str, color: Color = ALARM) -> None:
    """White text on a coloured box at the top centre of the image, shortened to its width, in
    place.
    """
    height, width = image.shape[:2]
    size = max(13, round(height / 18))
    words = shortened(words, size, width - 3 * size, weight=600)
    text = text_width(words, size, weight=600)
    left, top = (width - text) // 2, round(0.06 * height)
    cv2.rectangle(
        image, (left - size, top), (left + text + size, top + round(1.8 * size)), color, -1
    )
    draw_text(image, words, (left, top + round(1.26 * size)), PAPER, size, weight=600)


def shortened(words: str, size: int, width: int, weight: int = 400) -> str:
    """The text, with its middle replaced by an ellipsis if it does not fit into `width` [px]."""
    for kept in range(len(words), 0, -1):
        head = (kept + 1) // 2
        text = (
            words
            if kept == len(words)
            else f"{words[:head].rstrip()}\u2026{words[len(words) - kept + head :].lstrip()}"
        )
        if text_width(text, size, weight) <= width:
            return text
    return ""


def named(image: Image, name: str) -> None:
    """Write the name of a camera on a dark box in the lower left corner of its picture,
    in place.
    """
    height, size = image.shape[0], text_size(image.shape[0])
    width = text_width(name, size) + size
    cv2.rectangle(image, (0, height - round(1.6 * size)), (width, height), INK, -1)
    draw_text(image, name, (size // 2, height - round(0.5 * size)), PAPER, size)


def draw_text(
    image: Image, words: str, at: tuple[int, int], color: Color, size: int, weight: int = 400
) -> None:
    """Write text from pixel `at` (left end of the base line), `size` [px] high, in place."""
    cv2.putText(image, words, at, color, _FONT, size, weight)


@lru_cache(maxsize=64)
def text_width(words: str, size: int, weight: int = 400) -> int:
    """Width of a text at that size [px]."""
    return int(cv2.getTextSize((0, 0), words, (0, 0), _FONT, size, weight)[2])


# The state of one frame as a film shows it, from a running loop or from a log.
@dataclass(frozen=True, slots=True)
class FilmFrame:
    """State of one frame as a film shows it."""

    t: float
    T_world_target: Array
    T_world_camera: Array
    q: Array
    uv: Array
    error_px: float
    lost: bool
    goal_uv: Array
    own: Array  # values of the robot's and the task's own columns
    image: Image | None = None  # the servo camera's image, if it was rendered already
    # the picture taken at the goal, if law or detector compare with one
    goal_image: Image | None = None
    # what further cameras showed last, by name
    cameras: Mapping[str, OtherPicture] = field(default_factory=dict[str, "OtherPicture"])

    @property
    def state(self) -> SceneState:
        """Of the scene."""
        return SceneState(self.t, self.T_world_target, self.q, self.T_world_camera)

    @classmethod
    def of_frame(cls, frame: Frame) -> FilmFrame:
        """A frame of a running loop."""
        truth, error = frame.truth, frame.error
        shown = None if frame.goal.image is None else frame.goal.image.image
        scene = (truth.T_world_target, truth.T_world_camera, truth.q)
        others = {
            name: OtherPicture(record.uv, record.goal_uv, record.image)
            for name, record in frame.cameras.items()
        }
        return cls(
            frame.t,
            *scene,
            frame.observation.uv,
            error.rms_px,
            error.lost,
            frame.goal.uv,
            frame.row,
            frame.image,
            shown,
            others,
        )

    @classmethod
    def of_row(cls, row: dict[str, float], scenario: Scenario) -> FilmFrame:
        """The frame of one row of a log."""
        joints, markers = scenario.robot.joints, scenario.rows
        camera, target = (
            np.array([row[f"{who}_{name}"] for name in POSE]) for who in ("cam", "tgt")
        )
        return cls(
            t=row["t"],
            T_world_target=pose_from(target[:3], target[3:]),
            T_world_camera=pose_from(camera[:3], camera[3:]),
            q=np.array([row[f"q_{name}"] for name in joints]),
            uv=_markers(row, "", markers),
            error_px=row["error_px"],
            lost=bool(row["lost"]),
            goal_uv=_markers(row, "_goal", markers),
            own=np.array([row[name] for name in scenario.own_columns]),
            cameras={
                name: OtherPicture(
                    _markers(row, "", markers, f"{name}_"),
                    _markers(row, "_goal", markers, f"{name}_"),
                )
                for name in scenario.eyes
            },
        )


@dataclass(frozen=True, slots=True)
class OtherPicture:
    """What a further camera showed: markers as measured and at the goal (N, 2) [px], and its image,
    if it was rendered already.
    """

    uv: Array
    goal_uv: Array
    image: Image | None = None


def _markers(row: dict[str, float], which: str, markers: int, before: str = "") -> Array:
    """Pixels (N, 2) of a row of a log; before: what stands before the names of their columns."""
    return np.array(
        [[row[f"{before}u{which}_{i}"], row[f"{before}v{which}_{i}"]] for i in range(markers)]
    ).reshape(markers, 2)


# The difference of picture and goal picture, which a law of grey levels sees, as an inset of the
# camera's film.
SHARE = 1 / 3  # Width of the inset over that of the film
WORDS = "picture \u2212 goal"  # What the inset is called
EDGE = 2  # Width of its edge [px]
ZERO = 128  # Grey of a pixel without a difference; a difference of d grey levels is ZERO + d/2


class Residual:
    """Draws I - I* into the upper right corner, under its name: mid-grey is no difference, lighter
    is lighter than the goal's picture.
    """

    def __init__(self, scenario: Scenario, replay: Replay):
        self._scenario, self._replay = scenario, replay
        self._goal: dict[int, Image] = {}

    def put(self, film: Image, seen: Image, frame: FilmFrame, view: int) -> None:
        """Draw the inset on a film's picture, in place; seen: the camera's image of the frame."""
        goal = self._goal_image(frame, view)
        difference = cv2.subtract(_grey(seen), _grey(goal), dtype=cv2.CV_16S)
        shown = cv2.convertScaleAbs(difference.astype(np.float32) / 2 + ZERO)
        width = round(SHARE * film.shape[1])
        height = round(width * seen.shape[0] / seen.shape[1])
        small = np.asarray(
            cv2.cvtColor(
                cv2.resize(shown, (width, height), interpolation=cv2.INTER_AREA), cv2.COLOR_GRAY2RGB
            ),
            np.uint8,
        )
        _label(small, text_size(film.shape[0]))
        film[: height + EDGE, -(width + EDGE) :] = PAPER
        film[:height, -width:] = small

    def _goal_image(self, frame: FilmFrame, view: int) -> Image:
        """The goal's picture: of a running loop its own, of a log taken again."""
        if frame.goal_image is not None:
            return frame.goal_image
        if view in self._goal:
            return self._goal[view]
        s = self._scenario
        said = s.goal.pictures[view] if s.goal.pictures else None
        if said is not None and said.source is not None:
            return self._goal.setdefault(view, said.read(s.camera))
        T_world_goal = frame.T_world_target @ inverse(s.goal_poses[view])
        # Of a scene of its own: the target as it was before `noise.target`, and no picture that
        # others take for one of the run.
        with closing(self._replay.of_target(s.target)) as taught:
            size = s.camera.width, s.camera.height
            state = frame.state._replace(T_world_camera=T_world_goal)
            image = taught.picture("eye", size, state).copy()
        return self._goal.setdefault(
            view, image if said is None else said.under_its_light(image, s.rng(GOAL_STREAM))
        )


def _label(image: Image, size: int) -> None:
    """Write what the inset shows on a darkened strip along its top, since what is below may be
    light or dark; size: of the text [px].
    """
    strip = image[: round(1.5 * size)]
    cv2.convertScaleAbs(strip, strip, 0.35)
    draw_text(
        image,
        shortened(WORDS, size, image.shape[1] - size),
        (size // 2, round(1.15 * size)),
        PAPER,
        size,
    )


def _grey(image: Image) -> Image:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)


# Overlay of matches: lines from natural features to where the goal's picture has them.
MEASURED: Color = (255, 214, 64)


class MatchOverlay(Overlay):
    """Draws each of `rows` matched points, a ring where the goal's picture has it, and a line
    between; no trails: points come and go.
    """

    def __init__(self, width: int, height: int, rows: int):
        super().__init__(width, height, np.ones((rows, 3)))
        self._point, self._ring = max(1.6, height / 140), max(4.0, height / 75)

    def marks(self, image: Image, uv: Array, goal_uv: Array | None) -> None:
        uv = self._drawable(uv)
        seen = np.isfinite(uv).all(axis=1)
        if goal_uv is not None:
            goal = self._drawable(goal_uv)
            both = seen & np.isfinite(goal).all(axis=1)
            self._ways(image, uv[both], goal[both])
            self._rings(image, goal[both], GOAL, self._stroke)
        self._rings(image, uv[seen], MEASURED, -1)

    def _rings(self, image: Image, uv: Array, color: Color, width: int) -> None:
        """A circle at each pixel, filled where the width is negative, with a dark border."""
        size = self._ring if width > 0 else self._point
        for u, v in np.rint(uv * UNIT).astype(int).tolist():
            border = width + 2 * self._stroke if width > 0 else -1
            cv2.circle(
                image,
                (u, v),
                round((size + (self._stroke if width < 0 else 0)) * UNIT),
                INK,
                border,
                cv2.LINE_AA,
                SHIFT,
            )
            cv2.circle(image, (u, v), round(size * UNIT), color, width, cv2.LINE_AA, SHIFT)


def overlay_of(scenario: Scenario, size: tuple[int, int]) -> Overlay:
    """The overlay for what a scenario's detector reports;
    size: (width, height) of the image [px].
    """
    if scenario.detector.changing:
        return MatchOverlay(*size, scenario.rows)
    colors, outlined = scenario.target.colors[: scenario.rows], scenario.target.outlined
    return Overlay(*size, colors, outlined, joined=scenario.detector.needs_sheet)
