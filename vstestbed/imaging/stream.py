"""How a camera's pictures are compressed on their way to the computer."""

from __future__ import annotations

import functools
from abc import ABC
from collections.abc import Callable
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Le

from vstestbed.core.errors import EnvironmentLackError, ParameterError
from vstestbed.core.geometry import Image
from vstestbed.core.lazy import cv2
from vstestbed.core.registry import Registry
from vstestbed.core.spec import spec


@spec
class VideoStream(ABC):
    """A lossy stream. Its delay is part of `camera.latency_s`; no packet is lost.

    Colours of half the size (4:2:0) make the borders of a coloured marker a pixel's stairs, of
    which the detector `blobs` rejects small markers: their shape is no ellipse, or their area not
    as predicted (`detector.area_tolerance`). Brightness, and with it the corners of `tags`, is not
    affected.

    Args:
        colours: size of the two pictures of colour, `half` of the picture's in both directions
            (4:2:0) or `full` (4:4:4).
    """

    kind: Any
    colours: Literal["half", "full"] = "half"

    def check(self, width: int, height: int) -> None:  # noqa: B027 - most streams have pictures of every size
        """Refuse a size [px] that it cannot have. Raises ParameterError: with one that it can."""


@spec
class JpegStream(VideoStream):
    """Motion JPEG: each picture by itself, as USB cameras send it. Blocks of 8 x 8 px.

    Cost of a picture of 640 x 480: 3 ms.

    Args:
        quality: of the IJG's encoder, 1 to 100 [1].
    """

    kind: Literal["jpeg"] = "jpeg"
    quality: Annotated[int, Ge(1), Le(100)] = 80


@spec
class H264Stream(VideoStream):
    """H.264 as network cameras send it, by x264 without pictures that wait for later ones: what is
    lost depends on what moves.

    Every `group`th picture is coded by itself, the others as differences from the one before; after
    a picture of its own a still scene may pulse. Cost of a picture of 640 x 480: 7 ms.

    Args:
        crf: constant rate factor, 0 to 51: the higher, the coarser; default 23 [1]; e.g. `30`.
        bitrate_kbps: instead of crf, the average bit rate, which coarsens what moves fast [kbit/s];
            e.g. `1000`.
        group: pictures from one that is coded by itself to the next [1].
    """

    kind: Literal["h264"] = "h264"
    crf: Annotated[int, Ge(0), Le(51)] | None = None
    bitrate_kbps: Annotated[float, Ge(10), Le(1e6)] | None = None
    group: Annotated[int, Ge(1), Le(10_000)] = 25

    def __post_init__(self) -> None:
        if self.crf is not None and self.bitrate_kbps is not None:
            raise ParameterError(
                "bitrate_kbps",
                "must be left out where crf is given, for each of them sets the quality; give one",
                self.bitrate_kbps,
            )
        if self.crf is None and self.bitrate_kbps is None:
            object.__setattr__(self, "crf", 23)  # so that the scenario as run states it

    def check(self, width: int, height: int) -> None:
        """Refuse a picture with an odd side [px] where colours have half the size."""
        if self.colours == "half" and (width % 2 or height % 2):
            field, size = ("width", width) if width % 2 else ("height", height)
            raise ParameterError.fixed(
                field, "even", size, where="for stream h264 with colours: half"
            )


STREAMS = Registry(
    "stream",
    JpegStream,
    H264Stream,
    fields={"quality": "jpeg", "crf": "h264", "bitrate_kbps": "h264", "group": "h264"},
)


BUFFER_S = 0.5  # how far the average bit rate may be exceeded: the encoder's buffer [s]


def _h264(stream: H264Stream, rate_hz: float) -> Callable[[Image], Image]:
    """Codes and decodes each next picture, and remembers the pictures before. Raises
    EnvironmentLackError: PyAV has no x264 here.
    """
    pixels = "yuv420p" if stream.colours == "half" else "yuv444p"
    opened = functools.cache(lambda height, width: _codecs(stream, rate_hz, pixels, height, width))

    def coded(image: Image) -> Image:
        import av

        encoder, decoder = opened(*image.shape[:2])
        packets = encoder.encode(
            av.VideoFrame.from_ndarray(image, format="rgb24").reformat(format=pixels)
        )
        # one comes out for each that goes in
        frames = [frame for packet in packets for frame in decoder.decode(packet)]
        return np.asarray(frames[-1].to_ndarray(format="rgb24"), np.uint8)

    return coded


def _codecs(stream: H264Stream, rate_hz: float, pixels: str, height: int, width: int):
    """Encoder and decoder, each of one thread, so that the same pictures have the same bytes on
    every machine.
    """
    from fractions import Fraction

    import av
    from av.codec.codec import UnknownCodecError

    try:
        encoder = av.VideoCodecContext.create("libx264", "w")
    except UnknownCodecError as error:
        raise EnvironmentLackError(
            "PyAV has no x264 here, which camera.stream h264 needs", "use stream jpeg"
        ) from error
    rate = Fraction(rate_hz).limit_denominator(1000)
    group = str(stream.group)
    encoder.height = height
    encoder.width = width
    encoder.pix_fmt = pixels
    encoder.framerate = rate
    encoder.time_base = 1 / rate
    encoder.thread_count = 1
    # No pictures that wait for later ones.
    options = {
        "preset": "veryfast",
        "tune": "zerolatency",
        "keyint_min": group,
        "sc_threshold": "0",
    }
    if stream.crf is not None:
        options["crf"] = str(stream.crf)
    else:
        bits = (stream.bitrate_kbps or 0.0) * 1000
        options |= {
            "b": str(round(bits)),
            "maxrate": str(round(bits)),
            "bufsize": str(round(bits * BUFFER_S)),
        }
    encoder.gop_size = stream.group
    encoder.options = options
    decoder = av.VideoCodecContext.create("h264", "r")
    decoder.thread_count = 1
    decoder.flags |= av.codec.context.Flags.low_delay  # pyright: ignore[reportAttributeAccessIssue] - compiled
    return encoder, decoder


def round_trip(stream: VideoStream | None, rate_hz: float) -> Callable[[Image], Image]:
    """What becomes of each next picture (H, W, 3) uint8 RGB in a new encoder and decoder of a
    stream; None: it stays as it is.
    """
    if isinstance(stream, JpegStream):
        return functools.partial(_jpeg, stream)
    return _h264(stream, rate_hz) if isinstance(stream, H264Stream) else lambda image: image


def _jpeg(stream: JpegStream, image: Image) -> Image:
    size = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
    if stream.colours == "half":
        size = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420
    options = [cv2.IMWRITE_JPEG_QUALITY, stream.quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, size]
    _, packet = cv2.imencode(".jpg", image[..., ::-1], options)
    return np.ascontiguousarray(cv2.imdecode(packet, cv2.IMREAD_COLOR)[..., ::-1])
