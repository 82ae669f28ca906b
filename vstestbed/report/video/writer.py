"""H.264 writer that holds no frames in memory and never leaves an incomplete file under the film's
name.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from vstestbed.core.errors import EnvironmentLackError, OutputError
from vstestbed.core.files import NO_SPACE, PartFile
from vstestbed.core.lazy import cv2

if TYPE_CHECKING:
    from av import VideoFrame, VideoStream
    from av.container import OutputContainer

__all__ = ["DATASET", "Image", "VideoWriter", "jpeg_of", "png_of"]

Image = NDArray[np.uint8]

ONE_THREAD = "threads=1:sync-lookahead=0:lookahead-threads=1"
ENCODER = {
    "preset": "ultrafast",
    "crf": "20",
    "x264-params": f"subme=1:mbtree=1:rc-lookahead=5:{ONE_THREAD}",
}
"""One sub-pixel step in the search of motion, and quality where it lasts (a tree of macroblocks
over five frames): .8 of the time of `veryfast` with one step and no B frames, for 1.1 to 1.3 times
its size; without the tree 2.3 times its size in that time.

Without ONE_THREAD, beside the stream's own thread count, one film in a hundred has other bytes on a
machine under load; with `threads=1` alone one in 450.
"""
BT709 = 1  # code of BT.709 in ISO/IEC 23091-2, the same for primaries, transfer curve and matrix

Coding = tuple[int, NDArray[np.float64], dict[str, str]]
"""How a video codes its pictures: code of the matrix between colours and (Y, Cb, Cr) in ISO/IEC
23091-2, this matrix, options of the encoder.
"""


def _to_yuv(luma: tuple[float, float, float]) -> NDArray[np.float64]:
    """(Y, Cb, Cr) of (R, G, B, 1) in 8 bits, limited range (ITU-R BT.709-6, items 3.3 to 3.5);
    luma: shares of red, green, blue in Y.
    """
    y = np.array(luma)
    blue, red = ([0, 0, 1] - y) / (2 * (1 - y[2])), ([1, 0, 0] - y) / (2 * (1 - y[0]))
    return np.array([[*219 / 255 * y, 16], [*224 / 255 * blue, 128], [*224 / 255 * red, 128]])


# For players: BT.709, item 3.2
FILM: Coding = (BT709, _to_yuv((0.2126, 0.7152, 0.0722)), ENCODER)
DATASET: Coding = 6, _to_yuv((0.299, 0.587, 0.114)), ENCODER | {"g": "2"}
"""For learners, which read frames in any order (every other one can be decoded by itself), and with
libraries that take any video as coded by BT.601 (its item 2.5.1).
"""


class _Sink(PartFile):
    """The file for the encoder. Errors wait for `check`, since PyAV prints those that occur while
    it closes a film.
    """

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

    def check(self) -> None:
        """Raise the first error of `write`."""
        if self._error is not None:
            raise self._error


class VideoWriter:
    """Writes frames as H.264 (yuv420p, index first, so that it plays while it loads) into a file
    that ends in `.mp4`.

    The film is written under a temporary name and renamed on `close`, so that a file under the
    film's name is always complete. The same frames give the same bytes (one encoder thread). Its
    size is that of the first frame, made even by repeating the last row or column. As a context
    manager: closes at the end, aborts on an exception.

    EnvironmentLackError: no H.264 encoder, or no room on the disk (exit 4). OutputError: the folder
    cannot be written.
    """

    def __init__(self, path: Path, rate_hz: float, coding: Coding = FILM):
        # the rate as a ratio of small integers, as video needs it: 29.97 is 2997/100 Hz, 1/3 is 1/3
        rate = (
            1 / Fraction(1 / rate_hz).limit_denominator(10_000)
            if rate_hz < 1
            else Fraction(rate_hz).limit_denominator(10_000)
        )
        self.path, self.rate, self.frames = Path(path), rate, 0
        self._coding, self._aborted = coding, False
        self._sink: _Sink | None = None
        self._container: OutputContainer | None = None
        self._stream: VideoStream | None = None

    @property
    def bytes(self) -> int:
        """Size of the unfinished film so far [bytes];
        0 of one that is finished, or has not begun.
        """
        return 0 if self._sink is None else self._sink.tell()

    def write(self, image: Image) -> None:
        """Append one frame, shape (H, W, 3), uint8, RGB; all of one size."""
        import av

        with self._guarded():
            if self._container is None:
                self._open(image.shape)
            height, width = image.shape[:2]
            # even, with the last row or column repeated: colour is stored for blocks of 2 x 2
            # pixels
            if height % 2 or width % 2:
                image = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
            frame = av.VideoFrame.from_ndarray(
                _yuv420p(np.ascontiguousarray(image), self._coding[1]), format="yuv420p"
            )
            # exact fractions: no drift over a long film
            frame.pts, frame.time_base = self.frames, 1 / self.rate
            self._mux(frame)
        self.frames += 1

    def close(self) -> Path | None:
        """Finish the film and return its path; None if no frame was written (then there is no
        file).
        """
        if self._container is not None and self._sink is not None:
            with self._guarded():
                self._mux(None)
                self._container.close()
                self._sink.check()
                self._sink.keep()
                self._container = self._stream = self._sink = None
        return self.path if self.frames and not self._aborted else None

    def abort(self) -> None:
        """Discard the film with its partial file. Harmless after `close`."""
        container, sink = self._container, self._sink
        self._container = self._stream = self._sink = None
        if sink is None:
            return
        self._aborted = True
        # the film is discarded: errors of the encoder do not matter
        with contextlib.suppress(OSError, ValueError, RuntimeError):
            if container is not None:
                container.close()
        with contextlib.suppress(OSError):  # a full disk, or a folder that is gone
            sink.discard()

    def __enter__(self) -> VideoWriter:
        """The writer itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close, or abort when an exception is on its way."""
        if kind is None:
            self.close()
        else:
            self.abort()

    def _open(self, shape: tuple[int, ...]) -> None:
        import av

        matrix, _, options = self._coding
        # the encoder gets the open file, and not its name, which may lead elsewhere by then
        self._sink = sink = _Sink(self.path)
        # `io_open`: to move the index to the front, the encoder reads the film once more, beside
        # the writing
        self._container = av.open(
            sink,
            "w",
            format="mp4",
            options={"movflags": "+faststart"},
            io_open=lambda *_: sink.part.open("rb"),
        )
        self._stream = stream = self._container.add_stream(
            "libx264", rate=self.rate, options=options
        )
        stream.height, stream.width = shape[0] + shape[0] % 2, shape[1] + shape[1] % 2
        stream.pix_fmt = "yuv420p"
        stream.thread_count = 1
        context = stream.codec_context
        context.color_primaries = context.color_trc = BT709
        context.colorspace = matrix
        # opens the file: an unwritable folder is reported at the first frame
        self._container.start_encoding()

    def _mux(self, frame: VideoFrame | None) -> None:
        """Encode a frame, or what waits at the end."""
        assert self._container is not None and self._stream is not None and self._sink is not None
        for packet in self._stream.encode(frame):
            self._container.mux(packet)
        self._sink.check()

    @contextlib.contextmanager
    def _guarded(self) -> Iterator[None]:
        """A step of the encoder; on failure the film is discarded, and the error says what is
        missing.
        """
        from av.codec.codec import UnknownCodecError
        from av.error import FFmpegError

        try:
            yield
        except (FFmpegError, UnknownCodecError, OSError) as error:
            self.abort()
            number = getattr(error, "errno", None)
            if number in NO_SPACE:
                words = f"no room for {self.path} ({os.strerror(number or 0)})"
                raise EnvironmentLackError(
                    words,
                    "free some, choose another place, or make none (run, compare: `--video none`)",
                ) from error
            if isinstance(error, OSError):
                words = os.strerror(number) if number else str(error)
                raise OutputError(
                    self.path, words, "give a folder that can be written with --out"
                ) from error
            remedy = "`pip install --force-reinstall av` brings libx264, or use `--video none`"
            raise EnvironmentLackError(
                f"no H.264 encoder for {self.path} ({error})", remedy
            ) from error
        except BaseException:
            self.abort()
            raise


def _yuv420p(image: Image, to_yuv: NDArray[np.float64]) -> Image:
    """The planes Y (H, W), Cb and Cr (H/2, W/2) of an image, one after the other as (3 H/2, W): in
    half of swscale's time.
    """
    height, width = image.shape[:2]
    yuv = cv2.transform(image, to_yuv)
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
    return _encoded(
        ".jpg",
        image,
        [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, full],
    )


def _encoded(kind: str, image: Image, settings: list[int]) -> bytes:
    return np.asarray(
        cv2.imencode(kind, cv2.cvtColor(image, cv2.COLOR_RGB2BGR), settings)[1]
    ).tobytes()
