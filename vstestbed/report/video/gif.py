"""A film as a looping GIF for a README: as large as 3 MB allow."""

from __future__ import annotations

import contextlib
import io
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import av
from av.error import BlockingIOError as NotYetError
from av.error import EOFError as EndError
from av.filter import Graph

from vstestbed.core.errors import ParameterError
from vstestbed.core.files import write_whole

if TYPE_CHECKING:
    from av import VideoFrame
    from av.filter.context import FilterContext

LARGEST_BYTES = 3_000_000
STEPS = (640, 15), (480, 15), (480, 8), (400, 5), (320, 5), (320, 2.5), (240, 1), (240, 0.4)
"""Width [px] and most pictures a second, tried in turn until the file is small enough."""
SAMPLED = 60  # Pictures from which the palette is made, at most
TICK = Fraction(1, 100)  # The unit of a GIF's delays [s]


@dataclass(frozen=True, slots=True)
class Gif:
    """A GIF as it was written: file, size [px], pictures a second, bytes."""

    path: Path
    width: int
    height: int
    rate_hz: float
    size: int

    def __str__(self) -> str:
        """In words."""
        return f"{self.path} ({self.width} x {self.height}, {self.rate_hz:.3g} pictures a second, {self.size / 1e6:.2f} MB)"


def gif_of(film: Callable[[Path], Path | None], path: Path) -> Gif | None:
    """The GIF of the film that a function makes under the path that it is given; None if it makes none. Raises as `write_gif` does."""
    with TemporaryDirectory(prefix="vstestbed_") as place:
        made = film(Path(place) / "film.mp4")
        return made and write_gif(made, path)


def write_gif(film: Path, path: Path) -> Gif:
    """Write a film as a GIF that repeats for ever, in real time, in 256 colours of its own, and say which size was chosen.

    ParameterError: it is too long for LARGEST_BYTES. EnvironmentLackError, OutputError: the file cannot be written.
    """
    with av.open(str(film)) as container:
        stream = container.streams.video[0]
        width, height, rate_hz = stream.width, stream.height, float(stream.average_rate or 1)
    for most_px, most_hz in STEPS:
        every = max(1, math.ceil(rate_hz / most_hz - 1e-9))
        wide = min(most_px, width)
        high = max(1, round(wide * height / width))
        content = _encoded(film, every, wide, high)
        if content is not None:
            write_whole(path, content)
            return Gif(path, wide, high, rate_hz / every, len(content))
    raise ParameterError(
        "--gif", f"makes files of up to {LARGEST_BYTES / 1e6:g} MB, for which this run is too long; leave it out for a film"
    )


def _encoded(film: Path, every: int, width: int, height: int) -> bytes | None:
    """The GIF's content, of every n-th picture; None if it becomes too large."""
    file = io.BytesIO()
    with av.open(file, "w", format="gif", options={"loop": "0"}) as container:
        stream = container.add_stream("gif")
        stream.width, stream.height, stream.pix_fmt = width, height, "pal8"
        stream.codec_context.time_base = TICK
        for picture in _in_few_colours(film, every, width, height):
            for packet in stream.encode(picture):
                container.mux(packet)
            if file.tell() > LARGEST_BYTES:
                break
        for packet in stream.encode():
            container.mux(packet)
    return file.getvalue() if file.tell() <= LARGEST_BYTES else None


def _in_few_colours(film: Path, every: int, width: int, height: int) -> Iterator[VideoFrame]:
    """The pictures, scaled, in the colours of their palette; not dithered, since its noise takes room."""
    palette = _palette(film, width, height)
    graph = Graph()
    source, scaled = _scaled(graph, film, width, height)
    colours = graph.add_buffer(width=palette.width, height=palette.height, format=palette.format, time_base=TICK)
    reduced, sink = graph.add("paletteuse", "dither=none:diff_mode=rectangle"), graph.add("buffersink")
    colours.link_to(reduced, 0, 1)
    graph.link_nodes(scaled, reduced, sink).configure()
    colours.push(palette)
    colours.push(None)
    yield from _through(source, sink, _pictures(film, every))


def _palette(film: Path, width: int, height: int) -> VideoFrame:
    """The 256 colours that suit a film best, as an image of 16 x 16 pixels."""
    with av.open(str(film)) as container:
        every = max(1, container.streams.video[0].frames // SAMPLED)
    graph = Graph()
    source, scaled = _scaled(graph, film, width, height)
    sink = graph.add("buffersink")
    graph.link_nodes(scaled, graph.add("palettegen"), sink).configure()
    (palette,) = _through(source, sink, _pictures(film, every))
    return palette


def _scaled(graph: Graph, film: Path, width: int, height: int) -> tuple[FilterContext, FilterContext]:
    """The beginning of a graph of filters: its source, and the filter that scales."""
    with av.open(str(film)) as container:
        source = graph.add_buffer(template=container.streams.video[0], time_base=TICK)
    scaled = graph.add("scale", f"{width}:{height}:flags=area")
    source.link_to(scaled)
    return source, scaled


def _pictures(film: Path, every: int) -> Iterator[VideoFrame]:
    """Every n-th picture of a film, with its time in ticks."""
    with av.open(str(film)) as container:
        for number, frame in enumerate(container.decode(video=0)):
            if number % every == 0:
                frame.pts, frame.time_base = round((frame.time or 0.0) / TICK), TICK
                yield frame


def _through(source: FilterContext, sink: FilterContext, pictures: Iterable[VideoFrame]) -> Iterator[VideoFrame]:
    """What comes out of a graph of filters for the pictures that go in."""
    for picture in chain(pictures, [None]):
        source.push(picture)
        with contextlib.suppress(NotYetError, EndError):
            while True:
                frame = sink.pull()
                assert isinstance(frame, av.VideoFrame)
                yield frame
