"""What every perturbation, metric and outcome monitor must do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vstestbed.camera import Image
from vstestbed.core.geometry import Array
from vstestbed.effects import EFFECTS, Effect
from vstestbed.loop.log_file import Log
from vstestbed.loop.session import run, uninterrupted
from vstestbed.scenario.load import load
from vstestbed.scenario.noise import Noise
from vstestbed.scenario.scenario import Scenario
from vstestbed.tasks.metrics import METRICS, MetricContract, check_metrics
from vstestbed.tasks.monitors import MONITORS, MonitorContract
from vstestbed.testing.laws import quick
from vstestbed.vision.perturb import PERTURBATIONS, PerturbationBase, Perturbed

DRAWS = 200  # pictures or measurements of which a perturbation must change one at least
SHORT_S = 0.3


def check_noise(perturbation: PerturbationBase) -> None:
    """A perturbation changes something, returns what it is given in shape and type, and depends on its seed alone."""
    kind = perturbation.kind
    assert PERTURBATIONS.contract is not None
    PERTURBATIONS.contract.check(type(perturbation))
    assert perturbation.changes, f"{kind}: `changes` must name picture, pixels or both"
    if "picture" in perturbation.changes:
        _check_draws(kind, "picture", _PICTURE, [_picture(perturbation, seed) for seed in (0, 0, 1)])
    if "pixels" in perturbation.changes:
        _check_draws(kind, "pixels", _UV, [_pixels(perturbation, seed) for seed in (0, 0, 1)])
    loop = load("ibvs_book", {"stop.duration_s": SHORT_S}) if "picture" in perturbation.changes else quick("view")
    loop = replace(loop, noise=Noise(perturb=(perturbation,)))
    one, again = (uninterrupted(run(loop)).table for _ in range(2))
    assert np.array_equal(one, again, equal_nan=True), f"{kind}: two runs of one seed have different logs; keep no state in the object"


def _check_draws(kind: str, what: str, unchanged: Array | Image, drawn: list[Array]) -> None:
    """Draws of one seed, of the same again, and of another."""
    one, again, other = drawn
    assert np.array_equal(one, again, equal_nan=True), f"{kind}: another change of the {what} for the same seed; draw from `rng` alone"
    changed = [not np.array_equal(x, unchanged, equal_nan=True) for x in (*one, *other)]
    assert any(changed), f"{kind}: none of {len(changed)} draws changed the {what}"


_PICTURE = np.random.default_rng(0).integers(0, 256, (48, 64, 3), dtype=np.uint8)
_UV = np.array([[10.0, 20.0], [30.0, 5.0], [np.nan, np.nan], [60.0, 40.0]])


def _picture(perturbation: PerturbationBase, seed: int) -> Array:
    drawn = Perturbed((perturbation,), np.random.default_rng(seed))
    return np.array([drawn.next_picture()(0.04 * i, (_PICTURE,))[0] for i in range(DRAWS)])


def _pixels(perturbation: PerturbationBase, seed: int) -> Array:
    drawn = Perturbed((perturbation,), np.random.default_rng(seed))
    uv = np.array([drawn.pixels(_UV, 0.04 * i) for i in range(DRAWS)])
    assert np.isnan(uv[:, 2]).all(), f"{perturbation.kind}: a marker that is not seen (NaN) must stay so"
    return uv


def check_effect(effect: Effect, scenario: Scenario | None = None) -> None:
    """An effect changes a run, fills its columns with numbers, and depends on the scenario's seed alone.

    Args:
        effect: with the parameters to test. scenario: of a robot that may have it; None: an arm for 0.3 s.

    Raises:
        AssertionError, ParameterError: it says what was expected and what was found.
    """
    assert EFFECTS.contract is not None
    EFFECTS.contract.check(type(effect))
    name = type(effect).__name__
    plain = scenario or load("arm_ibvs", {"detector": "oracle", "stop.duration_s": SHORT_S})
    own = replace(plain, robot=replace(plain.robot, effects=(effect,)))
    without, one, again = (uninterrupted(run(s)).frame() for s in (plain, own, own))
    assert one.equals(again), f"{name}: two runs of one seed have different logs; keep no state in the object, and draw from `rng` alone"
    values = one.select(effect.columns).to_numpy()
    assert np.isfinite(values).all(), f"{name}: the columns {', '.join(effect.columns)} must be finite numbers"
    moved = any(not np.array_equal(one[c], without[c]) for c in without.columns if c.startswith(("cam_", "q_")))
    assert moved, f"{name}: the robot moves as without it; give it parameters with which it acts"


def check_metric(metric: MetricContract, scenario: Scenario | None = None) -> None:
    """A metric's figures are numbers under names of their own, of a scenario's run and of its first frame alone."""
    assert METRICS.contract is not None
    METRICS.contract.check(type(metric))
    for name, title in metric.titles.items():
        two = isinstance(title, tuple) and len(title) == 2 and all(isinstance(word, str) for word in title)
        assert two, f"{metric.kind}: titles[{name!r}] must be (title, unit), got {title!r}"
    check_metrics((metric,))
    recording = uninterrupted(run(replace(scenario or quick("view"), metrics=(metric,))))
    assert set(metric.titles) <= set(recording.summary())
    replace(recording, rows=Log(recording.columns, recording.table[:1])).summary()


def check_monitor(monitor: MonitorContract, ends: Scenario | None = None) -> None:
    """A monitor leaves the run as it is until its verdict, and gives the same verdict each time.
    monitor: with the parameters to test. ends: a run that it must end; None: the quick one, which it may leave alone.
    """
    kind = monitor.kind
    assert MONITORS.contract is not None
    MONITORS.contract.check(type(monitor))
    loop = ends or quick("view")
    without, one, again = (uninterrupted(run(replace(loop, monitors=those))) for those in ((), (monitor,), (monitor,)))
    assert (one.outcome, one.reason) == (again.outcome, again.reason), (
        f"{kind}: {one.outcome.name} and then {again.outcome.name}; what a run remembers belongs into the object that `monitor` makes"
    )
    n = len(one.rows)
    same = np.array_equal(one.table[: n - 1], without.table[: n - 1], equal_nan=True)  # the last command is not sent any more
    assert same, f"{kind}: the run before its verdict differs from one without it; a monitor must not write into a frame"
    ended = (one.outcome, one.reason) != (without.outcome, without.reason)
    assert ended or ends is None, f"{kind}: it must end this run, which ended {one.outcome.name}: {one.reason}"
    assert not ended or one.reason, f"{kind}: an outcome needs a reason in words"
