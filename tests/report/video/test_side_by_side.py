"""Runs side by side: in step with simulated time, whatever their films' rates and lengths."""

from __future__ import annotations

import resource
import tracemalloc
from pathlib import Path

import av
import numpy as np
import pytest

from vstestbed.report.video import VideoWriter
from vstestbed.report.video.side_by_side import DIMMED, Column, side_by_side

BAR = 34  # of a column of 480 px
BRIGHT, DARK = 200, 60


def film(
    path: Path, seconds: float, rate_hz: float = 25.0, size: tuple[int, int] = (120, 90)
) -> Path:
    """A film whose pictures carry their number: ten upright bars, a bright one, eight bits, a dark
    one.
    """
    with VideoWriter(path, rate_hz) as writer:
        for k in range(round(seconds * rate_hz)):
            bars = np.where([1, *(k >> np.arange(8) & 1), 0], BRIGHT, DARK).astype(np.uint8)
            row = bars[np.arange(size[0]) * 10 // size[0]]
            writer.write(np.broadcast_to(row[None, :, None], (size[1], size[0], 3)).copy())
    return path


def read(path: Path | None) -> tuple[np.ndarray, float]:
    """All pictures (frames, H, W, 3) and the rate of a film."""
    assert path is not None
    with av.open(str(path)) as container:
        pictures = [
            f.reformat(format="rgb24", src_colorspace="ITU709").to_ndarray()
            for f in container.decode(video=0)
        ]
        return np.array(pictures), float(container.streams.video[0].average_rate or 0)


def bars(pictures: np.ndarray, column: int, row: int, width: int = 480) -> np.ndarray:
    """Grey of the ten bars of the film of 4:3 in one place, (frames, 10)."""
    top, left = BAR + row * width * 3 // 4 + 120, column * (width + 2)  # below the banner
    part = pictures[:, top : top + 60, left : left + width].astype(float).mean(axis=(1, 3))
    return part.reshape(len(part), 10, width // 10)[:, :, 12:-12].mean(axis=2)


def number(pictures: np.ndarray, column: int, row: int) -> np.ndarray:
    """The number of the picture that is shown in one place, (frames,)."""
    grey = bars(pictures, column, row)
    return ((grey[:, 1:9] > (grey[:, :1] + grey[:, 9:]) / 2) << np.arange(8)).sum(axis=1)


def test_size_length_and_bars(tmp_path: Path) -> None:
    runs = [
        Column(
            "arm_ibvs",
            (film(tmp_path / f"{k}.mp4", 0.4 * k), film(tmp_path / f"{k}b.mp4", 0.4 * k)),
            "converged",
        )
        for k in (1, 2, 3)
    ]
    pictures, rate = read(side_by_side(runs, tmp_path / "all.mp4"))
    assert rate == 25.0
    # the longest, and one second
    assert pictures.shape == (10 * 3 + 25, 2 * BAR + 2 * 360, 3 * 480 + 2 * 2, 3)
    for left in (0, 482, 964):
        bar = pictures[10, :BAR, left : left + 480]
        assert np.median(bar) > 230 and bar.min() < 80  # dark words on light paper
        assert bar[:, :150].min() > 200 and bar[:, -150:].min() > 200  # in its middle
    clock = pictures[10, -BAR:]
    assert np.median(clock) < 40 and clock.max() > 200
    assert (pictures[10, 10:400, 480] > 200).all()  # a line between columns


@pytest.mark.study
def test_every_film_shows_its_newest_picture_of_the_moment(tmp_path: Path) -> None:
    rates = {(0, 0): 25.0, (0, 1): 10.0, (1, 0): 30.0, (1, 1): 12.5}
    films = {
        place: film(tmp_path / f"{rate}{place[0]}.mp4", 3.2, rate) for place, rate in rates.items()
    }
    runs = [Column(str(c), (films[c, 0], films[c, 1]), "") for c in range(2)]
    pictures, rate = read(side_by_side(runs, tmp_path / "all.mp4"))
    assert rate == 30.0 and len(pictures) == 96 + 30
    for (column, row), own_hz in rates.items():
        newest = np.floor(np.arange(96) / 30 * own_hz + 1e-6)
        np.testing.assert_array_equal(
            number(pictures, column, row), np.append(newest, 30 * [round(3.2 * own_hz) - 1])
        )


def test_a_film_of_many_pictures_a_second_is_shown_at_50_hz(tmp_path: Path) -> None:
    assert (
        read(
            side_by_side(
                [Column("a", (film(tmp_path / "a.mp4", 0.5, 200.0),), "")], tmp_path / "all.mp4"
            )
        )[1]
        == 50.0
    )


def test_a_run_that_has_ended_is_dimmed_and_says_how(tmp_path: Path) -> None:
    runs = [
        Column(
            "short",
            (film(tmp_path / "a.mp4", 1.0), film(tmp_path / "a2.mp4", 1.0)),
            "target_lost 1.0 s",
            success=False,
        ),
        Column(
            "long",
            (film(tmp_path / "b.mp4", 2.0), film(tmp_path / "b2.mp4", 2.0)),
            "converged 2.0 s",
            success=True,
        ),
    ]
    pictures, _ = read(side_by_side(runs, tmp_path / "all.mp4"))
    for row in (0, 1):
        assert (number(pictures, 0, row)[25:] == 24).all()  # held to the end
        bright = bars(pictures, 0, row)[:, 0]
        np.testing.assert_allclose(bright[:25], BRIGHT, atol=5)
        np.testing.assert_allclose(bright[25:], DIMMED * BRIGHT, atol=5)  # from 1.00 s on
    banner = pictures[:, BAR + 22 + 5, 240 - 90 : 240 + 90].astype(int)
    red = (banner[..., 0] - banner[..., 1] > 100).any(axis=1)
    assert not red[:25].any() and red[25:].all()
    banner = pictures[:, BAR + 22 + 5, 482 + 240 - 80 : 482 + 240 + 80].astype(int)
    green = (banner[..., 1] - banner[..., 0] > 50).any(axis=1)
    assert not green[:50].any() and green[50:].all()


def test_missing_empty_and_broken_films_are_grey_beside_the_others(tmp_path: Path) -> None:
    whole = film(tmp_path / "a.mp4", 1.4)
    (tmp_path / "empty.mp4").touch()
    (tmp_path / "words.mp4").write_text("no film " * 1000)
    (tmp_path / "cut.mp4").write_bytes(whole.read_bytes()[: whole.stat().st_size * 3 // 4])
    runs = [
        Column(f, (tmp_path / f"{f}.mp4",), "failed") for f in ("missing", "empty", "words", "cut")
    ] + [Column("a", (whole,), "done")]
    pictures, _ = read(side_by_side(runs, tmp_path / "all.mp4"))
    assert pictures.shape[2] <= 1926 and len(pictures) == 60
    for column in range(3):
        pane = pictures[30, 120:200, column * 385 + 20 : column * 385 + 120].astype(int)
        assert 30 < pane.mean() < 120 and pane.std() < 5
    assert side_by_side(runs[:3], tmp_path / "none.mp4") is None
    assert not (tmp_path / "none.mp4").exists()
    assert (
        side_by_side(
            [Column("no films", (), "failed"), Column("a", (whole,), "done")], tmp_path / "two.mp4"
        )
        is not None
    )
    assert side_by_side([Column("no films", (), "failed")], tmp_path / "none.mp4") is None


def test_films_of_other_shapes_are_centred_and_long_words_shortened(tmp_path: Path) -> None:
    wide, high = film(tmp_path / "w.mp4", 0.4, size=(160, 90)), film(tmp_path / "h.mp4", 0.4)
    runs = [
        Column("a very long label " * 20, (wide,), "an ending too long " * 9),
        Column("", (high,), ""),
    ]
    pictures, _ = read(side_by_side(runs, tmp_path / "all.mp4"))
    assert pictures.shape[1:3] == (2 * BAR + 360, 962)
    pane = pictures[3, BAR:-BAR, 200]
    # 270 of 360 rows
    assert pane[:40].max() < 40 and pane[-40:].max() < 40 and pane[60:-60].min() > 20
    # the label keeps off its edges
    assert pictures[3, :BAR, :8].min() > 200 and pictures[3, :BAR, 472:480].min() > 200


def test_two_times_the_same_bytes(tmp_path: Path) -> None:
    runs = [
        Column("a", (film(tmp_path / "a.mp4", 1.0),), "done"),
        Column("b", (film(tmp_path / "b.mp4", 0.5, 30.0),), "lost"),
    ]
    first, second = (side_by_side(runs, tmp_path / f"{name}.mp4") for name in ("x", "y"))
    assert first is not None and second is not None and first.read_bytes() == second.read_bytes()


@pytest.mark.study
def test_memory_does_not_grow_with_the_films(tmp_path: Path) -> None:
    """Films of 12 s take what films of 4 s do: 200 more pictures would be 250 MB, those of the
    films 90 MB.
    """
    size = (320, 240)
    runs = {
        s: [Column("a", (film(tmp_path / f"{s}{k}.mp4", s, size=size),), "") for k in range(2)]
        for s in (4.0, 5.0, 12.0)
    }
    side_by_side(runs[4.0], tmp_path / "short.mp4")
    resident = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    peaks = []
    for s in (5.0, 12.0):
        tracemalloc.start()
        side_by_side(runs[s], tmp_path / "long.mp4")
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] - peaks[0] < 1e6
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - resident < 30_000  # [KiB]
