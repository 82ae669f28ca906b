"""Pictures of which a part was drawn, and the whole ones of the same exposures,
drawn afterwards.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.camera import Picture, Regions
from vstestbed.loop.controller import Controller
from vstestbed.sim.base import Plant
from vstestbed.sim.build import PictureSetup, build_plant

LOOK: Regions = (((140, 60, 200, 100),),)
PUSH = np.array([0.6, -0.4, 0.5, 0.7, -0.6, 0.8])
"""Joint speeds that move the arm's camera by many pixels within an exposure [rad/s]."""
SMALL = {"camera.width": 320, "camera.height": 240}


def plants(
    scenario: str, renderer: str, sigma: float = 0.0, settings: dict[str, object] | None = None
) -> Plant:
    s = vs.load(scenario, {"camera.renderer": renderer, **(settings or {})})
    rng = np.random.default_rng(3)
    pictures = PictureSetup(
        needs_image=True, needs_truth=False, image_sigma=sigma, rng=rng, drift=s.noise.drift
    )
    return build_plant(s.scene, pictures)[0]


@pytest.fixture(params=["gl", "rays"])
def two(request: pytest.FixtureRequest) -> Iterator[tuple[Plant, Plant]]:
    """Two plants of one kind: one whose pictures are completed, one whose pictures are whole at
    once.
    """
    pair = tuple(
        plants("arm_ibvs", request.param, 2.0 if request.param == "rays" else 0.0, SMALL)
        for _ in range(2)
    )
    yield pair
    for plant in pair:
        plant.close()


def same(a: Picture | None, b: Picture | None) -> None:
    assert a is not None and b is not None and a.t == b.t and a.whole and b.whole
    assert np.ptp(np.asarray(a.images[0])) > 100  # there is something to see
    np.testing.assert_array_equal(a.images[0], b.images[0])


def exposed(plant: Plant, regions: Regions | None) -> Picture:
    """A picture of three images, 10 ms apart."""
    for weight in (0.25, 0.5, 0.25):
        plant.expose(weight, regions)
        plant.advance(5)
    picture = plant.developed(0.01)
    assert picture is not None
    return picture.copy()


def test_the_whole_of_an_instant_is_drawn_when_it_has_long_passed(two: tuple[Plant, Plant]):
    late, at_once = two
    for plant in two:
        plant.apply(PUSH)
        plant.advance(20)
    part, whole = late.capture(LOOK)[0], at_once.capture()[0]
    assert part is not None and not part.whole and part.image is None and whole is not None
    part, whole = part.copy(), whole.copy()
    for plant in two:
        plant.advance(30)
    later = late.capture()[0]
    assert later is not None and not np.array_equal(later.images[0], whole.images[0])
    same(part.completed(), whole)
    # The scene is back where it was, and goes on as if nothing had been drawn.
    at_once.capture()
    for plant in two:
        plant.advance(30)
    same(*(plant.capture()[0] for plant in two))


def test_the_whole_of_an_exposure_has_its_motion_blur(two: tuple[Plant, Plant]):
    late, at_once = two
    for plant in two:
        plant.apply(PUSH)
        plant.advance(20)
    part, whole = exposed(late, LOOK), exposed(at_once, None)
    assert not part.whole
    late.expose(1.0)  # the next exposure has begun
    at_once.expose(1.0)
    same(part.completed(), whole)
    same(late.developed(0.1), at_once.developed(0.1))
    for a, b in zip(late.truth().q, at_once.truth().q, strict=True):
        assert a == b


def test_panels_that_were_left_out_are_drawn_with_their_own_noise():
    late, at_once = (plants("quadrotor_hover", "gl", sigma=3.0) for _ in range(2))
    regions = tuple(((1, 1, 9, 9),) if i == 1 else () for i in range(6))
    part, whole = late.capture(regions)[0], at_once.capture()[0]
    assert (
        part is not None
        and whole is not None
        and [image is None for image in part.images].count(True) == 5
    )
    for a, b in zip(part.completed().images, whole.images, strict=True):
        np.testing.assert_array_equal(a, b)
    late.close()
    at_once.close()


def test_a_whole_picture_is_itself():
    picture = Picture(0.0, (np.zeros((2, 2, 3), np.uint8),))
    assert picture.completed() is picture


def test_drawing_every_picture_again_changes_nothing_of_a_run(monkeypatch: pytest.MonkeyPatch):
    # Wheels with rollers: contacts, whose forces are warm-started from the step before.
    s = vs.load("omni_ibvs", {"stop.duration_s": 0.6, "camera.latency_s": 0.03})
    plain, arrive, again = vs.run(s), Controller.arrive, []

    def drawn_again(self: Controller, shot: object, *rest: object) -> object:
        again.append(shot.picture.completed() is not shot.picture)
        return arrive(self, shot, *rest)

    monkeypatch.setattr(Controller, "arrive", drawn_again)
    watched = vs.run(s)
    assert sum(again) > 10
    np.testing.assert_array_equal(plain.table, watched.table)
