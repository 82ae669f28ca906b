"""What every detector must do."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Picture
from vstestbed.core.errors import ParameterError
from vstestbed.loop.run import run, uninterrupted
from vstestbed.scenario.load import load
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.base import Truth
from vstestbed.sim.build import build_plant
from vstestbed.vision import Detector, TruthView

SCENES: dict[str, tuple[str, dict[str, object]]] = {
    "disc": ("ibvs_book", {}),
    "tag": ("arm_tags", {}),
    "stripe": ("omni_line", {}),
    "sphere": ("car_parking", {}),
    "outline": ("arm_region", {}),
}
"""A bundled scenario with each kind of marker in the picture at its start."""
MARGIN_PX = 10.0
"""A marker that must be found is this far inside the picture [px]."""


def check_detector(detector: Detector[Any], scenario: Scenario | None = None, within_px: float = 0.5) -> None:
    """A detector finds all markers of a rendered picture, at their places; none in an empty one; and its memory is passed.

    Args:
        detector: with the parameters to test.
        scenario: whose start shows all markers; None: a bundled one with a marker that it sees.
        within_px: largest distance from the true image of a marker's centre [px].

    Raises:
        AssertionError: it says what was expected and what was found.
    """
    if detector.changing:
        _check_own_points(detector, scenario or load("camera_keypoints"), within_px)
        return
    s = replace(scenario or _scene(detector), detector=detector)
    plant, _ = build_plant(
        s.robot, s.camera, s.target, s.world, s.physics, needs_image=detector.needs_image, needs_truth=detector.needs_truth
    )
    with closing(plant):
        picture, truth = plant.capture()
    view = TruthView(truth.p_camera, truth.hidden) if detector.needs_truth else None
    true, memory, rng = s.camera.project(truth.p_camera), detector.init(), np.random.default_rng(0)
    undrawn = rng.bit_generator.state
    shown = _shown(s, truth)
    for turn in ("from the whole picture", "beside the last one"):  # the second time it may look in windows
        memory, detection = detector.detect(memory, picture, view, s.camera, s.target, rng)
        assert detection.uv.shape == true.shape, f"{detector.kind}: uv must have shape {true.shape}, got {detection.uv.shape}"
        error = np.linalg.norm(detection.uv - true, axis=1)[shown]
        assert (error < within_px).all(), f"{detector.kind} {turn}: every marker must be within {within_px:g} px, off by {error.round(3)}"
    drew = rng.bit_generator.state != undrawn
    assert drew is detector.draws, (
        f"{detector.kind}: `draws` is {detector.draws}, and detect() {'draws' if drew else 'does not draw'} from rng"
    )
    if detector.needs_image and picture is not None:
        _check_nothing(detector, s, picture)


def _shown(s: Scenario, truth: Truth) -> NDArray[np.bool_]:
    """The markers that are wholly in the picture, (N,)."""
    shown = s.camera.whole(truth.p_camera, s.target.marker.radius, MARGIN_PX) & ~truth.hidden
    assert shown.any(), f"{s.name or 'the scenario'} must show markers at its start"
    return shown


def _check_own_points(detector: Detector[Any], scenario: Scenario, within_px: float) -> None:
    """The points of a detector of its own points are where the scene has those of the goal's picture, and many enough."""
    s = replace(scenario, detector=detector, stop=replace(scenario.stop, duration_s=scenario.camera.period))
    log = uninterrupted(run(s))
    uv, true = (np.stack([[log[f"{axis}{at}_{i}"] for i in range(s.rows)] for axis in "uv"], axis=-1) for at in ("", "_true"))
    error = np.linalg.norm(uv - true, axis=-1)
    seen = np.isfinite(error).sum(axis=0)
    assert seen.min() >= 3, f"{detector.kind}: must find three points or more in every picture, found {seen.tolist()}"
    median = np.nanmedian(error)
    assert median < within_px, f"{detector.kind}: points must be within {within_px:g} px, their median is off by {median:.3f}"


def _scene(detector: Detector[Any]) -> Scenario:
    """The bundled scenario whose start shows markers that the detector sees."""
    if detector.needs_sheet:
        return load("arm_patch")
    marker = detector.markers[0] if detector.markers else "disc"
    assert marker in SCENES, f"{detector.kind}: give a scenario whose start shows markers of kind {marker}"
    return load(*SCENES[marker])


def _check_nothing(detector: Detector[Any], s: Scenario, picture: Picture) -> None:
    """An empty picture has no markers; no picture at all is a mistake."""
    empty = replace(picture, images=tuple(None if image is None else np.full_like(image, 128) for image in picture.images))
    _, detection = detector.detect(detector.init(), empty, None, s.camera, s.target, np.random.default_rng(0))
    assert np.isnan(detection.uv).all(), f"{detector.kind}: an empty picture has no markers, it found {detection.uv}"
    try:
        detector.detect(detector.init(), None, None, s.camera, s.target, np.random.default_rng(0))
    except ParameterError:
        return
    raise AssertionError(f"{detector.kind}: without a picture detect must raise ParameterError")
