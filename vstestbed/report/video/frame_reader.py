"""Reads a film frame by frame as simulated time advances."""

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
