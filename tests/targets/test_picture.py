"""Pictures as targets: where their markers are, which files are read, what is said of those that
cannot be.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Pose
from vstestbed.targets import PictureTarget
from vstestbed.targets.markers import Disc
from vstestbed.targets.picture import MOST_PX, SHARE, read_picture


def picture(**settings: Any) -> PictureTarget:
    return PictureTarget(pose=Pose(), **settings)


def saved(path: Path, image: np.ndarray) -> str:
    """The name of a picture (H, W), (H, W, 3) or (H, W, 4), blue first, written to a file."""
    assert cv2.imwrite(str(path), image)
    return str(path)


def texture(path: str) -> np.ndarray:
    """The picture without its margin as it is drawn, red first."""
    image = np.asarray(
        cv2.imdecode(np.frombuffer(read_picture(Path(path), 0)[0], np.uint8), cv2.IMREAD_COLOR_RGB)
    )
    return image[: round(image.shape[0] * SHARE), : round(image.shape[1] * SHARE)]


@pytest.fixture
def plain(tmp_path: Path) -> str:
    return saved(tmp_path / "plain.png", np.full((30, 60, 3), 200, np.uint8))


def test_its_markers_are_its_corners(plain: str):
    target = picture(file=plain, width=0.4, marker=Disc(radius=0.01))
    assert target.height == pytest.approx(0.2)
    np.testing.assert_allclose(
        target.points, [[-0.2, -0.1, 0], [0.2, -0.1, 0], [0.2, 0.1, 0], [-0.2, 0.1, 0]]
    )
    assert (
        target.board_half_m == pytest.approx((0.2 + 2.5 * 0.01, 0.1 + 2.5 * 0.01))
        and target.one_sided
    )


def test_or_points_in_pixels_of_the_file(plain: str):
    target = picture(
        file=plain, width=0.6, at_px=((-0.5, -0.5), (29.5, 14.5), (59.5, 29.5)), draw_markers=False
    )
    np.testing.assert_allclose(
        target.points, [[-0.3, -0.15, 0], [0, 0, 0], [0.3, 0.15, 0]], atol=1e-12
    )
    assert target.board_half_m == pytest.approx((0.3, 0.15)) and not target.draw_markers
    with pytest.raises(
        ParameterError,
        match=r"at_px.1 must be within the picture, which has 60 x 30 px, got \[60.0, 0.0\]",
    ):
        picture(file=plain, width=0.6, at_px=((0, 0), (60, 0)))


@pytest.mark.parametrize("kind", ["grey", "deep", "clear", "deep and clear", "jpeg"])
def test_pictures_of_all_kinds_are_drawn_in_their_colours(tmp_path: Path, kind: str):
    colour = np.tile(np.array([40, 120, 200], np.uint8), (28, 56, 1))  # blue first
    clear = np.dstack(
        [colour, np.where(np.arange(56) < 28, 255, 0).astype(np.uint8)[None].repeat(28, 0)]
    )
    image = {
        "grey": colour[..., 1],
        "deep": colour * np.uint16(257),
        "clear": clear,
        "deep and clear": clear * np.uint16(257),
    }.get(kind, colour)
    drawn = texture(saved(tmp_path / ("a.jpg" if kind == "jpeg" else "a.png"), image)).astype(int)
    left, right = drawn[:, :20], drawn[:, -20:]
    assert np.abs(left - ([120] * 3 if kind == "grey" else [200, 120, 40])).max() <= 3
    # what is transparent is white
    assert np.abs(right - (255 if "clear" in kind else left[:, :20])).max() <= 3


def test_the_margin_repeats_the_edges_that_are_next_to_it(tmp_path: Path):
    image = np.zeros((56, 56, 3), np.uint8)
    image[:, 28:] = 255
    png, _ = read_picture(Path(saved(tmp_path / "a.png", image)), 0)
    whole = np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_GRAYSCALE))
    assert whole.shape == (64, 64) and SHARE == 0.875
    # the right edge's, then that of the left, to which it leads
    np.testing.assert_array_equal(whole[30, 56:], [255] * 4 + [0] * 4)
    np.testing.assert_array_equal(whole[:56, :56], image[..., 0])


def test_a_large_one_is_reduced(tmp_path: Path):
    png, size = read_picture(Path(saved(tmp_path / "large.png", np.zeros((40, 3000), np.uint8))), 0)
    assert size == (3000, 40)
    assert np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)).shape == (
        64,
        MOST_PX,
        3,
    )


def test_what_is_no_picture_is_told(tmp_path: Path):
    for name, content, words in (
        ("gone.png", None, "is not there"),
        (
            "note.png",
            b"no picture at all",
            r"cannot be read \(it is damaged, or another kind of file\); works: a PNG or JPEG",
        ),
        ("empty.png", b"", "cannot be read"),
        ("page.pdf", b"%PDF", "must be a picture, FILE.png or FILE.jpg"),
    ):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(ParameterError, match=f"^file {words}"):
            picture(file=str(tmp_path / name), width=0.4)


def test_a_picture_cut_short_is_told_or_read(tmp_path: Path, plain: str):
    (tmp_path / "cut.png").write_bytes(Path(plain).read_bytes()[:60])
    with pytest.raises(ParameterError, match="cannot be read"):
        picture(file=str(tmp_path / "cut.png"), width=0.4)


def test_markers_that_overlap_and_sizes_of_nothing(plain: str):
    with pytest.raises(
        ParameterError,
        match=r"marker.radius must be under half of the smallest gap between markers, 0.01 m",
    ):
        picture(file=plain, width=0.02)
    with pytest.raises(ParameterError, match="width"):
        picture(file=plain, width=0)
