"""A film read back picture by picture, as simulated time goes on."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from vstestbed.report.video.writer import Image

if TYPE_CHECKING:
    from av import VideoFrame, VideoStream
    from av.container import InputContainer

EARLY_S: Final = Fraction(1, 10_000)
"""How much before its time a picture may be shown: films count time in steps of about 1/12800 s."""


class FrameReader:
    """A film that is decoded as far as it has been shown, and keeps two pictures of it.

    A film that cannot be read is one without pictures: `rate_hz` is 0 and `ended` true from the beginning. One that is
    cut off ends where it breaks.

    Args:
        path: a film of a run, whose first picture is taken at t = 0.
    """

    def __init__(self, path: Path):
        self._container: InputContainer | None = None
        self._pictures: Iterator[VideoFrame] = iter(())
        self._next: VideoFrame | None = None
        self._began = Fraction(0)
        self.width = self.height = 0
        self.rate_hz = Fraction(0)
        self.end_s = Fraction(0)
        self._open(path)

    def ended(self, t: Fraction) -> bool:
        """Whether the last picture's time is over at t [s]."""
        return self._next is None and t >= self.end_s - EARLY_S

    def due(self, t: Fraction) -> VideoFrame | None:
        """The newest picture of time t [s] or before; None where that has been given already."""
        newest = None
        while self._next is not None and self._time(self._next) <= t + EARLY_S:
            newest = self._next
            self.end_s = self._time(newest) + 1 / self.rate_hz
            self._advance()
        return newest

    def close(self) -> None:
        """Close the file."""
        if self._container is not None:
            self._container.close()
        self._container, self._pictures, self._next = None, iter(()), None

    def _open(self, path: Path) -> None:
        import av
        from av.error import FFmpegError

        with contextlib.suppress(FFmpegError, OSError):  # no film: shown as none, beside the others
            self._container = av.open(str(path))
            streams = self._container.streams.video
            if streams:
                self._start(streams[0])

    def _start(self, stream: VideoStream) -> None:
        assert self._container is not None
        stream.thread_count = 1  # a comparison leaves the other cores to its runs
        self._pictures = self._container.decode(stream)
        self._advance()
        if self._next is not None:
            self._began = self._time(self._next)
            self.width, self.height = self._next.width, self._next.height
            self.rate_hz = stream.average_rate or Fraction(25)

    def _advance(self) -> None:
        from av.error import FFmpegError

        self._next = None
        with contextlib.suppress(FFmpegError):  # cut off: it ends here
            self._next = next(self._pictures, None)

    def _time(self, frame: VideoFrame) -> Fraction:
        return (frame.pts or 0) * (frame.time_base or Fraction(0)) - self._began


def scaled(frame: VideoFrame, width: int, height: int) -> Image:
    """A picture of a film at another size, shape (height, width, 3), uint8, RGB."""
    small = frame.reformat(width, height, "rgb24", src_colorspace="ITU709", interpolation="AREA", threads=1)
    return np.asarray(small.to_ndarray(), np.uint8)
