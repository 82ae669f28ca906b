"""Which frames a film shows, how large it is, and that it keeps real time."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest

import vstestbed as vs
from vstestbed.report.video.film import DRAFT, FINE, RAYS, Film, Pace, quality_of
from vstestbed.report.video.overlay import FilmFrame


@pytest.mark.parametrize(
    ("rate_hz", "every"), [(5, 1), (10, 1), (15, 1), (25, 2), (30, 2), (50, 4), (100, 7)]
)
def test_drafts_have_at_most_15_pictures_a_second_and_fine_films_every_frame(
    rate_hz: float, every: int
):
    assert (DRAFT.every(rate_hz), FINE.every(rate_hz)) == (every, 1)
    assert 7.5 < rate_hz / every <= 15 or every == 1


def test_the_servo_film_is_scaled_down_to_a_limit():
    assert [DRAFT.share(*size) for size in ((640, 480), (1280, 1024), (1280, 2560))] == [
        1.0,
        1.0,
        0.5,
    ]
    assert FINE.share(2560, 2560) == 1.0


def test_frames_are_due_by_their_time_whatever_is_missing():
    pace = Pace(25.0, 2)
    numbers = [k for k in (0, 1, 2, 3, 7, 8, 9, 30, 31, 32) if pace.due(1.0 + k / 25)]
    assert numbers == [0, 2, 7, 8, 30, 32]
    assert [pace.place(1.0 + k / 25) for k in (0, 1, 2, 31)] == [0, 0, 1, 15]


class NoReplay:
    """Draws grey pictures."""

    def picture(self, camera: str, size: tuple[int, int], *_: object) -> np.ndarray:
        return np.full((*size[::-1], 3), 100, np.uint8)


def test_a_film_keeps_real_time_where_pictures_stayed_away(tmp_path: Path):
    scenario = vs.load("arm_ibvs")
    film = Film(scenario, "side", tmp_path / "a.mp4", NoReplay(), DRAFT, (64, 36))  # type: ignore[arg-type] - it draws nothing
    pose, uv = np.eye(4), np.full((4, 2), 20.0)
    for k in (0, 2, 4, 80, 82):  # three seconds without a picture
        film.show(
            FilmFrame(
                k / 25,
                pose,
                pose,
                np.zeros(6),
                uv,
                1.0,
                False,
                uv,
                np.zeros(len(scenario.own_columns)),
            )
        )
    film.close()
    with av.open(str(tmp_path / "a.mp4")) as container:
        assert float(container.streams.video[0].average_rate or 0) == 12.5
        assert sum(1 for _ in container.decode(video=0)) == 42  # 82 / 2 + 1


def test_rays_make_small_films_and_say_so(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    from vstestbed.report.video import film as quality

    quality._warn_once.cache_clear()
    assert quality_of(vs.load("arm_ibvs", {"camera.renderer": "gl"})) is DRAFT
    assert caplog.text == ""
    rays = vs.load("arm_ibvs", {"camera.renderer": "rays"})
    assert [quality_of(rays), quality_of(rays), quality_of(rays, fine=True)] == [RAYS, RAYS, FINE]
    assert [r.getMessage() for r in caplog.records] == [
        "films by rays are small, 320 x 180 from outside with 5 pictures a second;"
        " --fine makes large ones, which takes long"
    ]
    monkeypatch.setenv("MUJOCO_GL", "disable")
    assert quality_of(vs.load("arm_ibvs")) is RAYS
