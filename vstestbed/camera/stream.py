"""How a camera's pictures are compressed on their way to the computer."""

from __future__ import annotations

from abc import ABC
from typing import Annotated, Any, ClassVar, Literal

from annotated_types import Ge, Le

from vstestbed.core.errors import ParameterError
from vstestbed.core.spec import OneOf, spec


@spec
class VideoStream(ABC):
    """A lossy stream. Its delay is part of `camera.latency_s`; no packet is lost.

    Colours of half the size (4:2:0) make the borders of a coloured marker a pixel's stairs, of which the detector `blobs` rejects small
    markers: their shape is no ellipse, or their area not as predicted (`detector.area_tolerance`). Brightness, and with it the corners of
    `tags`, is not affected.

    Args:
        colours: size of the two pictures of colour, `half` of the picture's in both directions (4:2:0) or `full` (4:4:4).
    """

    kind: Any
    colours: Literal["half", "full"] = "half"
    pairs: ClassVar[bool] = False
    """Whether width and height must be even where colours have half the size."""

    def check(self, width: int, height: int) -> None:
        """Refuse a size [px] that it cannot have.

        Raises:
            ParameterError: with one that it can.
        """
        if self.pairs and self.colours == "half" and (width % 2 or height % 2):
            field, size = ("width", width) if width % 2 else ("height", height)
            raise ParameterError(field, f"must be even for stream {self.kind} with colours: half", size)


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
    """H.264 as network cameras send it, by x264 without pictures that wait for later ones: what is lost depends on what moves.

    Every `group`th picture is coded by itself, the others as differences from the one before; after a picture of its own a still
    scene may pulse. Cost of a picture of 640 x 480: 7 ms.

    Args:
        crf: constant rate factor, 0 to 51: the higher, the coarser; default 23 [1]; e.g. `30`.
        bitrate_kbps: instead of crf, the average bit rate, which coarsens what moves fast [kbit/s]; e.g. `1000`.
        group: pictures from one that is coded by itself to the next [1].
    """

    kind: Literal["h264"] = "h264"
    crf: Annotated[int, Ge(0), Le(51)] | None = None
    bitrate_kbps: Annotated[float, Ge(10), Le(1e6)] | None = None
    group: Annotated[int, Ge(1), Le(10_000)] = 25
    pairs: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Refuse two measures of quality; without any the rate factor is 23, x264's own."""
        if self.crf is not None and self.bitrate_kbps is not None:
            raise ParameterError(
                "bitrate_kbps", "must be left out where crf is given, for each of them sets the quality; give one", self.bitrate_kbps
            )
        if self.crf is None and self.bitrate_kbps is None:
            object.__setattr__(self, "crf", 23)  # so that the scenario as run states it


STREAMS = OneOf("stream", JpegStream, H264Stream, fields={"quality": "jpeg", "crf": "h264", "bitrate_kbps": "h264", "group": "h264"})
