"""A rolling shutter: each marker where it was when its row was exposed, by pictures, by the oracle,
and by the weights of the rows.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.camera import Perspective, Picture, Regions
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import Array, exp, inverse, transform
from vstestbed.imaging.shutter import of_rows
from vstestbed.loop.shutter import RowViews
from vstestbed.sim.base import Plant, Truth
from vstestbed.sim.build import PictureSetup, build_plant
from vstestbed.timing.plan import Shutter, Timing
from vstestbed.vision.base import TruthView

READOUT = 0.03
LENSES: dict[str, dict[str, Any]] = {
    "perspective": {"camera.fovy_deg": 60},
    "distorted": {"camera.fovy_deg": 60, "camera.distortion": [-0.2, 0.05, 0, 0, 0]},
    "fisheye": {"camera.kind": "fisheye", "camera.fov_deg": 120},
    "panels": {"camera.kind": "spherical", "camera.face_px": 256},
}
TURN, TILT, SLIDE = [0, 0, 0, 0, 0.8, 0], [0, 0, 0, 0.8, 0, 0], [0.5, 0.3, 0, 0, 0, 0]
ROLL, SPIN = [0, 0, 0, 0, 0, 2.0], [0, 0, 0, 0, 0, 4.0]


def scene(lens: str, renderer: str, readout_s: float, **settings: Any) -> vs.Scenario:
    """A free camera in front of a square of four markers, which is in the upper and in the lower
    half of the picture.
    """
    own = dict(LENSES[lens])
    camera = {
        "kind": own.pop("camera.kind", "perspective"),
        "width": 400,
        "height": 400,
        "rate_hz": 25,
        "multisampling": 16,
    }
    distance, radius = (0.75, 0.02) if camera["kind"] == "perspective" else (0.5, 0.03)
    near = {
        "robot.start": {"nominal": {"xyz": [0.03, 0.02, 3 - distance], "rpy_deg": [0, 0, 10]}},
        "target.marker.radius": radius,
    }
    return vs.load(
        "ibvs_book",
        {"camera": camera | {"renderer": renderer, "readout_s": readout_s}} | own | near | settings,
    )


def plant_of(s: vs.Scenario) -> Plant:
    return build_plant(s.scene, PictureSetup(needs_image=True, needs_truth=False))[0]


def taken(
    s: vs.Scenario, twist: list[float], regions: Regions | None = None
) -> tuple[Picture, Truth]:
    """The second picture of a camera with a constant twist, and the truth at its time stamp."""
    plant, truth, step = plant_of(s), None, 0
    plant.apply(np.array(twist, float))
    shutter = Shutter(s.timing, s.camera, plant.step_s, np.random.default_rng(0))
    shutter.following()
    plan = shutter.following()
    for at, weight in zip(plan.opens, plan.weights, strict=True):
        plant.advance(at - step)
        step = at
        truth = plant.truth() if at == plan.middle else truth
        plant.expose(weight, regions)
    picture = plant.developed(plan.middle * plant.step_s)
    assert picture is not None and truth is not None
    picture = picture.copy()
    plant.close()
    return picture, truth


def theory(s: vs.Scenario, truth: Truth, twist: list[float]) -> tuple[Array, Array]:
    """Places (N, 2) [px] of the markers in the picture by the rows in which they are, t = d(v(t)),
    and at the time stamp.
    """
    panel, camera, ends = (
        s.camera.panels[0],
        s.camera,
        s.camera.row_delay(np.array([-0.5, s.camera.height - 0.5])),
    )

    def seen(point: Array, t: float) -> Array:
        return transform(
            inverse(truth.T_world_camera @ exp(np.array(twist, float) * t)), point[None]
        )

    places = []
    for point in transform(truth.T_world_target, s.target.points):

        def late(t: float, point: Array = point) -> float:
            return t - float(camera.row_delay(camera.project(seen(point, t))[0, 1]))

        t: Any = brentq(late, *ends) if camera.readout_s else 0.0
        places.append(
            [panel.lens.project(seen(point, at) @ panel.R_camera_panel)[0] for at in (t, 0.0)]
        )
    by_rows, at_once = np.swapaxes(np.array(places), 0, 1)
    return by_rows, at_once


def centroids(picture: Picture, near: Array) -> Array:
    """Centroids (N, 2) [px] of the markers' colour: of what is not the board's grey, near places
    (N, 2).
    """
    image, found = picture.images[0], []
    assert image is not None
    for u, v in np.round(near).astype(int):
        part = image[v - 12 : v + 13, u - 12 : u + 13].astype(float)
        colour, (vv, uu) = (
            part.max(axis=2) - part.min(axis=2),
            np.mgrid[v - 12 : v + 13, u - 12 : u + 13],
        )
        found.append([(colour * uu).sum() / colour.sum(), (colour * vv).sum() / colour.sum()])
    return np.array(found)


CASES = [(lens, "gl", twist) for lens in LENSES for twist in (TURN, SLIDE) if lens != "panels"] + [
    ("perspective", "gl", ROLL),
    ("perspective", "gl", TILT),
    ("perspective", "rays", TURN),
    ("panels", "gl", SPIN),
    ("panels", "rays", SPIN),
]


@pytest.mark.parametrize(("lens", "renderer", "twist"), one_quick(*CASES, every=3))
def test_each_row_is_of_its_own_time(lens: str, renderer: str, twist: list[float]):
    s, still = scene(lens, renderer, READOUT), scene(lens, renderer, 0.0)
    regions = None if len(s.camera.panels) == 1 else (((0, 0, 256, 256),), *((),) * 5)
    (rolled, truth), (sharp, same) = (taken(one, twist, regions) for one in (s, still))
    np.testing.assert_allclose(truth.T_world_camera, same.T_world_camera, atol=1e-12)
    by_rows, at_once = theory(s, truth, twist)
    # A disc's centroid is not the image of its centre: that is the same in both pictures, and not
    # in their difference.
    skew = centroids(rolled, by_rows) - centroids(sharp, at_once)
    assert np.abs(by_rows - at_once).max() > (0.6 if regions else 0.8)
    np.testing.assert_allclose(skew, by_rows - at_once, atol=0.1)


@pytest.mark.parametrize(
    ("lens", "renderer"),
    [*((lens, "gl") for lens in LENSES), ("perspective", "rays"), ("fisheye", "rays")],
)
def test_what_rests_is_the_same_picture(lens: str, renderer: str):
    small = {"camera.width": 80, "camera.height": 60} | (
        {"camera.face_px": 64} if lens == "panels" else {}
    )
    still, rolled = (
        taken(scene(lens, renderer, readout_s, **small), [0.0] * 6)[0]
        for readout_s in (0.0, READOUT)
    )
    for a, b in zip(still.images, rolled.images, strict=True):
        assert a is not None and b is not None
        # A band drawn alone may differ in a sample at an edge, see `PartCamera`.
        assert (a != b).mean() <= (2e-3 if renderer == "gl" and lens != "panels" else 0)
    assert rolled.whole


def test_a_rows_exposure_smears_by_its_own_length():
    speed, exposure_s = 1.0, 0.01
    s = scene(
        "perspective",
        "gl",
        0.02,
        **{"timing.exposure_s": exposure_s, "robot.start.nominal": {"xyz": [0, 0, 2.3]}},
    )
    variances = []
    for twist in ([0.0] * 6, [speed, 0, 0, 0, 0, 0]):
        picture, truth = taken(s, twist)
        u, v = np.round(theory(s, truth, twist)[0][0]).astype(int)
        assert picture.image is not None
        part = picture.image[v - 14 : v + 15, u - 20 : u + 21].astype(float)
        light, at = (part.max(axis=2) - part.min(axis=2)).sum(axis=0), np.arange(41)
        mean = (light * at).sum() / light.sum()
        variances.append((light * (at - mean) ** 2).sum() / light.sum())
    assert isinstance(s.camera, Perspective)
    length = np.sqrt(12 * (variances[1] - variances[0]))
    # with the skew within the disc
    assert length == pytest.approx(s.camera.f * speed * exposure_s / 0.7, rel=0.06)


class TestWeights:
    NODES = np.array([-16, -12, -10, -4, 0, 4, 10, 12, 16]) * 1e-3

    @pytest.mark.parametrize("exposure_s", [0.0, 1e-4, 0.003, 0.012])
    def test_they_are_the_integrals_of_triangles(self, exposure_s: float):
        middles = np.linspace(-0.01, 0.01, 41)
        weights, light = of_rows(self.NODES, middles, exposure_s)
        np.testing.assert_allclose(weights, light, atol=1e-12)
        np.testing.assert_allclose(weights.sum(axis=0), 1)
        for k, row in ((0, 0), (2, 5), (4, 20), (7, 38)):
            hat = np.eye(len(self.NODES))[k]
            low, high = middles[row] - exposure_s / 2, middles[row] + exposure_s / 2
            breaks = [node for node in self.NODES if low < node < high]
            value = quad(np.interp, low, high, args=(self.NODES, hat), points=breaks or None)[0]
            expected = (
                value / exposure_s if exposure_s else np.interp(middles[row], self.NODES, hat)
            )
            assert weights[k, row] == pytest.approx(expected, abs=1e-9)

    def test_a_global_shutter_is_planned_as_ever(self):
        plan = Shutter(
            Timing(), Perspective(rate_hz=25), 0.002, np.random.default_rng(0)
        ).following()
        assert plan.weights == (1.0,)

    def test_the_latency_counts_from_the_last_row(self):
        camera = Perspective(rate_hz=25, latency_s=0.01, readout_s=0.02)
        shutter = Shutter(Timing(exposure_s=0.004), camera, 0.002, np.random.default_rng(0))
        plan = [shutter.following() for _ in range(2)][1]
        assert plan.opens == tuple(range(14, 27)) and plan.arrives == 26 + 5
        assert all(isinstance(weight, tuple) for weight in plan.weights)


class TestOracle:
    def test_markers_are_where_their_rows_saw_them(self):
        s = scene(
            "perspective",
            "gl",
            READOUT,
            detector="oracle",
            **{"stop.duration_s": 0.5, "law.depth": "oracle"},
        )
        frames: list[tuple[Array, Truth]] = []

        class Watch:
            def frame(self, frame: vs.Frame) -> None:
                frames.append((frame.observation.uv.copy(), frame.truth))

        with vs.Session(s, watch=[Watch()]) as session:
            session.reset()
            for _ in range(4):
                session.step(np.array([0.1, 0, 0, 0.3, 0.4, 1.0]))
        uv, truth = frames[3]
        by_rows, at_once = theory(s, truth, list(truth.twist))
        assert np.abs(by_rows - at_once).max() > 1
        # between two steps of the physics the path is taken to be straight
        np.testing.assert_allclose(uv, by_rows, atol=2e-3)

    def test_a_marker_beyond_the_picture_or_behind_it(self):
        camera, times = Perspective(readout_s=0.02), np.linspace(-0.012, 0.012, 13)
        views = RowViews(camera, times)
        for t in times:
            views.add(
                TruthView(
                    np.array([[0.0, 5.0, 1.0 + t], [0.0, 0.1, -1.0 - t], [t, 0.0, 1.0]]),
                    np.array([t > 0, False, t > 0.001]),
                )
            )
        seen = views.taken()
        assert (
            seen.p_camera[0, 2] == pytest.approx(1 + camera.row_delay(np.array(479.0)))
            and seen.hidden[0]
        )
        np.testing.assert_allclose(seen.p_camera[1:], [[0, 0.1, -1], [0, 0, 1]], atol=1e-12)
        assert not seen.hidden[1:].any()

    def test_a_global_shutter_logs_the_same(self):
        settings = {"detector": "oracle", "law.depth": "oracle", "stop.duration_s": 1.0}
        a, b = (
            vs.run(vs.load("ibvs_book", settings | own)) for own in ({}, {"camera.readout_s": 0.0})
        )
        np.testing.assert_array_equal(a.table, b.table)


def test_a_part_is_completed_as_the_whole():
    wholes = []
    for regions in (None, (((60, 60, 120, 120),),)):
        plant = plant_of(scene("perspective", "gl", READOUT))
        plant.apply(np.array([0, 0, 0, 0, 0.8, 1.0]))
        shutter = Shutter(
            Timing(),
            scene("perspective", "gl", READOUT).camera,
            plant.step_s,
            np.random.default_rng(0),
        )
        plan = [shutter.following() for _ in range(2)][1]
        step = 0
        for at, weight in zip(plan.opens, plan.weights, strict=True):
            plant.advance(at - step)
            step = at
            plant.expose(weight, regions)
        picture = plant.developed(0.04)
        assert picture is not None and picture.whole == (regions is None)
        wholes.append(picture.completed().images[0])
        plant.close()
    np.testing.assert_array_equal(*wholes)


def test_blobs_in_the_pictures_of_a_run_are_where_the_oracle_sees_the_markers():
    found: dict[str, Array] = {}
    for detector in ("blobs", "oracle"):
        s = scene(
            "perspective",
            "gl",
            READOUT,
            **{"detector": detector, "law.depth": "pnp", "stop.duration_s": 0.5},
        )
        with vs.Session(s) as session:
            session.reset()
            for _ in range(3):
                frame = session.step(np.array([0.05, 0.1, 0, 0, 0, 1.0]))
        found[detector] = frame.observation.uv
    # pixels' own error beside what the row's time changes
    np.testing.assert_allclose(found["blobs"], found["oracle"], atol=0.3)


def test_what_does_not_fit_into_a_period_is_refused():
    for settings, words in (
        ({"camera.readout_s": 0.041}, "readout_s: must be at most 0.04 s"),
        (
            {"camera.readout_s": 0.03, "timing.exposure_s": 0.012},
            r"at most 0.028 s: readout and timing.exposure_s, 0.012 s, must fit",
        ),
        ({"camera.readout_s": 0.02, "timing.exposure_jitter_s": 0.011}, "at most 0.01 s"),
        ({"camera.readout_s": -0.01}, "readout_s"),
    ):
        with pytest.raises((ParameterError, ScenarioError), match=words):
            vs.load("ibvs_book", {"camera.rate_hz": 25} | settings)


def test_a_short_exposure_is_for_a_rolling_shutter_alone():
    settings = {"camera.rate_hz": 25, "timing.exposure_s": 0.0005}
    assert vs.load("ibvs_book", settings | {"camera.readout_s": 0.02}).timing.exposure_s == 0.0005
    with pytest.raises((ParameterError, ScenarioError), match="two physics steps"):
        vs.load("ibvs_book", settings)
