"""A film as a GIF: it repeats, keeps real time, and is small enough."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.report.video import VideoWriter, gif
from vstestbed.report.video.gif import write_gif


@pytest.fixture
def film(tmp_path: Path) -> Path:
    """Two seconds at 25 Hz: a red square crosses a grey picture."""
    with VideoWriter(tmp_path / "a.mp4", 25) as writer:
        for k in range(50):
            image = np.full((180, 320, 3), 120, np.uint8)
            image[60:100, 4 * k : 4 * k + 40] = (220, 30, 30)
            writer.write(image)
    return tmp_path / "a.mp4"


def test_it_repeats_for_ever_in_real_time(film: Path):
    made = write_gif(film, film.with_suffix(".gif"))
    content = film.with_suffix(".gif").read_bytes()
    assert (
        made == f"{film.with_suffix('.gif')} (320 x 180, 12.5 pictures a second,"
        f" {len(content) / 1e6:.2f} MB)"
    )
    # 0: without end
    assert content.startswith(b"GIF89a") and b"NETSCAPE2.0\x03\x01\x00\x00" in content
    with av.open(str(film.with_suffix(".gif"))) as container:
        frames = list(container.decode(video=0))
    assert [round(f.time or 0, 2) for f in frames] == [round(0.08 * k, 2) for k in range(25)]
    image = frames[10].to_ndarray(format="rgb24")
    np.testing.assert_allclose(image[80, 4 * 20 + 20], (220, 30, 30), atol=12)
    np.testing.assert_allclose(image[10, 10], 120, atol=6)


def test_it_becomes_smaller_and_slower_until_it_fits(film: Path, monkeypatch: pytest.MonkeyPatch):
    write_gif(film, film.with_suffix(".gif"))
    whole = film.with_suffix(".gif").stat().st_size
    monkeypatch.setattr(gif, "STEPS", ((640, 15), (160, 5)))
    monkeypatch.setattr(gif, "LARGEST_BYTES", whole - 1)
    small = write_gif(film, film.with_suffix(".gif"))
    assert "(160 x 90, 5 pictures a second, " in small
    assert film.with_suffix(".gif").stat().st_size < whole
    monkeypatch.setattr(gif, "LARGEST_BYTES", 100)
    with pytest.raises(
        ParameterError,
        match=(
            r"--gif makes files of up to 0.0001 MB, for which this run is too long;"
            r" leave it out for a film"
        ),
    ):
        write_gif(film, film.with_name("b.gif"))
    assert not film.with_name("b.gif").exists()
