"""H.264 writer that holds no frames in memory and never leaves an incomplete file under the film's name."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, BinaryIO, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import EnvironmentLackError, OutputError, ParameterError
from vstestbed.core.files import NO_SPACE, PartFile

if TYPE_CHECKING:
    from av import VideoStream
    from av.container import OutputContainer

Image = NDArray[np.uint8]

ENCODER: Final = {"preset": "ultrafast", "crf": "20", "x264-params": "subme=1:mbtree=1:rc-lookahead=5:threads=1"}
"""One sub-pixel step in the search of motion, and quality where it lasts (a tree of macroblocks over five frames): .8 of the time of
`veryfast` with one step and no B frames, for 1.1 to 1.3 times its size; without the tree 2.3 times its size in that time.

Without `threads=1` here, beside the stream's own thread count, one film in a hundred has other bytes on a machine under load."""
BT709: Final = 1  # code of BT.709 in ISO/IEC 23091-2, the same for primaries, transfer curve and matrix


@dataclass(frozen=True)
class Coding:
    """How a video codes its pictures."""

    matrix: int  # code of the matrix between colours and (Y, Cb, Cr) in ISO/IEC 23091-2
    luma: tuple[float, float, float]  # shares of red, green and blue in Y
    key_every: int | None = None  # every how many frames one can be decoded without those before it; None: where the encoder likes

    @cached_property
    def to_yuv(self) -> NDArray[np.float64]:
        """(Y, Cb, Cr) of (R, G, B, 1) in 8 bits, limited range (ITU-R BT.709-6, items 3.3 to 3.5, with these shares)."""
        luma = np.array(self.luma)
        blue, red = ([0, 0, 1] - luma) / (2 * (1 - luma[2])), ([1, 0, 0] - luma) / (2 * (1 - luma[0]))
        return np.array([[*219 / 255 * luma, 16], [*224 / 255 * blue, 128], [*224 / 255 * red, 128]])

    @property
    def options(self) -> dict[str, str]:
        """Of the encoder."""
        return ENCODER if self.key_every is None else ENCODER | {"g": str(self.key_every)}


FILM: Final = Coding(BT709, (0.2126, 0.7152, 0.0722))  # For players: BT.709, item 3.2
DATASET: Final = Coding(6, (0.299, 0.587, 0.114), key_every=2)
"""For learners, which read frames in any order, and with libraries that take any video as coded by BT.601 (its item 2.5.1)."""


class _Sink(PartFile):
    """The file for the encoder. Errors wait for `check`, since PyAV prints those that occur while it closes a film."""

    def __init__(self, path: Path):
        super().__init__(path, buffering=0)  # nothing waits that only `seek` would write
        self.seek, self.tell = self.file.seek, self.file.tell
        self._error: OSError | None = None

    def write(self, content: bytes) -> int:
        """Append; nothing more is written after an error."""
        try:
            left = memoryview(content)
            while left and self._error is None:  # a full disk takes a part
                left = left[self.file.write(left) :]
        except OSError as error:
            self._error = error
        return len(content)

    def reopened(self, *_: object) -> BinaryIO:
        """The film for reading, beside the writing: to move the index to the front, the encoder reads it once more."""
        return self.part.open("rb")

    def check(self) -> None:
        """Raise the first error of `write`."""
        if self._error is not None:
            raise self._error


class VideoWriter:
    """Writes frames as H.264 (yuv420p, index first, so that it plays while it loads) into a file that ends in `.mp4`.

    The film is written under a temporary name and renamed on `close`, so that a file under the film's name is always complete.
    The same frames give the same bytes (one encoder thread). Its size is that of the first frame, made even by
    repeating the last row or column. As a context manager: closes at the end, aborts on an exception.

    Raises:
        ParameterError: rate_hz [Hz] is not a positive number, or a frame is not (H, W, 3) uint8 of the first one's size.
        EnvironmentLackError: no H.264 encoder, or no room on the disk (exit 4). OutputError: the folder cannot be written.
    """

    def __init__(self, path: Path, rate_hz: float, coding: Coding = FILM):
        if not (math.isfinite(rate_hz) and rate_hz > 0):
            raise ParameterError("rate_hz", "must be > 0", rate_hz)
        self.path = Path(path)
        self.rate = _fraction(rate_hz)
        self.frames = 0
        self._coding = coding
        self._done = self._aborted = False
        self._shape: tuple[int, ...] = ()
        self._sink: _Sink | None = None
        self._container: OutputContainer | None = None
        self._stream: VideoStream | None = None

    @property
    def bytes(self) -> int:
        """Size of the unfinished film so far [bytes]; 0 of one that is finished, or has not begun."""
        return 0 if self._sink is None else self._sink.tell()

    def write(self, image: Image) -> None:
        """Append one frame, shape (H, W, 3), uint8, RGB."""
        if self._done:
            raise OutputError(self.path, "this film is finished", "open another VideoWriter")
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
            raise ParameterError("image", "must be (H, W, 3) uint8", (image.shape, str(image.dtype)))
        if self._shape and image.shape != self._shape:
            raise ParameterError("image", f"must keep the size of the first frame, {self._shape}", image.shape)
        self._guard(lambda: self._encode(image))
        self.frames += 1

    def close(self) -> Path | None:
        """Finish the film and return its path; None if no frame was written (then there is no file)."""
        if self._container is not None:
            self._guard(self._finish)
        return self.path if self.frames and not self._aborted else None

    def abort(self) -> None:
        """Discard the film with its partial file. Harmless after `close`."""
        container, sink = self._container, self._sink
        self._container = self._stream = self._sink = None
        if sink is None:
            return
        self._done = self._aborted = True
        with contextlib.suppress(OSError, ValueError, RuntimeError):  # the film is discarded: errors of the encoder do not matter
            if container is not None:
                container.close()
        with contextlib.suppress(OSError):  # a full disk, or a folder that is gone
            sink.discard()

    def __enter__(self) -> VideoWriter:
        """The writer itself."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Close, or abort when an exception is on its way."""
        if kind is None:
            self.close()
        else:
            self.abort()

    def _encode(self, image: Image) -> None:
        import av

        if self._container is None:
            self._open(image.shape)
        assert self._container is not None and self._stream is not None and self._sink is not None
        frame = av.VideoFrame.from_ndarray(_yuv420p(_even(image), self._coding), format="yuv420p")
        frame.pts, frame.time_base = self.frames, 1 / self.rate  # exact fractions: no drift over a long film
        for packet in self._stream.encode(frame):
            self._container.mux(packet)
        self._sink.check()

    def _open(self, shape: tuple[int, ...]) -> None:
        import av

        self._sink = sink = _Sink(self.path)  # the encoder gets the open file, and not its name, which may lead elsewhere by then
        self._container = av.open(sink, "w", format="mp4", options={"movflags": "+faststart"}, io_open=sink.reopened)
        stream = self._container.add_stream("libx264", rate=self.rate, options=self._coding.options)
        stream.height, stream.width = shape[0] + shape[0] % 2, shape[1] + shape[1] % 2
        stream.pix_fmt = "yuv420p"
        stream.thread_count = 1
        context = stream.codec_context
        context.color_primaries = context.color_trc = BT709
        context.colorspace = self._coding.matrix
        self._container.start_encoding()  # opens the file: an unwritable folder is reported at the first frame
        self._stream, self._shape = stream, shape

    def _finish(self) -> None:
        assert self._container is not None and self._stream is not None and self._sink is not None
        for packet in self._stream.encode():
            self._container.mux(packet)
        self._container.close()
        self._sink.check()
        self._sink.keep()
        self._container = self._stream = self._sink = None
        self._done = True

    def _guard(self, step: Callable[[], None]) -> None:
        """Run one step of the encoder; on failure discard the film and raise an error that says what is missing."""
        from av.codec.codec import UnknownCodecError
        from av.error import FFmpegError

        try:
            step()
        except (FFmpegError, UnknownCodecError, OSError) as error:
            self.abort()
            raise self._explain(error) from error
        except BaseException:
            self.abort()
            raise

    def _explain(self, error: Exception) -> EnvironmentLackError | OutputError:
        """The error of the encoder or the disk as an error of this package, with a remedy."""
        number = getattr(error, "errno", None)
        if number in NO_SPACE:
            return EnvironmentLackError(f"no room for {self.path} ({os.strerror(number or 0)})", "free some space or use `--video none`")
        if isinstance(error, OSError):
            return OutputError(self.path, os.strerror(number) if number else str(error), "give a folder that can be written with --out")
        remedy = "`pip install --force-reinstall av` brings libx264, or use `--video none`"
        return EnvironmentLackError(f"no H.264 encoder for {self.path} ({error})", remedy)


def _fraction(rate_hz: float) -> Fraction:
    """The rate as a ratio of small integers, as video needs it: 29.97 is 2997/100 Hz, 1/3 is 1/3."""
    return 1 / Fraction(1 / rate_hz).limit_denominator(10_000) if rate_hz < 1 else Fraction(rate_hz).limit_denominator(10_000)


def _even(image: Image) -> Image:
    """The frame with even height and width, the last row or column repeated: yuv420p stores colour for blocks of 2 x 2 pixels."""
    height, width = image.shape[:2]
    if height % 2 == 0 and width % 2 == 0:
        return np.ascontiguousarray(image)
    return np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")


def _yuv420p(image: Image, coding: Coding) -> Image:
    """The planes Y (H, W), Cb and Cr (H/2, W/2) of an image, one after the other as (3 H/2, W): in half of swscale's time."""
    height, width = image.shape[:2]
    yuv = cv2.transform(image, coding.to_yuv)
    halved = cv2.resize(yuv, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    planes = np.empty((height * 3 // 2, width), np.uint8)
    blue, red = planes[height:].reshape(2, height // 2, width // 2)
    for plane, source, channel in ((planes[:height], yuv, 0), (blue, halved, 1), (red, halved, 2)):
        cv2.extractChannel(source, channel, plane)
    return planes


# Single pictures as files.
JPEG_QUALITY = 95  # With colour at full size: a marker's rim keeps its hue


def png_of(image: Image) -> bytes:
    """A picture (H, W, 3) uint8 RGB as PNG."""
    return _encoded(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])


def jpeg_of(image: Image) -> bytes:
    """A picture (H, W, 3) uint8 RGB as JPEG."""
    full = int(cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)
    return _encoded(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, full])


def _encoded(kind: str, image: Image, settings: list[int]) -> bytes:
    return np.asarray(cv2.imencode(kind, cv2.cvtColor(image, cv2.COLOR_RGB2BGR), settings)[1]).tobytes()
