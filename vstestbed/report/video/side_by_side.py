"""Films of several controllers side by side, synchronised by simulated time."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.report.video.overlay import ALARM, GOOD, HOLD_S, INK, PAPER, Color, draw_banner, draw_text, shortened, text_width
from vstestbed.report.video.writer import Image, VideoWriter

if TYPE_CHECKING:
    from av import VideoFrame, VideoStream
    from av.container import InputContainer


# Reads a film frame by frame as simulated time advances.
EARLY_S: Final = Fraction(1, 10_000)
"""How much before its time a frame may be shown: the time base of a film is about 1/12800 s."""


class FrameReader:
    """Decodes a film as far as it has been shown, and holds two frames of it in memory.

    A film that cannot be read counts as one without frames: `rate_hz` is 0 and `ended` is true from the beginning. A truncated
    film ends at its last frame that can be decoded.

    Args:
        path: a film of a run; its first frame is at t = 0.
    """

    def __init__(self, path: Path):
        self._container: InputContainer | None = None
        self._frames: Iterator[VideoFrame] = iter(())
        self._next: VideoFrame | None = None
        self._began = Fraction(0)
        self.width = self.height = 0
        self.rate_hz = Fraction(0)
        self.end_s = Fraction(0)
        self._open(path)

    def ended(self, t: Fraction) -> bool:
        """Whether the last frame has been shown for its duration at t [s]."""
        return self._next is None and t >= self.end_s - EARLY_S

    def newest(self, t: Fraction) -> VideoFrame | None:
        """The newest frame at or before t [s]; None if it has been returned already."""
        latest = None
        while self._next is not None and self._time(self._next) <= t + EARLY_S:
            latest = self._next
            self.end_s = self._time(latest) + 1 / self.rate_hz
            self._advance()
        return latest

    def close(self) -> None:
        """Close the file."""
        if self._container is not None:
            self._container.close()
        self._container, self._frames, self._next = None, iter(()), None

    def _open(self, path: Path) -> None:
        import av
        from av.error import FFmpegError

        with contextlib.suppress(FFmpegError, OSError):  # an unreadable film must not prevent the film of the others
            self._container = av.open(str(path))
            streams = self._container.streams.video
            if streams:
                self._start(streams[0])

    def _start(self, stream: VideoStream) -> None:
        assert self._container is not None
        stream.thread_count = 1  # the other cores belong to the runs of the comparison
        self._frames = self._container.decode(stream)
        self._advance()
        if self._next is not None:
            self._began = self._time(self._next)
            self.width, self.height = self._next.width, self._next.height
            self.rate_hz = stream.average_rate or Fraction(25)

    def _advance(self) -> None:
        from av.error import FFmpegError

        self._next = None
        with contextlib.suppress(FFmpegError):  # truncated: the film ends here
            self._next = next(self._frames, None)

    def _time(self, frame: VideoFrame) -> Fraction:
        return (frame.pts or 0) * (frame.time_base or Fraction(0)) - self._began


def scaled(frame: VideoFrame, width: int, height: int) -> Image:
    """A frame at another size, shape (height, width, 3), uint8, RGB."""
    small = frame.reformat(width, height, "rgb24", src_colorspace="ITU709", interpolation="AREA", threads=1)
    return np.asarray(small.to_ndarray(), np.uint8)


MOST: Final = 6
WIDEST: Final = 1926  # [px], of all columns
COLUMN: Final = 480  # [px]: its text still reads well, and its frame takes half the time of 640
GAP: Final = 2  # [px]
SHAPE: Final = 3 / 4  # height over width of a cell for which no run has a film
FASTEST_HZ: Final = Fraction(50)
DIMMED: Final = 0.6
GREY: Final[Color] = (96, 100, 108)
NEUTRAL: Final[Color] = (56, 64, 76)


@dataclass(frozen=True, slots=True)
class Column:
    """One controller's run.

    Args:
        label: title over the films; shortened in the middle if it is too long.
        films: films from top to bottom; a missing or empty one is a grey area.
        ending: outcome and time, such as `converged 12.3 s`.
        success: whether the outcome is shown in green or red; None: grey.
    """

    label: str
    films: tuple[Path, ...]
    ending: str
    success: bool | None = None


def side_by_side(columns: Sequence[Column], path: Path, rate_hz: float | None = None) -> Path | None:
    """Join films into one, each frame at its simulated time, with one clock below.

    A run that has ended keeps its last frame, dimmed, with its outcome. The film ends one second after the longest run. Two
    frames of every film are in memory at a time.

    Args:
        columns: 1 to 6 runs, from left to right. path: the film (`.mp4`).
        rate_hz: frame rate [Hz]; by default the highest of the films, at most 50.

    Returns:
        The path; None if no column has a film (then there is no file).

    Raises:
        ParameterError: no column or more than 6, or a rate that is not positive.
        EnvironmentLackError: no H.264 encoder, no space. OutputError: the folder cannot be written.
    """
    if not 0 < len(columns) <= MOST:
        raise ParameterError("columns", f"must be 1 to {MOST} runs", len(columns))
    with ExitStack() as open_files:
        readers = [[open_files.enter_context(closing(FrameReader(film))) for film in column.films] for column in columns]
        fastest = max((reader.rate_hz for reader in chain.from_iterable(readers)), default=Fraction(0))
        if not fastest:
            return None
        writer = open_files.enter_context(VideoWriter(path, float(min(fastest, FASTEST_HZ)) if rate_hz is None else rate_hz))
        _write_frames(writer, _Sheet(columns, readers))
    return writer.path


def _write_frames(writer: VideoWriter, sheet: _Sheet) -> None:
    frame = 0
    while sheet.show(frame / writer.rate):
        writer.write(sheet.image)
        frame += 1
    for _ in range(max(1, round(HOLD_S * writer.rate))):
        writer.write(sheet.image)


class _Sheet:
    """The image of the joint film, with one column per run."""

    def __init__(self, columns: Sequence[Column], readers: list[list[FrameReader]]):
        width = min(COLUMN, (WIDEST + GAP) // len(columns) - GAP) // 2 * 2  # even: H.264 stores colour for 2 x 2 pixels
        self._size = max(15, width // 28)
        self._bar = 2 * self._size // 2 * 2
        heights = [_row_height([column[row] for column in readers if row < len(column)], width) for row in range(max(map(len, readers)))]
        total = 2 * self._bar + sum(heights)
        self.image: Image = np.full((total, len(columns) * (width + GAP) - GAP, 3), PAPER, np.uint8)
        self._foot = self.image[total - self._bar :]
        self._views = []
        for k, (column, own) in enumerate(zip(columns, readers, strict=True)):
            left = k * (width + GAP)
            part = self.image[: total - self._bar, left : left + width]
            self._label(part[: self._bar], column.label)
            self._views.append(_ColumnView(part[self._bar :], column, own, heights))

    def show(self, t: Fraction) -> bool:
        """Update the image to time t [s]; False when all runs have ended."""
        running = [view.show(t) for view in self._views]
        if any(running):
            self._clock(float(t))
        return any(running)

    def _label(self, bar: Image, words: str) -> None:
        words = shortened(words, self._size, bar.shape[1] - 2 * self._size, weight=600)
        left = (bar.shape[1] - text_width(words, self._size, 600)) // 2
        draw_text(bar, words, (left, self._base), INK, self._size, weight=600)

    def _clock(self, t: float) -> None:
        self._foot[:] = INK
        left = (self._foot.shape[1] - text_width("00.00 s", self._size)) // 2  # independent of t, so that the digits do not move
        draw_text(self._foot, f"{t:.2f} s", (left, self._base), PAPER, self._size)

    @property
    def _base(self) -> int:
        """Base line of text in a bar [px]."""
        return round(0.5 * self._bar + 0.36 * self._size)


class _ColumnView:
    """The films of one column, drawn into a view (H, width, 3) of the sheet's image."""

    def __init__(self, image: Image, column: Column, readers: list[FrameReader], heights: list[int]):
        self._image, self._column, self._top = image, column, image[: heights[0]]
        self._shown: list[tuple[FrameReader, Image]] = []
        self._over = False
        image[:] = INK
        for row, place in enumerate(np.split(image, np.cumsum(heights)[:-1])):
            if row < len(readers) and readers[row].rate_hz:
                self._shown.append((readers[row], _centred(place, readers[row])))
            else:
                _blank(place, "no film")

    def show(self, t: Fraction) -> bool:
        """Update the films to time t [s]; False when the run has ended."""
        if self._over:
            return False
        for reader, place in self._shown:
            picture = reader.newest(t)
            if picture is not None:
                place[:] = scaled(picture, place.shape[1], place.shape[0])
        if all(reader.ended(t) for reader, _ in self._shown):
            self._over = True
            self._image[:] = cv2.convertScaleAbs(self._image, alpha=DIMMED)
            draw_banner(self._top, self._column.ending, {True: GOOD, False: ALARM, None: NEUTRAL}[self._column.success])
        return not self._over


def _row_height(readers: list[FrameReader], width: int) -> int:
    """Height of the tallest of these films at that width, even [px]."""
    return max((_scaled_height(reader, width) for reader in readers if reader.rate_hz), default=round(width * SHAPE / 2) * 2)


def _scaled_height(reader: FrameReader, width: int) -> int:
    return max(2, round(width * reader.height / reader.width / 2) * 2)


def _centred(place: Image, reader: FrameReader) -> Image:
    """The part of a cell that the film fills, centred, at an even row."""
    height = _scaled_height(reader, place.shape[1])
    top = (place.shape[0] - height) // 4 * 2
    return place[top : top + height]


def _blank(place: Image, words: str) -> None:
    """A grey cell with text in its middle."""
    place[:] = GREY
    height, width = place.shape[:2]
    size = max(13, height // 18)
    draw_text(place, words, ((width - text_width(words, size)) // 2, (height + size) // 2), PAPER, size)
