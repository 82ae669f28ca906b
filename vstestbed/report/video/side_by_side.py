"""Films of several controllers side by side, synchronised by simulated time."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vstestbed.core.lazy import cv2
from vstestbed.report.video.overlay import (
    ALARM,
    GOOD,
    HOLD_S,
    INK,
    PAPER,
    Color,
    draw_banner,
    draw_text,
    shortened,
    text_width,
)
from vstestbed.report.video.writer import Image, VideoWriter

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer

# Reads a film frame by frame as simulated time advances.

# How much before its time a frame may be shown: the time base of a film is about 1/12800 s
EARLY_S = Fraction(1, 10_000)


class FrameReader:
    """Decodes a film of a run, which begins at t = 0 and has a constant rate, as far as it has been
    shown.

    A film that cannot be read counts as one without frames: `rate_hz` is 0 and `ended` is true from
    the beginning. A truncated film ends at its last frame that can be decoded.
    """

    def __init__(self, path: Path):
        import av
        from av.error import FFmpegError

        self._container: InputContainer | None = None
        self._frames: Iterator[VideoFrame] = iter(())
        self._count, self.ended = 0, True
        self.width = self.height = 0
        self.rate_hz = Fraction(0)
        with contextlib.suppress(
            FFmpegError, OSError, IndexError, StopIteration
        ):  # an unreadable film must not prevent the film of the others
            self._container = av.open(str(path))
            stream = self._container.streams.video[0]
            stream.thread_count = 1  # the other cores belong to the runs of the comparison
            frames = self._container.decode(stream)
            first = next(frames)
            self._frames, self.ended = chain([first], frames), False
            self.width, self.height, self.rate_hz = (
                first.width,
                first.height,
                stream.average_rate or Fraction(25),
            )

    def newest(self, t: Fraction) -> VideoFrame | None:
        """The newest frame at or before t [s]; None if it has been returned already. `ended`: the
        last one has been shown for its time.
        """
        from av.error import FFmpegError

        latest = None
        while not self.ended and self._count <= (t + EARLY_S) * self.rate_hz:
            self.ended = True
            with contextlib.suppress(FFmpegError, StopIteration):  # truncated: the film ends here
                latest, self.ended = next(self._frames), False
                self._count += 1
        return latest

    def close(self) -> None:
        """Close the file."""
        if self._container is not None:
            self._container.close()
        self._container, self._frames = None, iter(())


def scaled(frame: VideoFrame, width: int, height: int) -> Image:
    """A frame at another size, shape (height, width, 3), uint8, RGB."""
    small = frame.reformat(
        width, height, "rgb24", src_colorspace="ITU709", interpolation="AREA", threads=1
    )
    return np.asarray(small.to_ndarray(), np.uint8)


MOST = 6
WIDEST = 1926  # [px], of all columns
COLUMN = 480  # [px]: its text still reads well, and its frame takes half the time of 640
GAP = 2  # [px]
SHAPE = 3 / 4  # height over width of a cell for which no run has a film
FASTEST_HZ = Fraction(50)
DIMMED = 0.6
GREY: Color = (96, 100, 108)
NEUTRAL: Color = (56, 64, 76)

Shown = list[tuple[FrameReader, Image]]  # Films with their places in the image


@dataclass(frozen=True, slots=True)
class Column:
    """One controller's run."""

    label: str  # title over the films; shortened in the middle if it is too long
    films: tuple[Path, ...]  # from top to bottom; a missing or empty one is a grey area
    ending: str  # outcome and time, such as `converged 12.3 s`
    success: bool | None = None  # whether the outcome is shown in green or red; None: grey


def side_by_side(columns: Sequence[Column], path: Path) -> Path | None:
    """Join films into one, each frame at its simulated time, with one clock below; None if no
    column has a film.

    A run that has ended keeps its last frame, dimmed, with its outcome. The film ends one second
    after the longest run. Two frames of every film are in memory at a time.

    `columns`: 1 to MOST runs, from left to right. The frame rate is the highest of the films, at
    most FASTEST_HZ. EnvironmentLackError: no H.264 encoder, no space.
    """
    with ExitStack() as open_files:
        readers = [
            [open_files.enter_context(closing(FrameReader(film))) for film in column.films]
            for column in columns
        ]
        fastest = max(
            (reader.rate_hz for reader in chain.from_iterable(readers)), default=Fraction(0)
        )
        if not fastest:
            return None
        writer = open_files.enter_context(VideoWriter(path, float(min(fastest, FASTEST_HZ))))
        sheet = _Sheet(columns, readers)
        while sheet.show(writer.frames / writer.rate):
            writer.write(sheet.image)
        for _ in range(max(1, round(HOLD_S * writer.rate))):
            writer.write(sheet.image)
    return writer.path


class _Sheet:
    """The image of the joint film, with one column per run."""

    def __init__(self, columns: Sequence[Column], readers: list[list[FrameReader]]):
        # even: H.264 stores colour for 2 x 2 pixels
        width = min(COLUMN, (WIDEST + GAP) // len(columns) - GAP) // 2 * 2
        self._size = max(15, width // 28)
        self._bar = 2 * self._size // 2 * 2
        self._base = round(0.5 * self._bar + 0.36 * self._size)
        rows = zip_longest(*readers)
        # height of the tallest film of a row at that width, even [px]
        heights = [
            max(
                (_scaled_height(r, width) for r in row if r and r.rate_hz),
                default=round(width * SHAPE / 2) * 2,
            )
            for row in rows
        ]
        total = 2 * self._bar + sum(heights)
        self.image: Image = np.full((total, len(columns) * (width + GAP) - GAP, 3), PAPER, np.uint8)
        self._foot = self.image[total - self._bar :]
        # with the column's part of the image, its first film, all its films
        self._running: list[tuple[Column, Image, Image, Shown]] = []
        for k, (column, own) in enumerate(zip(columns, readers, strict=True)):
            left = k * (width + GAP)
            part = self.image[: total - self._bar, left : left + width]
            words = shortened(column.label, self._size, width - 2 * self._size, weight=600)
            at = (width - text_width(words, self._size, 600)) // 2
            draw_text(part[: self._bar], words, (at, self._base), INK, self._size, weight=600)
            films = part[self._bar :]
            films[:] = INK
            self._running.append((column, films, films[: heights[0]], _placed(films, own, heights)))

    def show(self, t: Fraction) -> bool:
        """Update the image to time t [s]; False when all runs have ended."""
        self._running = [run for run in self._running if not self._ended(*run, t)]
        if self._running:
            self._foot[:] = INK
            # independent of t, so that the digits do not move
            left = (self._foot.shape[1] - text_width("00.00 s", self._size)) // 2
            draw_text(self._foot, f"{float(t):.2f} s", (left, self._base), PAPER, self._size)
        return bool(self._running)

    def _ended(self, column: Column, films: Image, top: Image, shown: Shown, t: Fraction) -> bool:
        """Update the films of a column to time t [s]; whether its run has ended, which its last
        picture then says.
        """
        for reader, place in shown:
            picture = reader.newest(t)
            if picture is not None:
                place[:] = scaled(picture, place.shape[1], place.shape[0])
        ended = all(reader.ended for reader, _ in shown)
        if ended:
            films[:] = cv2.convertScaleAbs(films, alpha=DIMMED)
            draw_banner(
                top, column.ending, {True: GOOD, False: ALARM, None: NEUTRAL}[column.success]
            )
        return ended


def _placed(films: Image, readers: list[FrameReader], heights: list[int]) -> Shown:
    """The films of a column with their places in its part (H, width, 3) of the image; where there
    is none, the place says so.
    """
    shown = []
    for reader, place in zip_longest(readers, np.split(films, np.cumsum(heights)[:-1])):
        if reader is None or not reader.rate_hz:
            place[:] = GREY
            height, width = place.shape[:2]
            size = max(13, height // 18)
            draw_text(
                place,
                "no film",
                ((width - text_width("no film", size)) // 2, (height + size) // 2),
                PAPER,
                size,
            )
            continue
        height = _scaled_height(reader, place.shape[1])
        top = (place.shape[0] - height) // 4 * 2  # centred, at an even row
        shown.append((reader, place[top : top + height]))
    return shown


def _scaled_height(reader: FrameReader, width: int) -> int:
    return max(2, round(width * reader.height / reader.width / 2) * 2)
