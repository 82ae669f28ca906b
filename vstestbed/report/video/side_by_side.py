"""The same seed flown by several controllers: their films side by side, in step with simulated time."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.report.video.frame_reader import FrameReader, scaled
from vstestbed.report.video.overlay import ALARM, INK, PAPER, Color, draw_banner, draw_text, shortened, text_width
from vstestbed.report.video.writer import Image, VideoWriter

MOST: Final = 6
WIDEST: Final = 1926  # [px], of all columns
COLUMN: Final = 480  # [px]: its text still reads well, and its frame takes half the time of 640
GAP: Final = 2  # [px]
HOLD_S: Final = 1
SHAPE: Final = 3 / 4  # of the place of a film that no run has
FASTEST_HZ: Final = Fraction(50)
DIMMED: Final = 0.6
GREY: Final[Color] = (96, 100, 108)
GOOD: Final[Color] = (24, 122, 62)
NEUTRAL: Final[Color] = (56, 64, 76)


@dataclass(frozen=True, slots=True)
class Column:
    """One controller's run.

    Args:
        label: stands over the films; its middle is left out where it is too long.
        films: its films from top to bottom; one that is missing or empty is a grey picture.
        ending: how and when the run ended, such as `converged 12.3 s`.
        success: colours the ending green or red; None leaves it grey.
    """

    label: str
    films: tuple[Path, ...]
    ending: str
    success: bool | None = None


def side_by_side(columns: Sequence[Column], path: Path, rate_hz: float | None = None) -> Path | None:
    """Film runs next to each other, each picture at its simulated time, with one clock below.

    A run that has ended keeps its last picture, dimmed, with its ending on it. One second after the longest the film
    ends. Of every film two pictures are in memory at a time.

    Args:
        columns: 1 to 6 runs, from left to right. path: the film (`.mp4`).
        rate_hz: of the film [Hz]; default the highest of the films', at most 50.

    Returns:
        The path; None where no column has a film, and then there is none.

    Raises:
        ParameterError: no column or more than 6, or a rate that is not positive.
        EnvironmentLackError: no H.264 encoder, no space. OutputError: the folder cannot be written.
    """
    if not 0 < len(columns) <= MOST:
        raise ParameterError("columns", f"must be 1 to {MOST} runs", len(columns))
    with ExitStack() as open_films:
        reels = [[FrameReader(film) for film in column.films] for column in columns]
        for reel in (reel for column in reels for reel in column):
            open_films.callback(reel.close)
        fastest = max((reel.rate_hz for column in reels for reel in column), default=Fraction(0))
        if not fastest:
            return None
        sheet = _Sheet(columns, reels)
        writer = open_films.enter_context(VideoWriter(path, float(min(fastest, FASTEST_HZ)) if rate_hz is None else rate_hz))
        frame = 0
        while sheet.show(frame / writer.rate):
            writer.write(sheet.image)
            frame += 1
        for _ in range(max(1, round(HOLD_S * writer.rate))):
            writer.write(sheet.image)
    return writer.path


class _Sheet:
    """The picture that all columns share."""

    def __init__(self, columns: Sequence[Column], reels: list[list[FrameReader]]):
        width = min(COLUMN, (WIDEST + GAP) // len(columns) - GAP) // 2 * 2
        self._size = max(15, width // 28)
        self._bar = 2 * self._size // 2 * 2
        heights = [_row_height([column[row] for column in reels if row < len(column)], width) for row in range(max(map(len, reels)))]
        total = 2 * self._bar + sum(heights)
        self.image: Image = np.full((total, len(columns) * (width + GAP) - GAP, 3), PAPER, np.uint8)
        self._foot = self.image[total - self._bar :]
        self._strips = []
        for k, (column, own) in enumerate(zip(columns, reels, strict=True)):
            left = k * (width + GAP)
            part = self.image[: total - self._bar, left : left + width]
            self._label(part[: self._bar], column.label)
            self._strips.append(_Strip(part[self._bar :], column, own, heights))

    def show(self, t: Fraction) -> bool:
        """Bring everything to time t [s]; False when all runs have ended."""
        running = [strip.show(t) for strip in self._strips]
        if any(running):
            self._clock(float(t))
        return any(running)

    def _label(self, bar: Image, words: str) -> None:
        words = shortened(words, self._size, bar.shape[1] - 2 * self._size, weight=600)
        left = (bar.shape[1] - text_width(words, self._size, 600)) // 2
        draw_text(bar, words, (left, self._base), INK, self._size, weight=600)

    def _clock(self, t: float) -> None:
        self._foot[:] = INK
        left = (self._foot.shape[1] - text_width("00.00 s", self._size)) // 2  # the same place for every time
        draw_text(self._foot, f"{t:.2f} s", (left, self._base), PAPER, self._size)

    @property
    def _base(self) -> int:
        """Base line of words in a bar [px]."""
        return round(0.5 * self._bar + 0.36 * self._size)


class _Strip:
    """One column's films on its part of the sheet, a view of shape (H, width, 3)."""

    def __init__(self, image: Image, column: Column, reels: list[FrameReader], heights: list[int]):
        self._image, self._column, self._top = image, column, image[: heights[0]]
        self._shown: list[tuple[FrameReader, Image]] = []
        self._over = False
        image[:] = INK
        for row, place in enumerate(np.split(image, np.cumsum(heights)[:-1])):
            if row < len(reels) and reels[row].rate_hz:
                self._shown.append((reels[row], _centred(place, reels[row])))
            else:
                _blank(place, "no film")

    def show(self, t: Fraction) -> bool:
        """Bring the films to time t [s]; False when the run has ended."""
        if self._over:
            return False
        for reel, place in self._shown:
            picture = reel.due(t)
            if picture is not None:
                place[:] = scaled(picture, place.shape[1], place.shape[0])
        if all(reel.ended(t) for reel, _ in self._shown):
            self._over = True
            self._image[:] = cv2.convertScaleAbs(self._image, alpha=DIMMED)
            draw_banner(self._top, self._column.ending, {True: GOOD, False: ALARM, None: NEUTRAL}[self._column.success])
        return not self._over


def _row_height(reels: list[FrameReader], width: int) -> int:
    """Height of the highest of these films at that width, even [px]."""
    return max((_scaled_height(reel, width) for reel in reels if reel.rate_hz), default=round(width * SHAPE / 2) * 2)


def _scaled_height(reel: FrameReader, width: int) -> int:
    return max(2, round(width * reel.height / reel.width / 2) * 2)


def _centred(place: Image, reel: FrameReader) -> Image:
    """The part of the place that the film fills."""
    height = _scaled_height(reel, place.shape[1])
    top = (place.shape[0] - height) // 4 * 2
    return place[top : top + height]


def _blank(place: Image, words: str) -> None:
    """A grey picture with words in its middle."""
    place[:] = GREY
    height, width = place.shape[:2]
    size = max(13, height // 18)
    draw_text(place, words, ((width - text_width(words, size)) // 2, (height + size) // 2), PAPER, size)
