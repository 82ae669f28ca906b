"""A film as a looping GIF for a README: as large as 3 MB allow."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import av
import numpy as np
from PIL import Image

from vstestbed.core.errors import ParameterError
from vstestbed.core.files import write_whole

LARGEST_BYTES = 3_000_000
STEPS = (640, 15), (480, 15), (480, 8), (400, 5), (320, 5), (320, 2.5), (240, 1), (240, 0.4)
"""Width [px] and most pictures a second, tried in turn until the file is small enough."""
MOST_PICTURES = 1000  # which are in memory; of more, each would have under 3 kB
SAMPLED = 60  # Pictures from which the palette is made, at most


def gif_of(film: Callable[[Path], Path | None], path: Path) -> str | None:
    """`write_gif` of the film that a function makes under the path that it is given; None if it
    makes none.
    """
    with TemporaryDirectory(prefix="vstestbed_") as place:
        made = film(Path(place) / "film.mp4")
        return made and write_gif(made, path)


def write_gif(film: Path, path: Path) -> str:
    """Write a film as a GIF that repeats for ever, in real time, in 256 colours of its own; says in
    words which size was chosen.

    ParameterError: it is too long for LARGEST_BYTES. EnvironmentLackError, OutputError: the file
    cannot be written.
    """
    with av.open(str(film)) as container:
        stream = container.streams.video[0]
        width, height, rate_hz, frames = (
            stream.width,
            stream.height,
            float(stream.average_rate or 1),
            stream.frames,
        )
    for most_px, most_hz in STEPS:
        every, wide = max(1, math.ceil(rate_hz / most_hz - 1e-9)), min(most_px, width)
        size = wide, max(1, round(wide * height / width))
        content = _encoded(film, every, size, frames) if frames <= every * MOST_PICTURES else b""
        if 0 < len(content) <= LARGEST_BYTES:
            write_whole(path, content)
            return (
                f"{path} ({size[0]} x {size[1]}, {rate_hz / every:.3g} pictures a second,"
                f" {len(content) / 1e6:.2f} MB)"
            )
    words = (
        f"makes files of up to {LARGEST_BYTES / 1e6:g} MB, for which this run is too long;"
        " leave it out for a film"
    )
    raise ParameterError("--gif", words)


def _encoded(film: Path, every: int, size: tuple[int, int], frames: int) -> bytes:
    """The GIF's content, of every n-th picture; not dithered, since its noise takes room."""
    sample = [
        picture.reduce(2) for _, picture in _pictures(film, max(every, frames // SAMPLED), size)
    ]
    palette = Image.fromarray(np.vstack([np.asarray(picture) for picture in sample])).quantize(256)
    times, pictures = zip(
        *(
            (t, p.quantize(palette=palette, dither=Image.Dither.NONE))
            for t, p in _pictures(film, every, size)
        ),
        strict=True,
    )
    ticks = [round(100 * t) for t in times]  # the unit of a GIF's delays is 10 ms
    shown_ms = [
        10 * (after - before)
        for before, after in zip(ticks, [*ticks[1:], ticks[-1] + 10], strict=True)
    ]
    file = io.BytesIO()
    pictures[0].save(
        file, "GIF", save_all=True, append_images=pictures[1:], duration=shown_ms, loop=0
    )
    return file.getvalue()


def _pictures(film: Path, every: int, size: tuple[int, int]) -> Iterator[tuple[float, Image.Image]]:
    """Every n-th picture of a film, scaled, with its time [s]."""
    with av.open(str(film)) as container:
        for number, frame in enumerate(container.decode(video=0)):
            if number % every == 0:
                yield (
                    frame.time or 0.0,
                    frame.to_image(
                        width=size[0], height=size[1], interpolation="AREA", src_colorspace="ITU709"
                    ),
                )
