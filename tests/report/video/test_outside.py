"""What films from outside show beside the scene: the goal, frustums, the trail, the inset, the
error, the end.
"""

from __future__ import annotations

import math
from pathlib import Path

import av
import numpy as np
import pytest

import vstestbed as vs
from vstestbed.camera import Perspective
from vstestbed.core.geometry import Array, inverse, transform
from vstestbed.core.outcome import Outcome
from vstestbed.report.video.film import DRAFT, FINE, Film, Pictures, error_in_words, replay_of
from vstestbed.report.video.outside import DRAWN_FOR, GOAL, MOST_PLACES, Outside, Pen
from vstestbed.report.video.overlay import GOOD, FilmFrame, draw_ending, strip_height, text_size
from vstestbed.scenario.scenario import Scenario

SIZE = 320, 180


def at_the_start(s: Scenario, t: float = 0.0, own: float = 0.0, grey: int | None = 90) -> FilmFrame:
    """A frame with everything at its start; grey: level of the servo camera's image."""
    parts = s.scene
    q, T = parts.start
    image = None if grey is None else np.full((s.camera.height, s.camera.width, 3), grey, np.uint8)
    uv = np.full((len(s.target.points), 2), np.nan)
    return FilmFrame(
        t, parts.T_world_target, T, q, uv, 12.34, False, uv, np.full(len(s.own_columns), own), image
    )


def test_a_pen_draws_where_the_camera_projects_and_fills_convex_hulls() -> None:
    lens, image = Perspective(width=320, height=180, fovy_deg=40), np.zeros((180, 320, 3), np.uint8)
    pen = Pen(image, lens, np.eye(4), 1)
    square = np.array([[-0.2, -0.1, 2.0], [0.2, -0.1, 2.0], [0.2, 0.1, 2.0], [-0.2, 0.1, 2.0]])
    pen.area(square[None], (200, 200, 200), 0.5)
    low, high = lens.project(square).min(axis=0), lens.project(square).max(axis=0)
    rows, columns = np.nonzero(image[..., 0])
    assert [columns.min(), rows.min(), columns.max(), rows.max()] == pytest.approx(
        [*low, *high], abs=1.5
    )
    assert (image[90, 160] == 100).all()  # half of the colour within
    assert image[90, round(low[0])].max() > 150  # and all of it along the edge
    assert pen.metres(0.1, np.array([0, 0, 2.0])) == pytest.approx(0.1 * 320 * 2.0 / lens.f)
    before = image.copy()
    pen.area(-square[None], (255, 255, 255), 1.0)  # behind the camera
    pen.lines([([-square], (255, 255, 255), 1)])
    np.testing.assert_array_equal(image, before)


@pytest.mark.parametrize("height", [180, 360, 720])
def test_lines_take_the_same_share_of_films_of_every_size(height: int) -> None:
    image = np.full((height, 16 * height // 9, 3), 128, np.uint8)
    pen = Pen(
        image,
        Perspective(width=image.shape[1], height=height, fovy_deg=40),
        np.eye(4),
        height / DRAWN_FOR,
    )
    pen.lines([([np.array([[-1.0, 0, 2], [1.0, 0, 2]])], (255, 0, 0), 2)])
    drawn = np.count_nonzero(
        np.abs(image[:, image.shape[1] // 2].astype(int) - 128).max(axis=1) > 30
    )
    assert 0.5 < drawn / height * DRAWN_FOR / 4 < 1.6  # with a dark edge at 360 px and more


@pytest.mark.parametrize("name", ["omni_ibvs", "quadrotor_hover"])
def test_the_ghost_stands_at_the_goal_pose(name: str) -> None:
    s = vs.load(name)
    replay = replay_of(s, DRAFT)
    try:
        frame, other = at_the_start(s), replay_of(s, DRAFT)
        goal = frame.T_world_target @ inverse(s.goal_poses[0])
        picture = Outside(s, replay, "overview", SIZE).picture(frame, goal)
        lens, T = replay.sight("overview")
        body = transform(goal @ inverse(frame.T_world_camera), replay.body()).reshape(-1, 3)
        uv = lens.project(transform(inverse(T), body))
        green = np.abs(picture.astype(int) - GOAL).max(axis=2) < 40
        rows, columns = np.nonzero(green)
        low, high = uv.min(axis=0), uv.max(axis=0)
        inside = (
            (columns > low[0] - 2)
            & (columns < high[0] + 2)
            & (rows > low[1] - 2)
            & (rows < high[1] + 2)
        )
        assert inside.sum() > 40  # the outline
        assert [columns[inside].min(), rows[inside].min()] == pytest.approx(low, abs=3)
        assert [columns[inside].max(), rows[inside].max()] == pytest.approx(high, abs=3)
        other.close()
    finally:
        replay.close()


@pytest.mark.opengl
def test_a_part_that_is_drawn_again_fits_into_the_picture() -> None:
    s = vs.load("arm_ibvs")
    replay, other = replay_of(s, DRAFT), replay_of(s, DRAFT)
    try:
        frame = at_the_start(s)
        at_start = frame.state._replace(t=0.0)
        moved = at_start._replace(q=frame.q + 0.02)
        first = replay.picture("overview", SIZE, at_start)
        replay._views["overview"][0]._view = lambda: pytest.fail("the whole picture was drawn")
        # at the same time the camera keeps its place
        second = replay.picture("overview", SIZE, moved)
        other.picture("overview", SIZE, at_start)
        other._views.clear()
        whole = other.picture("overview", SIZE, moved)
        assert (np.abs(first.astype(int) - whole).max(axis=2) > 12).sum() > 50  # the arm has moved
        # half a pixel at most along an edge
        assert (np.abs(second.astype(int) - whole).max(axis=2) > 12).sum() < 5
    finally:
        replay.close()
        other.close()


def test_an_inset_alone_is_drawn_at_its_own_size_unless_the_film_is_fine() -> None:
    s = vs.load("arm_ibvs")
    frame, sizes = at_the_start(s), []
    for quality, inset_in in ((DRAFT, None), (DRAFT, DRAFT.size), (FINE, FINE.size)):
        replay = replay_of(s, quality, inset_in)
        try:
            sizes.append(replay.picture("eye", SIZE, frame.state).shape[1::-1])
        finally:
            replay.close()
    assert sizes == [(640, 480), (round(0.26 * 640), round(0.26 * 640 * 480 / 640)), (640, 480)]


def test_a_trail_has_a_bounded_number_of_points_from_the_first_to_the_last() -> None:
    s = vs.load("ibvs_book")
    replay = replay_of(s, DRAFT)
    try:
        outside, frame = Outside(s, replay, "overview", SIZE), at_the_start(s)
        outside.picture(frame, None)
        pen = Pen(np.zeros((180, 320, 3), np.uint8), *replay.sight("overview"), 1)
        spacing = outside._spacing
        for k in range(3 * MOST_PLACES):
            outside._extend(pen, frame.T_world_camera[:3, 3] + [1.1 * spacing * (k + 1), 0, 0])
            assert len(outside._trail) <= MOST_PLACES
        np.testing.assert_array_equal(outside._trail[0], frame.T_world_camera[:3, 3])
        end = frame.T_world_camera[0, 3] + 1.1 * spacing * 3 * MOST_PLACES
        # the newest point is where the camera is, to one spacing
        assert end - outside._trail[-1, 0] <= outside._spacing + 1e-9
        assert np.diff(outside._trail[:, 0]).max() < 3 * outside._spacing  # no gaps
    finally:
        replay.close()


def test_the_inset_shows_the_servo_cameras_picture_and_leaves_it_as_it_is() -> None:
    s = vs.load("arm_ibvs")
    replay = replay_of(s, DRAFT)
    try:
        frame = at_the_start(s, grey=77)
        picture = Pictures(s, "overview", replay, SIZE).picture(frame)
        width, height = round(0.26 * SIZE[0]), round(0.26 * SIZE[0] * 480 / 640)
        assert (picture[2 : height - 2, SIZE[0] - width + 2 : -2] == 77).all()
        # nothing is drawn below
        assert (picture[height + 4 : height + 8, SIZE[0] - width :] != 77).any(axis=2).all()
        assert frame.image is not None
        assert (frame.image == 77).all()
    finally:
        replay.close()


ERRORS: list[tuple[str, dict[str, float], str]] = [
    ("arm_ibvs", {"error_px": 12.344}, "error 12.34 px"),
    ("quadrotor_hover", {"error_px": 50.0, "level_error_px": 3.5}, "error 3.50 px"),
    (
        "car_pbvs",
        {"error_px": 9.0, "est_position_m": 0.25, "est_rotation_rad": 0.0},
        "error 0.250 m",
    ),
    (
        "car_pbvs",
        {"error_px": 9.0, "est_position_m": 0.01, "est_rotation_rad": math.pi / 2},
        "error 90.00 deg",
    ),
    ("omni_line", {"error_px": 9.0, "task_error_m": -0.031}, "error 0.031 m"),
    ("quadrotor_land", {"error_px": 9.0, "task_error_m": 0.1, "touch_mps": 0.4}, "error 0.400 m/s"),
    (
        "quadrotor_land",
        {"error_px": 9.0, "task_error_m": 0.1, "touch_mps": math.nan},
        "error 0.100 m",
    ),
    ("arm_ibvs", {"error_px": math.nan}, "error \u2013"),
]


@pytest.mark.parametrize(("name", "values", "words"), ERRORS)
def test_the_error_is_the_one_that_is_judged_in_its_own_unit(
    name: str, values: dict[str, float], words: str
) -> None:
    assert error_in_words(vs.load(name), values) == words


def goal_in_film(name: str, t: float, view: int = 0) -> Array | None:
    s = vs.load(name)
    return s.goal_pose_at(t, view)


def test_tasks_say_which_goal_pose_is_shown() -> None:
    s, via = vs.load("quadrotor_path"), vs.load("omni_via_points")
    np.testing.assert_allclose(goal_in_film("quadrotor_path", 0.0), s.goal_poses[0])
    np.testing.assert_allclose(goal_in_film("quadrotor_path", 1e3), s.goal_poses[-1])
    np.testing.assert_array_equal(goal_in_film("omni_via_points", 5.0, 2), via.goal_poses[2])
    assert goal_in_film("omni_line", 5.0) is None  # any place along the line
    pad = goal_in_film("quadrotor_land", 5.0)
    assert pad is not None
    # the craft stands on its legs, the camera at its centre
    np.testing.assert_allclose(pad[:3, 3], [0, 0, 0.172], atol=1e-12)


@pytest.mark.parametrize(
    ("outcome", "colour"),
    [(Outcome.converged, (24, 122, 62)), (Outcome.target_lost, (200, 30, 45))],
)
def test_a_film_ends_with_the_outcome_for_a_second(
    tmp_path: Path, outcome: Outcome, colour: tuple[int, int, int]
) -> None:
    s = vs.load("arm_ibvs")
    replay = replay_of(s, DRAFT)
    try:
        film = Film(s, "eye", tmp_path / "a.mp4", replay, DRAFT, (320, 240))
        film.show(at_the_start(s))
        shown = film.frames
        film.end(outcome, "a reason")
        film.close()
    finally:
        replay.close()
    with av.open(str(tmp_path / "a.mp4")) as container:
        stream = container.streams.video[0]
        rate = float(stream.average_rate or 0)
        last = [
            f.reformat(format="rgb24", src_colorspace="ITU709").to_ndarray()
            for f in container.decode(video=0)
        ]
    assert len(last) - shown == pytest.approx(rate, abs=1)  # one second
    strip = strip_height(240)
    band = last[-1][-strip + 4 : -4, 300:].astype(int)
    np.testing.assert_allclose(band.reshape(-1, 3).mean(axis=0), colour, atol=30)
    # not before
    assert np.abs(last[0][-strip + 4 : -4, 300:].astype(int) - colour).max(axis=2).min() > 20
    assert last[-1][-strip:, 60:150].max() > 200  # the words
    changed = np.abs(last[-1][: 240 - strip].astype(int) - last[0][: 240 - strip]).max()
    # the picture above is as it was, but for its coding
    assert last[-1].shape == (240, 320, 3) and changed < 25


@pytest.mark.parametrize(("width", "height"), [(320, 180), (640, 360), (1280, 720)])
def test_the_ending_stands_below_the_picture_right_of_the_time(width: int, height: int) -> None:
    strip = strip_height(height)
    image = np.zeros((height + strip, width, 3), np.uint8)
    draw_ending(image, strip, "Converged", "RMS error under 0.2 px for 0.5 s", GOOD)
    assert not image[:height].any() and not image[height:, : 4 * text_size(height)].any()
    assert (image[height:] == GOOD).all(axis=2).mean() > 0.5
    assert (image[height:] > 200).all(axis=2).sum() > 100  # with words on it
