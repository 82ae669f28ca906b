"""Films and what is drawn over them."""

from __future__ import annotations

import resource
import subprocess
import sys
import tracemalloc
from collections.abc import Iterable
from pathlib import Path
from re import fullmatch

import av
import numpy as np
import pytest

from vstestbed.core.errors import OutputError
from vstestbed.report.video import Overlay, VideoWriter, captioned
from vstestbed.report.video.overlay import strip_height

RED_AND_BLUE = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def pictures(count: int, height: int = 48, width: int = 64) -> Iterable[np.ndarray]:
    """Grey pictures with a bright square that moves one pixel a frame."""
    for k in range(count):
        image = np.full((height, width, 3), 90, np.uint8)
        image[10:20, k % 40 : k % 40 + 10] = (230, 40, 40)
        yield image


def film(
    path: Path, count: int = 30, rate_hz: float = 25.0, height: int = 48, width: int = 64
) -> Path:
    """A finished film of those pictures."""
    with VideoWriter(path, rate_hz) as writer:
        for image in pictures(count, height, width):
            writer.write(image)
    return path


@pytest.mark.parametrize("rate_hz", [0.5, 25.0, 29.97, 30.0, 33.3, 200.0])
def test_a_film_is_h264_of_the_given_size_rate_and_length(tmp_path: Path, rate_hz: float) -> None:
    with av.open(str(film(tmp_path / "a.mp4", 30, rate_hz))) as container:
        stream = container.streams.video[0]
        frames = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
        assert (stream.codec_context.name, stream.pix_fmt, stream.width, stream.height) == (
            "h264",
            "yuv420p",
            64,
            48,
        )
        assert float(stream.average_rate or 0) == pytest.approx(rate_hz, rel=1e-9)
        assert stream.frames == len(frames) == 30
        assert float((stream.duration or 0) * (stream.time_base or 0)) == pytest.approx(
            30 / rate_hz, rel=1e-3
        )


def test_the_colours_come_back(tmp_path: Path) -> None:
    with av.open(str(film(tmp_path / "a.mp4", 5))) as container:
        frame = next(container.decode(video=0))
        # BT.709, limited range: said in the file, so players agree
        assert (frame.colorspace, frame.color_range) == (1, 1)
        image = frame.reformat(format="rgb24", src_colorspace="ITU709").to_ndarray()
    # yuv420p at crf 20 keeps a flat colour to about 5 %
    np.testing.assert_allclose(image[14, 4], (230, 40, 40), atol=12)
    np.testing.assert_allclose(image[40, 50], (90, 90, 90), atol=4)


def test_the_index_stands_before_the_pictures(tmp_path: Path) -> None:
    data = film(tmp_path / "a.mp4").read_bytes()
    assert 0 < data.index(b"moov") < data.index(b"mdat")


def test_two_writes_give_the_same_bytes(tmp_path: Path) -> None:
    assert film(tmp_path / "a.mp4", 60).read_bytes() == film(tmp_path / "b.mp4", 60).read_bytes()


@pytest.mark.parametrize(("height", "width"), [(49, 65), (48, 65), (49, 64)])
def test_odd_sizes_are_padded_by_their_last_row_or_column(
    tmp_path: Path, height: int, width: int
) -> None:
    with av.open(str(film(tmp_path / "a.mp4", 3, height=height, width=width))) as container:
        image = next(container.decode(video=0)).to_ndarray(format="rgb24")
    assert image.shape == (height + height % 2, width + width % 2, 3)
    np.testing.assert_allclose(image[-1, -1], 90, atol=4)  # not black


@pytest.mark.study
def test_memory_does_not_grow_with_the_film(tmp_path: Path) -> None:
    """2000 frames of 320 x 240 are 460 MB as RGB; the encoder itself holds about 20 frames (5 MB)
    and its tables.
    """
    noise = np.random.default_rng(0).integers(80, 110, (240, 330, 3), dtype=np.uint8)
    tracemalloc.start()
    with VideoWriter(tmp_path / "a.mp4", 25) as writer:
        for k in range(2000):
            writer.write(noise[:, k % 10 : k % 10 + 320])
            if k == 200:
                resident, (traced, _) = (
                    resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
                    tracemalloc.get_traced_memory(),
                )
    grown_traced = tracemalloc.get_traced_memory()[0] - traced
    tracemalloc.stop()
    assert grown_traced < 1e6  # Python's side: no list of frames or packets
    # [KiB] FFmpeg's side: 6 % of the pictures
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - resident < 30_000


def test_a_film_has_its_name_only_when_it_is_whole(tmp_path: Path) -> None:
    writer = VideoWriter(tmp_path / "a.mp4", 25)
    for image in pictures(5):
        writer.write(image)
    assert [
        fullmatch(r"a\.mp4\.[0-9a-f]{16}\.part", p.name) is not None for p in tmp_path.iterdir()
    ] == [True]
    assert writer.close() == tmp_path / "a.mp4"
    assert [p.name for p in tmp_path.iterdir()] == ["a.mp4"]
    assert writer.close() == tmp_path / "a.mp4"  # twice does no harm


def test_abort_and_exceptions_leave_nothing(tmp_path: Path) -> None:
    writer = VideoWriter(tmp_path / "a.mp4", 25)
    for image in pictures(5):
        writer.write(image)
    writer.abort()
    assert writer.close() is None
    with pytest.raises(KeyboardInterrupt), VideoWriter(tmp_path / "b.mp4", 25) as other:
        other.write(np.zeros((48, 64, 3), np.uint8))
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_a_film_without_frames_is_no_file(tmp_path: Path) -> None:
    with VideoWriter(tmp_path / "a.mp4", 25) as writer:
        assert writer.close() is None
    assert list(tmp_path.iterdir()) == []


FULL_DISK = """
import resource, sys
import numpy as np
from vstestbed.core.errors import EnvironmentLackError
from vstestbed.report.video import VideoWriter
resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
rng = np.random.default_rng(0)
try:
    with VideoWriter(sys.argv[1], 25) as writer:
        for _ in range(100):
            writer.write(rng.integers(0, 255, (240, 320, 3), dtype=np.uint8))
except EnvironmentLackError as error:
    print(error)
    sys.exit(error.exit_code)
"""


@pytest.mark.process
def test_a_full_disk_is_told_with_the_path_and_leaves_nothing(tmp_path: Path) -> None:
    """The limit on a file's size gives EFBIG where a full disk gives ENOSPC; in a process of its
    own, as it cannot be lifted.
    """
    path = tmp_path / "a.mp4"
    ended = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(path)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert ended.returncode == 4, ended.stderr
    assert str(path) in ended.stdout
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_an_output_error(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"nowhere.*--out"):
        VideoWriter(tmp_path / "nowhere" / "a.mp4", 25).write(np.zeros((48, 64, 3), np.uint8))


def drawn(uv: list[list[float]], goal: list[list[float]] | None, lost: bool = False) -> np.ndarray:
    """A grey 640 x 480 picture after one overlay of a red and a blue marker."""
    image = np.full((480, 640, 3), 128, np.uint8)
    overlay = Overlay(640, 480, RED_AND_BLUE)
    overlay.draw(image, np.array(uv), None if goal is None else np.array(goal), lost)
    return image


def touched(image: np.ndarray, left: int, top: int, right: int, bottom: int) -> int:
    """How many pixels of a box are not the grey of the picture."""
    return int((image[top:bottom, left:right] != 128).any(axis=2).sum())


def test_crosses_and_diamonds_stand_where_they_should() -> None:
    image = drawn([[100.0, 120.0], [300.0, 200.0]], [[200.0, 150.0], [400.0, 250.0]])
    arm = 480 // 40 - 3
    red, blue = image[120, 100 + arm].astype(int), image[200 - arm, 300].astype(int)
    # each in its colour, along the arms of its cross
    assert red[0] > 200 > 120 > red[1] and blue[2] > 200 > 120 > blue[0]
    # which leave the marker free
    assert (image[118:123, 98:103] == 128).all() and (image[198:203, 298:303] == 128).all()
    assert (image[150, 200] == 128).all() and (image[250, 400] == 128).all()  # a diamond is hollow
    corner = image[150 - 14 : 150 - 10, 199:202].astype(int)  # its tip, 480/36 px above
    assert corner.min() < 60  # dark border
    assert touched(image, 0, 0, 640, 100) == 0  # and nothing elsewhere
    assert touched(image, 90, 110, 111, 131) > 50


def test_of_a_region_both_outlines_are_drawn_and_the_trail_of_its_middle() -> None:
    square = np.array([[100.0, 100.0], [200.0, 100.0], [200.0, 200.0], [100.0, 200.0]])
    overlay = Overlay(640, 480, np.tile([1.0, 0.0, 0.0], (4, 1)), outlined=True)
    for step in (0, 40):
        image = np.full((480, 640, 3), 128, np.uint8)
        overlay.draw(image, square + [step, 0], square + [250, 0])
    assert image[100, 190].min() > 200 and image[120, 140].min() > 200  # white, as measured
    assert (image[120, 350] == (72, 214, 255)).all()  # cyan at the goal, of a region of any colour
    # both with a dark edge
    assert (
        image[120, 345:350].max(axis=1).min() < 100 and image[120, 140:145].max(axis=1).min() < 100
    )
    assert image[200, 300].min() > 200  # lines from points to their goals
    # from the middle before to that now
    assert image[150, 170, 0] > 230 and image[150, 170, 1] < 30
    assert (image[110:140, 250:340] == 128).all()
    lost = np.full((480, 640, 3), 128, np.uint8)
    overlay.draw(lost, np.full((4, 2), np.nan), None)
    assert (lost[90:210, 250:600] == 128).all()


def test_the_centre_of_a_cross_follows_fractions_of_a_pixel() -> None:
    def centroid(u: float) -> float:
        weight = np.abs(
            drawn([[u, 120.0], [300.0, 200.0]], None)[100:140, 60:140, 1].astype(float) - 128
        ).sum(axis=0)
        return float((weight * np.arange(60, 140)).sum() / weight.sum())

    # anti-aliasing spreads over whole pixels
    assert centroid(100.5) - centroid(100.0) == pytest.approx(0.5, abs=0.15)


def test_markers_not_seen_or_far_outside_are_left_out() -> None:
    image = drawn([[np.nan, np.nan], [1e12, -1e12]], [[np.nan, 0.0], [-1e9, 3.0]])
    assert touched(image, 0, 0, 640, 480) == 0


def test_lost_shows_a_red_banner() -> None:
    image = drawn([[np.nan] * 2] * 2, None, lost=True)
    assert touched(image, 200, 20, 440, 80) > 4000
    assert (image[32, 320 - 105] == (200, 30, 45)).all()


def test_trails_are_kept_broken_where_unseen_and_bounded() -> None:
    overlay = Overlay(640, 480, RED_AND_BLUE[:1])
    for k in range(100):
        image = np.full((480, 640, 3), 128, np.uint8)
        u = 50.0 + 5 * k
        overlay.draw(image, np.array([[np.nan if 40 <= k < 60 else u, 300.0]]), None)
    assert image[300, 150, 0] > 230 and image[300, 450, 0] > 230  # a red line behind the marker
    assert (image[300, 260:340] == 128).all()  # the unseen stretch
    for k in range(2000):
        overlay.draw(
            image, np.array([[320 + 200 * np.cos(k / 9), 240 + 100 * np.sin(k / 9)]]), None
        )
    assert sum(len(piece) for piece in overlay._trails[0].polylines()) <= 512


@pytest.mark.parametrize(("width", "height"), [(160, 120), (320, 240), (1280, 960)])
def test_captions_fit_and_scale(width: int, height: int) -> None:
    image, strip = np.full((height, width, 3), 128, np.uint8), strip_height(height)
    found = captioned(
        image, "a title much too long for a small picture", strip, t=123.45, error="error 1.23 px"
    )
    assert found.shape == (height + strip, width, 3) and strip % 2 == 0
    assert (found[:height] == 128).all()  # nothing stands on the picture
    assert found[height:].max() > 200  # light words below it
    assert found[height, width // 2].max() < 60
