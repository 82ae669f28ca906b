"""Lossy round trips of pictures: what the computer has of a camera's stream."""

from __future__ import annotations

from typing import Protocol

import cv2
import numpy as np

from vstestbed.camera import Image
from vstestbed.camera.stream import H264Stream, JpegStream, VideoStream
from vstestbed.core.errors import EnvironmentLackError

BUFFER_S = 0.5
"""How far the average bit rate may be exceeded: the encoder's buffer [s]."""


class RoundTrip(Protocol):
    """An encoder and its decoder."""

    def of(self, image: Image) -> Image:
        """The next picture (H, W, 3) uint8 RGB, coded and decoded."""
        ...


class Unchanged:
    """No compression."""

    def of(self, image: Image) -> Image:
        """The same object."""
        return image


class JpegTrip:
    """JPEG, each picture by itself."""

    def __init__(self, stream: JpegStream):
        factors = {"half": cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420, "full": cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444}
        self._options = [cv2.IMWRITE_JPEG_QUALITY, stream.quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, factors[stream.colours]]

    def of(self, image: Image) -> Image:
        """Coded and decoded."""
        _, packet = cv2.imencode(".jpg", image[..., ::-1], self._options)
        return np.ascontiguousarray(np.asarray(cv2.imdecode(packet, cv2.IMREAD_COLOR), np.uint8)[..., ::-1])


class H264Trip:
    """H.264: the encoder remembers the pictures before.

    Args:
        stream: its settings. rate_hz: pictures per second, for the bit rate.

    Raises:
        EnvironmentLackError: PyAV has no x264 here.
    """

    def __init__(self, stream: H264Stream, rate_hz: float):
        self._stream, self._rate_hz = stream, rate_hz
        self._format = "yuv420p" if stream.colours == "half" else "yuv444p"
        self._codecs = None

    def of(self, image: Image) -> Image:
        """Coded and decoded: a picture comes out for each that goes in."""
        import av

        if self._codecs is None:
            self._codecs = self._opened(image.shape)
        encoder, decoder = self._codecs
        packets = encoder.encode(av.VideoFrame.from_ndarray(image, format="rgb24").reformat(format=self._format))
        frames = [frame for packet in packets for frame in decoder.decode(packet)]
        return np.asarray(frames[-1].to_ndarray(format="rgb24"), np.uint8)

    def _opened(self, shape: tuple[int, ...]):
        """Encoder and decoder, each of one thread, so that the same pictures have the same bytes on every machine."""
        from fractions import Fraction

        import av
        from av.codec.codec import UnknownCodecError

        try:
            encoder = av.VideoCodecContext.create("libx264", "w")
        except UnknownCodecError as error:
            raise EnvironmentLackError("PyAV has no x264 here, which camera.stream h264 needs", "use stream jpeg") from error
        rate = Fraction(self._rate_hz).limit_denominator(1000)
        encoder.height, encoder.width = shape[:2]
        encoder.pix_fmt, encoder.framerate, encoder.time_base, encoder.thread_count = self._format, rate, 1 / rate, 1
        encoder.gop_size, encoder.options = self._stream.group, self._options()
        decoder = av.VideoCodecContext.create("h264", "r")
        decoder.thread_count = 1
        decoder.flags |= av.codec.context.Flags.low_delay
        return encoder, decoder

    def _options(self) -> dict[str, str]:
        """Of x264: no pictures that wait for later ones."""
        group = str(self._stream.group)
        given = {"preset": "veryfast", "tune": "zerolatency", "keyint_min": group, "sc_threshold": "0"}
        if self._stream.crf is not None:
            return given | {"crf": str(self._stream.crf)}
        bits = (self._stream.bitrate_kbps or 0.0) * 1000
        return given | {"b": str(round(bits)), "maxrate": str(round(bits)), "bufsize": str(round(bits * BUFFER_S))}


def round_trip(stream: VideoStream | None, rate_hz: float) -> RoundTrip:
    """A new encoder and decoder of a stream; None: the pictures as they are."""
    if isinstance(stream, JpegStream):
        return JpegTrip(stream)
    return H264Trip(stream, rate_hz) if isinstance(stream, H264Stream) else Unchanged()
