"""What every lens, detector, kind of local features, perturbation, metric and monitor must do."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vstestbed.camera import Camera, Image, Picture
from vstestbed.core.geometry import Array, Pose, exp
from vstestbed.effects import EFFECTS, Effect
from vstestbed.endings.monitors import MONITORS, MonitorContract
from vstestbed.loop.log_file import Log
from vstestbed.loop.session import run, uninterrupted
from vstestbed.robots import Free
from vstestbed.robots.free import FreeStart
from vstestbed.scenario.load import load
from vstestbed.scenario.noise import Noise
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.base import Truth
from vstestbed.sim.build import PictureSetup, build_plant
from vstestbed.targets import Square
from vstestbed.targets.markers import Disc
from vstestbed.tasks.metrics import METRICS, MetricContract, check_metrics
from vstestbed.testing.laws import quick
from vstestbed.testing.robots import check_contract, must_refuse
from vstestbed.vision import Blobs, Detector, TruthView
from vstestbed.vision.local_features import extracted, matched, mutual_matches
from vstestbed.vision.perturb import PERTURBATIONS, PerturbationBase, Perturbed

SCENES: dict[str, tuple[str, dict[str, object]]] = {
    "disc": ("ibvs_book", {}),
    "tag": ("arm_tags", {}),
    "stripe": ("omni_line", {}),
    "sphere": ("car_parking", {}),
    "outline": ("arm_region", {}),
}
"""A bundled scenario with each kind of marker in the picture at its start."""
MARGIN_PX = 10.0  # a marker that must be found is this far inside the picture [px]


def check_detector(
    detector: Detector[Any], scenario: Scenario | None = None, within_px: float = 0.5
) -> None:
    """A detector finds all markers of a rendered picture, at their places; none in an empty one;
    and its state is passed.

    detector: with the parameters to test. scenario: whose start shows all markers; None: a bundled
    one with a marker that it sees.
    within_px: largest distance from the true image of a marker's centre [px].
    """
    if detector.changing:
        _check_own_points(detector, scenario or load("camera_keypoints"), within_px)
        return
    s = replace(scenario or _scene(detector), detector=detector)
    plant, _ = build_plant(s.scene, PictureSetup(detector.needs_image, detector.needs_truth))
    with closing(plant):
        picture, truth = plant.capture()
    _check_markers(detector, s, picture, truth, within_px)
    if detector.needs_image and picture is not None:
        _check_nothing(detector, s, picture)


def _check_markers(
    detector: Detector[Any], s: Scenario, picture: Picture | None, truth: Truth, within_px: float
) -> None:
    """All markers are found at their places, twice, and `draws` is true."""
    view = TruthView(truth.p_camera, truth.hidden) if detector.needs_truth else None
    true = s.camera.project(truth.p_camera)
    shown = s.camera.whole(truth.p_camera, s.target.marker.radius, MARGIN_PX) & ~truth.hidden
    assert shown.any(), f"{s.name or 'the scenario'} must show markers at its start"
    state = detector.init()
    rng = np.random.default_rng(0)
    undrawn = rng.bit_generator.state
    # the second time it may look in windows
    for turn in ("from the whole picture", "beside the last one"):
        state, detection = detector.detect(state, picture, view, s.camera, s.target, rng)
        assert detection.uv.shape == true.shape, (
            f"{detector.kind}: uv must have shape {true.shape}, got {detection.uv.shape}"
        )
        error = np.linalg.norm(detection.uv - true, axis=1)[shown]
        assert (error < within_px).all(), (
            f"{detector.kind} {turn}:"
            f" every marker must be within {within_px:g} px, off by {error.round(3)}"
        )
    drew = rng.bit_generator.state != undrawn
    how = "draws" if drew else "does not draw"
    assert drew is detector.draws, (
        f"{detector.kind}: `draws` is {detector.draws}, and detect() {how} from rng"
    )


def _check_own_points(detector: Detector[Any], scenario: Scenario, within_px: float) -> None:
    """The points of a detector of its own points are where the scene has those of the goal's
    picture, and many enough.
    """
    stop = replace(scenario.stop, duration_s=scenario.camera.period)
    s = replace(scenario, detector=detector, stop=stop)
    log = uninterrupted(run(s))
    off = [[log[f"{axis}_{i}"] - log[f"{axis}_true_{i}"] for i in range(s.rows)] for axis in "uv"]
    error = np.linalg.norm(off, axis=0)
    seen = np.isfinite(error).sum(axis=0)
    assert seen.min() >= 3, (
        f"{detector.kind}: must find three points or more in every picture, found {seen.tolist()}"
    )
    median = np.nanmedian(error)
    assert median < within_px, (
        f"{detector.kind}: points must be within {within_px:g} px,"
        f" their median is off by {median:.3f}"
    )


def _scene(detector: Detector[Any]) -> Scenario:
    if detector.needs_sheet:
        return load("arm_patch")
    marker = detector.markers[0] if detector.markers else "disc"
    assert marker in SCENES, (
        f"{detector.kind}: give a scenario whose start shows markers of kind {marker}"
    )
    return load(*SCENES[marker])


def _check_nothing(detector: Detector[Any], s: Scenario, picture: Picture) -> None:
    """An empty picture has no markers; no picture at all is a mistake."""
    grey = [None if image is None else np.full_like(image, 128) for image in picture.images]

    def detected(given: Picture | None) -> Array:
        rng = np.random.default_rng(0)
        _, detection = detector.detect(detector.init(), given, None, s.camera, s.target, rng)
        return detection.uv

    uv = detected(replace(picture, images=tuple(grey)))
    assert np.isnan(uv).all(), f"{detector.kind}: an empty picture has no markers, it found {uv}"
    words = f"{detector.kind}: without a picture detect must raise ParameterError"
    must_refuse(lambda: detected(None), words)


# What every lens must do.
GRID = 25  # pixels that are tried along each side of the picture
LEAST_SEEN = 0.2  # least share of the picture in which each pixel must have a ray
# largest error of the way to a ray and back [px]: a thousandth of the best measurement
WITHIN_PX = 1e-4
AT_M = 0.6  # distance of the target that is rendered [m]


def check_camera(camera: Camera, seed: int = 0) -> None:
    """`ray` is the inverse of `project`, both take leading axes, and markers are rendered and
    detected where `project` says.
    """
    kind = getattr(camera, "kind", type(camera).__name__)
    assert isinstance(camera, Camera), (
        f"{kind}: a lens must derive from vstestbed.camera.Camera, or Radial"
    )
    uv = _check_pixels(camera, kind)
    # From directions all round to pixels and back: what is seen in the picture is seen where it is,
    # not behind.
    directions = np.random.default_rng(seed).normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    to = camera.project(directions)
    shown = camera.inside(to)
    error = np.linalg.norm(camera.ray(to[shown]) - directions[shown], axis=1)
    wrong = directions[shown][~(error < 1e-6)]
    words = f"project must be NaN where the lens sees nothing; {len(wrong)} directions, one of them"
    assert not len(wrong), (
        f"{kind}: ray(project(p)) must point to p; {words} {wrong[0].round(3)}, come back elsewhere"
    )
    # Four discs, rendered through the lens, are detected where it projects them: off the middle,
    # which a mirror does not see, and away from the border.
    wanted = np.array([0.7 * camera.width, 0.6 * camera.height])
    ray = camera.ray(uv[np.linalg.norm(uv - wanted, axis=1).argmin()][None])[0]
    axis = np.cross([0.0, 0.0, 1.0], ray)  # the target faces the lens: its z axis along the ray
    turn = axis / max(float(np.linalg.norm(axis)), 1e-12) * np.arccos(np.clip(ray[2], -1, 1))
    T = exp(np.concatenate([np.zeros(3), turn]))
    T[:3, 3] = AT_M * ray
    before_lens = replace(
        load("ibvs_book", {"detector": "oracle"}),
        name="a square before the lens",
        robot=Free(start=FreeStart(nominal=Pose())),
        camera=replace(camera, latency_s=0.0),
        target=Square(side=0.16, marker=Disc(radius=0.025, lit=False), pose=Pose.of(T)),
    )
    check_detector(Blobs(), before_lens)


def _check_pixels(camera: Camera, kind: str) -> Array:
    """From pixels to rays and back, whatever the distance; returns the pixels that have a ray."""
    across = np.linspace(0, camera.width - 1, GRID)
    down = np.linspace(0, camera.height - 1, GRID)
    uv = np.stack(np.meshgrid(across, down), axis=-1).reshape(-1, 2)
    rays = camera.ray(uv)
    assert rays.shape == (len(uv), 3), (
        f"{kind}: ray must have shape (N, 3) for uv (N, 2), got {rays.shape}"
    )
    seen = np.isfinite(rays).all(axis=1)
    assert seen.mean() >= LEAST_SEEN, (
        f"{kind}: {seen.mean():.0%} of the picture have a ray, at least {LEAST_SEEN:.0%} must"
    )
    uv = uv[seen]
    rays = rays[seen]
    length = np.abs(np.linalg.norm(rays, axis=1) - 1).max()
    assert length < 1e-9, f"{kind}: rays must be unit vectors, one is {length:.2g} off"
    for distance in (0.01, 1.0, 100.0):
        back = camera.project(distance * rays)
        error = np.linalg.norm(back - uv, axis=1)
        assert (error < WITHIN_PX).all(), (
            f"{kind}: project(ray(uv)) must be uv at {distance:g} m,"
            f" it is {np.max(error):.3g} px off"
        )
    both = camera.project(np.stack([rays, 2 * rays]))
    assert both.shape == (2, len(uv), 2), (
        f"{kind}: project must take leading axes: (2, N, 3) to (2, N, 2), got {both.shape}"
    )
    return uv


# What every kind of local features must do.

# size of the two pictures, and samples along each side of a pixel
WIDTH, HEIGHT, FINER = 320, 240, 2
TURN_DEG, SIZE = 8.0, 0.93  # rotation and scale of the second against the first
SHEETS = 120


def check_keypoints(features: Any, within_px: float = 2.0, least: int = 20) -> None:
    """Features match two pictures of coloured sheets, the second turned by 8 degrees and smaller;
    an empty picture gives no matches.

    features: with the parameters to test; it has `extract(image)` or `match(goal_image, image)`.
    within_px: largest median distance of the matches from their true places [px]. least: fewest
    matches that must be within three times that distance.
    """
    turn = np.radians(TURN_DEG)
    A = SIZE * np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    first = _picture(1.0, 0.0)
    second = _picture(1 / SIZE, -turn)
    uv_goal, uv = _matches(features, first, second)
    middle = np.array([WIDTH - 1, HEIGHT - 1]) / 2
    off = np.linalg.norm(uv - ((uv_goal - middle) @ A.T + middle), axis=1)
    near = off[off < 3 * within_px]
    found = f"found {len(near)} of {len(off)} in place"
    assert len(near) >= least, (
        f"{features.kind}: must match {least} points or more of two pictures, {found}"
    )
    median = np.median(near)
    assert median < within_px, (
        f"{features.kind}: matches must be within {within_px:g} px,"
        f" their median is off by {median:.2f}"
    )
    nothing, _ = _matches(features, first, np.full_like(first, 128))
    assert len(nothing) < least, (
        f"{features.kind}: an empty picture has no points, it matched {len(nothing)}"
    )


@lru_cache
def _picture(size: float, turn: float) -> NDArray[np.uint8]:
    """Sheets over each other (HEIGHT, WIDTH, 3): a place's offset from the middle, turned [rad] and
    times `size`, is that in the first.
    """
    c = size * np.cos(turn)
    s = size * np.sin(turn)
    rng = np.random.default_rng(5)
    u, v = np.meshgrid(
        (np.arange(FINER * WIDTH) + 0.5) / FINER - WIDTH / 2,
        (np.arange(FINER * HEIGHT) + 0.5) / FINER - HEIGHT / 2,
    )
    x = c * u - s * v
    y = s * u + c * v
    image = np.full((*x.shape, 3), 128.0, np.float32)
    for _ in range(SHEETS):
        px, py = rng.uniform(-0.6, 0.6, 2) * [WIDTH, HEIGHT]
        a, b = rng.uniform(5, 25, 2)
        angle = rng.uniform(0, np.pi)
        along = np.cos(angle) * (x - px) + np.sin(angle) * (y - py)
        across = np.cos(angle) * (y - py) - np.sin(angle) * (x - px)
        image[(np.abs(along) < a) & (np.abs(across) < b)] = rng.uniform(0, 255, 3)
    return image.reshape(HEIGHT, FINER, WIDTH, FINER, 3).mean(axis=(1, 3)).astype(np.uint8)


def _matches(
    features: Any, first: NDArray[np.uint8], second: NDArray[np.uint8]
) -> tuple[Array, Array]:
    """Places (M, 2) of matches in both pictures [px]."""
    if hasattr(features, "match"):
        return matched(features, first, second)[:2]
    uv_goal, a = extracted(features, first)
    uv, b = extracted(features, second)
    i, j, _ = mutual_matches(a, b)
    return uv_goal[i], uv[j]


# What every perturbation, metric and outcome monitor must do.
DRAWS = 200  # pictures or measurements of which a perturbation must change one at least
SHORT_S = 0.3


def check_noise(perturbation: PerturbationBase) -> None:
    """A perturbation changes something, returns what it is given in shape and type, and depends on
    its seed alone.
    """
    kind = perturbation.kind
    check_contract(PERTURBATIONS, perturbation)
    assert perturbation.changes, f"{kind}: `changes` must name picture, pixels or both"
    loop = quick("view")
    if "picture" in perturbation.changes:
        loop = load("ibvs_book", {"stop.duration_s": SHORT_S})
        drawn = [_perturbed_picture(perturbation, seed) for seed in (0, 0, 1)]
        _check_draws(kind, "picture", _PICTURE, drawn)
    if "pixels" in perturbation.changes:
        drawn = [_pixels(perturbation, seed) for seed in (0, 0, 1)]
        _check_draws(kind, "pixels", _UV, drawn)
    loop = replace(loop, noise=Noise(perturb=(perturbation,)))
    one, again = (uninterrupted(run(loop)).table for _ in range(2))
    assert np.array_equal(one, again, equal_nan=True), (
        f"{kind}: two runs of one seed have different logs; keep no state in the object"
    )


def _check_draws(kind: str, what: str, unchanged: Array | Image, drawn: list[Array]) -> None:
    """Draws of one seed, of the same again, and of another."""
    one, again, other = drawn
    assert np.array_equal(one, again, equal_nan=True), (
        f"{kind}: another change of the {what} for the same seed; draw from `rng` alone"
    )
    changed = [not np.array_equal(x, unchanged, equal_nan=True) for x in (*one, *other)]
    assert any(changed), f"{kind}: none of {len(changed)} draws changed the {what}"


_PICTURE = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
_UV = np.array([[10.0, 20.0], [30.0, 5.0], [np.nan, np.nan], [60.0, 40.0]])


def _perturbed_picture(perturbation: PerturbationBase, seed: int) -> Array:
    drawn = Perturbed((perturbation,), np.random.default_rng(seed))
    return np.array([drawn.next_picture()(0.04 * i, (_PICTURE,))[0] for i in range(DRAWS)])


def _pixels(perturbation: PerturbationBase, seed: int) -> Array:
    drawn = Perturbed((perturbation,), np.random.default_rng(seed))
    uv = np.array([drawn.pixels(_UV, 0.04 * i) for i in range(DRAWS)])
    assert np.isnan(uv[:, 2]).all(), (
        f"{perturbation.kind}: a marker that is not seen (NaN) must stay so"
    )
    return uv


def check_effect(effect: Effect, scenario: Scenario | None = None) -> None:
    """An effect changes a run, fills its columns with numbers, and depends on the scenario's seed
    alone.

    Args:
        effect: with the parameters to test. scenario: of a robot that may have it; None: an arm for
            0.3 s.

    Raises:
        AssertionError, ParameterError: it says what was expected and what was found.
    """
    check_contract(EFFECTS, effect)
    name = type(effect).__name__
    plain = scenario or load("arm_ibvs", {"detector": "oracle", "stop.duration_s": SHORT_S})
    own = replace(plain, robot=replace(plain.robot, effects=(effect,)))
    without, one, again = (uninterrupted(run(s)).frame() for s in (plain, own, own))
    assert one.equals(again), (
        f"{name}: two runs of one seed have different logs;"
        " keep no state in the object, and draw from `rng` alone"
    )
    values = one.select(effect.columns).to_numpy()
    assert np.isfinite(values).all(), (
        f"{name}: the columns {', '.join(effect.columns)} must be finite numbers"
    )
    moved = any(
        not np.array_equal(one[c], without[c])
        for c in without.columns
        if c.startswith(("cam_", "q_"))
    )
    assert moved, f"{name}: the robot moves as without it; give it parameters with which it acts"


def check_metric(metric: MetricContract, scenario: Scenario | None = None) -> None:
    """A metric's figures are numbers under names of their own, of a scenario's run and of its first
    frame alone.
    """
    check_contract(METRICS, metric)
    for name, title in metric.titles.items():
        words = title if isinstance(title, tuple) else ()
        two = len(words) == 2 and all(isinstance(word, str) for word in words)
        assert two, f"{metric.kind}: titles[{name!r}] must be (title, unit), got {title!r}"
    check_metrics((metric,))
    recording = uninterrupted(run(replace(scenario or quick("view"), metrics=(metric,))))
    assert set(metric.titles) <= set(recording.summary())
    replace(recording, rows=Log(recording.columns, recording.table[:1])).summary()


def check_monitor(monitor: MonitorContract, ends: Scenario | None = None) -> None:
    """A monitor leaves the run as it is until its verdict, and gives the same verdict each time.
    monitor: with the parameters to test. ends: a run that it must end; None: the quick one, which
    it may leave alone.
    """
    kind = monitor.kind
    check_contract(MONITORS, monitor)
    loop = ends or quick("view")
    without = uninterrupted(run(replace(loop, monitors=())))
    loop = replace(loop, monitors=(monitor,))
    one, again = (uninterrupted(run(loop)) for _ in range(2))
    assert (one.outcome, one.reason) == (again.outcome, again.reason), (
        f"{kind}: {one.outcome.name} and then {again.outcome.name};"
        " what a run remembers belongs into the object that `monitor` makes"
    )
    n = len(one.rows)
    # the last command is not sent any more
    same = np.array_equal(one.table[: n - 1], without.table[: n - 1], equal_nan=True)
    assert same, (
        f"{kind}: the run before its verdict differs from one without it;"
        " a monitor must not write into a frame"
    )
    ended = (one.outcome, one.reason) != (without.outcome, without.reason)
    assert ended or ends is None, (
        f"{kind}: it must end this run, which ended {one.outcome.name}: {one.reason}"
    )
    assert not ended or one.reason, f"{kind}: an outcome needs a reason in words"
