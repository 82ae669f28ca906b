"""Lossy streams: coarser with the quality, in blocks, and quiet where nothing moves."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.camera import Image, Perspective
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.imaging.stream import H264Stream, JpegStream, VideoStream, round_trip
from vstestbed.tasks.base import GoalPicture

RATE = 25.0


def scene(shift: int = 0) -> Image:
    """A picture (96, 128, 3) with texture, edges and a ramp."""
    rng = np.random.default_rng(1)
    v, u = np.mgrid[:96, :128]
    image = np.stack([u, v * 2, 128 + 60 * np.sin(u / 5.0)], axis=-1) + rng.normal(
        0, 6, (96, 128, 3)
    )
    image[30:60, 40 + shift : 80 + shift] = (230, 30, 40)
    return np.clip(image, 0, 255).astype(np.uint8)


def psnr(a: Image, b: Image) -> float:
    """Peak signal to noise ratio of the brightness [dB]; colours have half the size whatever the
    quality.
    """
    return float(10 * np.log10(255**2 / ((grey(a) - grey(b)) ** 2).mean()))


def grey(image: Image) -> np.ndarray:
    return image.astype(float) @ [0.299, 0.587, 0.114]


def seams(image: Image) -> float:
    """Mean step of brightness across the borders of blocks of 8 px over that within them."""
    step = np.abs(np.diff(grey(image), axis=1)).mean(axis=0)
    border = np.arange(len(step)) % 8 == 7
    return float(step[border].mean() / step[~border].mean())


def test_it_is_coarser_with_less_quality():
    for ways in (
        [JpegStream(quality=q) for q in (95, 70, 30, 5)],
        [H264Stream(crf=q) for q in (10, 25, 35, 48)],
        [H264Stream(bitrate_kbps=b) for b in (2000, 150, 20)],
    ):
        reached = []
        for way in ways:
            trip = round_trip(way, RATE)
            reached.append(np.mean([psnr(scene(k), trip(scene(k))) for k in range(6)]))
        assert all(a > b + 1 for a, b in pairwise(reached))
        assert reached[0] > 28


def test_jpeg_has_blocks_of_8_px():
    assert seams(scene()) == pytest.approx(1.0, abs=0.3)
    assert seams(round_trip(JpegStream(quality=5), RATE)(scene())) > 2


def test_a_still_scene_keeps():
    jpeg = round_trip(JpegStream(quality=30), RATE)
    np.testing.assert_array_equal(jpeg(scene()), jpeg(scene()))
    video = round_trip(H264Stream(crf=30, group=100), RATE)
    pictures = [video(scene()) for _ in range(12)]
    later = [np.abs(a.astype(int) - b).mean() for a, b in pairwise(pictures[8:])]
    assert max(later) < 0.5  # the differences that are sent become nothing
    assert psnr(scene(), pictures[-1]) > psnr(scene(), pictures[0]) - 0.5


def test_each_picture_comes_out_at_once_and_is_that_one():
    video = round_trip(H264Stream(crf=20), RATE)
    for k in (0, 5, 20, 3):
        out = video(scene(k))
        this, other = (np.abs(out.astype(float) - scene(j)).mean() for j in (k, k + 12))
        assert psnr(scene(k), out) > 35 and this < 0.6 * other


@pytest.mark.parametrize("way", [JpegStream(quality=90), H264Stream(crf=15)], ids=["jpeg", "h264"])
def test_a_disc_stays_where_it_is(way: VideoStream):
    v, u = np.ogrid[:96, :128]
    image = np.full((96, 128, 3), 120, np.uint8)
    image[np.hypot(u - 70.3, v - 40.6) < 9] = (220, 40, 40)
    out = round_trip(way, RATE)(image).astype(float)
    for channel in (0, 1):
        difference = np.abs(out[..., channel] - 120)
        before = np.abs(image[..., channel].astype(float) - 120)
        difference[difference < 10] = 0
        for axis in (u, v):
            centre, was = ((d * axis).sum() / d.sum() for d in (difference, before))
            assert centre == pytest.approx(was, abs=0.1)


def test_two_encoders_give_the_same_bytes():
    first, second = (round_trip(H264Stream(bitrate_kbps=300), RATE) for _ in range(2))
    for k in range(5):
        np.testing.assert_array_equal(first(scene(k)), second(scene(k)))


@pytest.mark.parametrize("kind", [JpegStream, H264Stream])
def test_colours_of_full_size_keep_the_border_of_a_colour(kind: type[VideoStream]):
    quality = {"quality": 95} if kind is JpegStream else {"crf": 10}
    image = np.full((96, 128, 3), (164, 164, 162), np.uint8)
    image[21:51, 31:75] = (191, 0, 0)  # odd: a pair of pixels has both colours
    errors = {}
    for colours in ("half", "full"):
        out = round_trip(kind(colours=colours, **quality), RATE)(image)
        errors[colours] = np.abs(out[30:40, 27:35].astype(float) - image[30:40, 27:35]).max()
    assert errors["full"] < 30 and errors["half"] > 50


def test_none_is_the_same_object():
    image = scene()
    assert round_trip(None, RATE)(image) is image


def test_what_contradicts_itself_is_refused():
    with pytest.raises(ParameterError, match="must be left out where crf is given"):
        H264Stream(crf=20, bitrate_kbps=100)
    with pytest.raises(ParameterError, match="even"):
        Perspective(width=641, stream=H264Stream())
    Perspective(width=641, stream=H264Stream(colours="full"))
    assert H264Stream().crf == 23


@pytest.mark.parametrize(
    ("block", "kind"),
    [
        ({"bitrate_kbps": 500}, H264Stream),
        ({"crf": 30}, H264Stream),
        ({"group": 5}, H264Stream),
        ({"quality": 40}, JpegStream),
    ],
)
def test_a_field_of_one_kind_alone_names_the_kind(block: dict[str, Any], kind: type) -> None:
    assert isinstance(
        vs.load(
            "arm_ibvs", {f"camera.stream.{name}": value for name, value in block.items()}
        ).camera.stream,
        kind,
    )


def test_a_field_of_another_kind_is_refused_with_the_kind_that_has_it() -> None:
    with pytest.raises(
        ScenarioError,
        match=r"camera\.stream\.bitrate_kbps: is an unknown field of jpeg; h264 has it",
    ):
        vs.load("arm_ibvs", {"camera.stream": "jpeg", "camera.stream.bitrate_kbps": 500})


LUMINANCE = """
16 11 10 16 24 40 51 61
12 12 14 19 26 58 60 55
14 13 16 24 40 57 69 56
14 17 22 29 51 87 80 62
18 22 37 56 68 109 103 77
24 35 55 64 81 104 113 92
49 64 78 87 103 121 120 101
72 92 95 98 112 100 103 99
"""
"""Quantisation steps of the brightness at quality 50 (ISO/IEC 10918-1:1994, table K.1)."""


@pytest.mark.parametrize("quality", [90, 80])
def test_the_error_of_jpeg_is_that_of_its_quantisation(quality: int) -> None:
    """Of a picture whose DCT coefficients are all much wider than the steps q, each is off by q^2 /
    12 in the mean, and each rounded grey level by 1/12 more; the transform is orthonormal, so that
    the mean square over the pixels is the same.
    """
    noise = np.clip(np.random.default_rng(3).normal(128, 40, (240, 320)), 0, 255).astype(np.uint8)
    picture = np.repeat(noise[..., None], 3, axis=-1)
    steps = np.floor((np.array(LUMINANCE.split(), dtype=float) * (200 - 2 * quality) + 50) / 100)
    off = grey(round_trip(JpegStream(quality=quality), RATE)(picture)) - grey(picture)
    assert np.mean(off**2) == pytest.approx(np.mean(steps**2) / 12 + 1 / 12, rel=0.05)


def test_a_picture_of_the_goal_may_be_kept_as_jpeg():
    image, rng = scene(), np.random.default_rng(0)
    for quality in (95, 30):
        kept = GoalPicture(jpeg_quality=quality).under_its_light(image, rng)
        assert np.array_equal(kept, round_trip(JpegStream(quality=quality), RATE)(image))
    assert np.array_equal(GoalPicture().under_its_light(image, rng), image)
    with pytest.raises(
        ParameterError, match="jpeg_quality is for a picture that the simulated camera takes"
    ):
        GoalPicture(file="goal.png", jpeg_quality=95)


def test_six_steps_of_crf_double_the_error_of_h264():
    """The step of its quantiser is 2^((crf - 4)/6), and the error of many coefficients in
    proportion; a still scene stays as it is.
    """
    rng = np.random.default_rng(0)
    image = np.repeat(np.clip(rng.normal(128, 30, (240, 320, 1)), 0, 255), 3, axis=2).astype(
        np.uint8
    )
    error = []
    for crf in (18, 24, 30):
        coded = round_trip(H264Stream(crf=crf, colours="full"), RATE)
        pictures = [coded(image) for _ in range(3)]
        assert np.array_equal(pictures[0], pictures[2])
        error.append((grey(pictures[0]) - grey(image)).std())
    assert [b / a for a, b in pairwise(error)] == pytest.approx([2.0, 2.0], rel=0.06)
