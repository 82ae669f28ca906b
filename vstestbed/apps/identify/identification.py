"""Identification: what of a robot's record this project can simulate, by prediction errors:
latencies, time constants, wheel radii, noise.

A record has the commands that were sent, and what was read at each picture: joints, and markers.
The simulator flies the same commands, and least squares find the parameters with which it reads the
same.

Reference: Ljung 1999, System Identification, 2nd ed., chapters 7 and 9 (prediction error methods,
their weights and covariance).
"""

from __future__ import annotations

import bisect
import functools
import io
import logging
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import polars as pl
from scipy.interpolate import CubicHermiteSpline, CubicSpline
from scipy.optimize import least_squares
from scipy.stats import t as student

from vstestbed.core.errors import ParameterError, RunFolderError
from vstestbed.core.files import write_whole
from vstestbed.core.foreign import foreign, plain_file
from vstestbed.core.geometry import Array
from vstestbed.core.registry import to_mapping
from vstestbed.loop.episode import Episode
from vstestbed.loop.inputs import OUTSIDE
from vstestbed.report.canvas import new_figure, publish, style
from vstestbed.report.marks import LINE_COLORS
from vstestbed.report.pages import write_page
from vstestbed.robots import Mount
from vstestbed.scenario.dump import as_yaml, documents
from vstestbed.scenario.load import parse
from vstestbed.scenario.scenario import Scenario

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RECORD = "record.parquet"
KNOWN = r"^(t|t_q|arrived|u_\d+|qd?_.+|[uv]_px_\d+)$"  # its columns
COMMANDS = pl.selectors.matches(r"^u_\d+$")
COMMAND_LATENCY, STAMPS = "timing.command_latency_s", "stamps_late_s"
"""The two parameters that only shift what is predicted: from when on a command acts, and how much
later than its exposure a picture is stamped, by the clock of the joints' readings.
"""
# under which a sensor's noise is not believed [rad, px]
LEAST_NOISE = {"joint": 1e-5, "pixel": 0.02}
LEAST_MOMENTS, LONGEST_S = 20, 600.0  # of a record, and for how long one is flown again
LARGEST = 1e12  # a number beyond is none of a robot's, and its square not far from that of infinity
# share of a joint's readings outside of its range that failed encoders may have; of another unit it
# is more
MOST_OUTSIDE = 0.02
# RMS of the prediction errors over the noise, from which on the simulator does not read what the
# robot read
MISFIT = 2.0
MOST_RECORD = 1 << 28  # bytes of a record's file
# cosine of what two parameters change in the predictions, from which on they are not told apart
APART = 0.998

# The motion: of each of a robot's own motions a step to and fro, then sines of all at once.
REST_S, STEP_S, SINES_S = 0.6, 0.4, 4.0
# amplitudes by `Robot.base`, of translations and of rotations [m/s, rad/s]
SHARES = {"fixed": (0.06, 0.25), "planar": (0.25, 0.6), "floating": (0.4, 0.4)}


def motion_of(scenario: Scenario) -> pl.DataFrame:
    """Commands at the camera's rate, along the robot's own motions: `t` and `u_0`, ... [m/s,
    rad/s]; they end where they began.
    """
    basis = _motions(scenario)
    n = basis.shape[1]
    rate = scenario.camera.rate_hz
    sizes = np.where(np.linalg.norm(basis[:3], axis=0) > 0.5, *SHARES[scenario.robot.base])
    rest = np.zeros((round(rate * REST_S), n))
    step = round(rate * STEP_S)
    parts = [rest]
    for i in range(n):
        to_and_fro = np.zeros((4 * step, n))
        to_and_fro[:step, i] = sizes[i]
        to_and_fro[2 * step : 3 * step, i] = -sizes[i]
        parts.append(to_and_fro)
    at = np.arange(round(rate * SINES_S)) / rate
    k = np.arange(n)
    whole = (k + 2) / SINES_S * 2  # periods, each motion its own
    sines = np.sin(2 * np.pi * at[:, None] * whole)
    u = np.concatenate([*parts, 0.7 * sizes * sines * (-1.0) ** k, rest, rest])
    return pl.DataFrame({"t": np.arange(len(u)) / rate, **{f"u_{i}": u[:, i] for i in range(n)}})


def _motions(scenario: Scenario) -> Array:
    """The camera twists of the robot's own motions at its start (6, n)."""
    return scenario.robot.motion_basis(
        Mount.of(scenario.believed_camera.mount.T), scenario.robot.start_joints()
    )


def fly(
    scenario: Scenario, motion: pl.DataFrame, tick: Callable[[], None] = lambda: None
) -> pl.DataFrame:
    """The record of a simulated robot that is commanded so: with each picture its stamp `t`, when
    it came, the command that was sent then, and what was read: joints by the robot's sensors, at
    `t_q` by its clock, and markers by the detector. It ends with the motion, or where the robot
    stops by itself.
    """
    u = motion.select(COMMANDS).to_numpy()
    rows: list[dict[str, float]] = []
    with closing(Episode(_undisturbed(scenario), False, (), None)) as episode:
        frame = episode.advance()
        while frame is not None and len(rows) < len(u) and episode.outcome is None:
            shot = episode.controller.before
            assert shot is not None
            row = {"t": shot.t, "t_q": frame.t, "arrived": episode.now}
            row |= {f"u_{i}": v for i, v in enumerate(u[len(rows)].tolist())}
            read = np.column_stack([shot.reading.q, shot.reading.qd])
            for name, (q, qd) in zip(scenario.robot.joints, read.tolist(), strict=True):
                row |= {f"q_{name}": q, f"qd_{name}": qd}
            for i, (a, b) in enumerate(frame.observation.uv.tolist()):
                row |= {f"u_px_{i}": a, f"v_px_{i}": b}
            rows.append(row)
            tick()
            frame = episode.advance(u[len(rows) - 1])
    return pl.DataFrame(rows)


def keep(folder: Path, scenario: Scenario, motion: pl.DataFrame, record: pl.DataFrame) -> Path:
    """Write what was flown into a folder: record, motion and scenario; the record's path."""
    content = io.BytesIO()
    record.write_parquet(content)
    write_whole(folder / "motion.csv", motion.write_csv())
    write_whole(folder / "scenario.yaml", documents(scenario)["scenario.yaml"])
    return write_whole(folder / RECORD, content.getvalue())


def _undisturbed(scenario: Scenario) -> Scenario:
    """The same without an end but that of its motion."""
    stop = replace(
        scenario.stop,
        duration_s=600.0,
        lost_after_s=600.0,
        rest_after_s=None,
        converged=replace(scenario.stop.converged, hold_s=600.0),
    )
    return replace(scenario, stop=stop)


def read_record(path: Path) -> pl.DataFrame:
    """A record, from its file or the folder that has it. RunFolderError: none there, or one without
    the columns of one.
    """
    file = path / RECORD if path.is_dir() else path
    works = (
        "a file or folder of `vstestbed excite`, with columns t, arrived, u_0,"
        " ..., q_..., u_px_0, ..."
    )
    if not file.exists():
        raise RunFolderError(path, f"has no {RECORD}", works)
    plain_file(file, works, MOST_RECORD, RunFolderError)
    with foreign(file, works, RunFolderError):
        found = (
            pl.read_csv(file, infer_schema_length=None)
            if file.suffix == ".csv"
            else pl.read_parquet(file)
        )
    if not {"t", "u_0"} <= set(found.columns):
        raise RunFolderError(file, f"has the columns {', '.join(found.columns[:8])}", works)
    return found


def cleaned(record: pl.DataFrame) -> pl.DataFrame:
    """A record's moments whose times and commands are numbers and rise, NaN for readings that are
    none; the others are passed over, and told with their times. ParameterError: columns of
    something else, too few moments, or too long a record.
    """
    with foreign("record", "columns of numbers"):
        numbers = record.select(pl.selectors.matches(KNOWN).cast(pl.Float64, strict=False))
    usual = pl.all().abs() < LARGEST
    table = numbers.with_columns(pl.when(usual).then(pl.all()).otherwise(math.nan))
    needed = table.select(pl.selectors.matches(r"^(t|t_q|arrived|u_\d+)$")).to_numpy()
    used = np.flatnonzero(np.isfinite(needed).all(axis=1))
    no_numbers = len(table) - len(used)
    t = table["t"].to_numpy()
    used = used[_rising(t[used])]
    if "t_q" in table.columns:
        used = used[_rising(table["t_q"].to_numpy()[used])]
    if len(used) < LEAST_MOMENTS:
        words = (
            f"has {len(used)} moments that can be used of {len(table)};"
            f" at least {LEAST_MOMENTS} are needed"
        )
        raise ParameterError("record", words)
    if (whole_s := float(t[used[-1]] - t[used[0]])) > LONGEST_S:
        raise ParameterError.bound(
            "record",
            "at most",
            f"{LONGEST_S:g} s long",
            round(whole_s, 3),
            why="times are in seconds; these may be in milliseconds",
        )
    left = np.delete(np.arange(len(table)), used).tolist()
    if left:
        _tell_left(left, t, no_numbers)
    found = table[used.tolist()]
    if unread := np.isnan(found.to_numpy()).sum():
        logging.getLogger("vstestbed").warning(
            "%d readings of the record are no numbers, and are passed over", unread
        )
    return found


def _within_range(record: pl.DataFrame, scenario: Scenario) -> pl.DataFrame:
    """The record with NaN for single readings of joints outside of their ranges. ParameterError: a
    joint that reads so again and again.
    """
    body = scenario.robot.body
    if body is None or body.limits is None:
        return record
    wrong = 0
    for name, (low, high) in zip(scenario.robot.joints, body.limits.tolist(), strict=True):
        column = f"q_{name}"
        if column not in record.columns:
            continue
        q = record[column].to_numpy()
        outside = (q < low - OUTSIDE) | (q > high + OUTSIDE)
        if outside.mean() > MOST_OUTSIDE:
            words = (
                f"has {column} outside of its range of {low:.4g} to {high:.4g} in {outside.sum()}"
                f" of {len(q)} moments"
            )
            works = (
                "must be in radians, a slide's in metres,"
                f" in the order {', '.join(scenario.robot.joints)}"
            )
            raise ParameterError("record", f"{words}: {works}", round(float(q[outside][0]), 4))
        wrong += int(outside.sum())
        record = record.with_columns(pl.Series(column, np.where(outside, np.nan, q)))
    if wrong:
        logging.getLogger("vstestbed").warning(
            "%d readings of joints outside of their ranges are passed over", wrong
        )
    return record


def _tell_left(left: list[int], t: Array, no_numbers: int) -> None:
    """Tell which moments of all, of times t (n,) [s], are passed over, so many of them for want of
    numbers.
    """
    first, last = (f"line {i + 1} (t = {t[i]:g})" for i in (left[0], left[-1]))
    words = (
        f"{len(left)} of {len(t)} moments of the record are passed over,"
        f" the first in {first}, the last in {last}"
    )
    words += f": {no_numbers} with times or commands that are no numbers"
    words += f", {len(left) - no_numbers} whose times go back or stand still"
    logging.getLogger("vstestbed").warning("%s", words)


def _rising(t: Array) -> list[int]:
    """Indices of the longest part of some times (n,) that rises: one wrong time costs itself,
    wherever it lies.
    """
    ends: list[int] = []  # of a part of each length, the index of its end that is the earliest
    before: list[int] = []
    for i, at in enumerate(t.tolist()):
        length = bisect.bisect_left(ends, at, key=t.__getitem__)
        before.append(ends[length - 1] if length else -1)
        ends[length : length + 1] = [i]
    part = ends[-1:]
    while part and before[part[-1]] >= 0:
        part.append(before[part[-1]])
    return part[::-1]


# What is fitted.
@dataclass(frozen=True)
class Parameter:
    """A number to be found. field: its dotted path in a scenario; low, high: its bounds. factor: of
    the scenario's values, in place of them.
    """

    field: str
    low: float
    high: float
    factor: bool = False

    @classmethod
    def of(cls, words: str) -> Parameter:
        """The parameter of `FIELD=LOW..HIGH`, or `FIELD=xLOW..xHIGH` of a factor. ParameterError:
        of another form.
        """
        field, _, bounds = words.partition("=")
        low, dots, high = bounds.partition("..")
        try:
            made = cls(
                field.strip(), float(low.lstrip("x")), float(high.lstrip("x")), low.startswith("x")
            )
        except ValueError:
            made = None
        if (
            made is None
            or not (made.field and dots and -math.inf < made.low < made.high < math.inf)
            or (made.factor and made.shifts)
        ):
            form = (
                "FIELD=LOW..HIGH, such as robot.drive_lag_s=0.001..0.5;"
                " with xLOW..xHIGH as a factor, of no latency"
            )
            raise ParameterError.form("--fit", form, words)
        return made

    @property
    def shifts(self) -> bool:
        """Whether it only shifts what is predicted."""
        return self.field in (COMMAND_LATENCY, STAMPS)

    def given(self, scenario: Scenario) -> Any:
        """What its field is in a scenario; None where there is no such field."""
        now: Any = scenario
        for part in self.field.split("."):
            now = getattr(now, part, None)
        return now

    def value(self, scenario: Scenario, x: float) -> Any:
        """What its field is with the number x."""
        now = self.given(scenario)
        if self.factor and isinstance(now, tuple):
            return [x * v for v in now]
        # of what is no number nothing is a multiple: the scenario refuses it
        return x * now if self.factor and isinstance(now, int | float) else x


WHEELED = (
    Parameter("robot.drive_lag_s", 0.001, 0.5),
    Parameter("robot.wheel_radius_error", -0.1, 0.1),
)
USUAL: Mapping[str, tuple[Parameter, ...]] = {
    "mjcf": (Parameter("robot.servo_kv", 0.2, 5.0, factor=True),),
    "omni": WHEELED,
    "car": WHEELED,
    "quadrotor": (
        Parameter("robot.gains.velocity", 0.5, 5.0),
        Parameter("robot.gains.climb", 0.5, 6.0),
    ),
}
"""What is fitted of a robot by default, besides the two latencies."""


def usual(scenario: Scenario, record: pl.DataFrame) -> tuple[Parameter, ...]:
    """What is fitted by default: the latencies, and the parameters of the robot's kind."""
    markers = "u_px_0" in record.columns
    stamps = (Parameter(STAMPS, -0.2, 0.5),) if markers else ()
    own = USUAL.get(scenario.robot.kind, ())
    return (
        Parameter(COMMAND_LATENCY, 0.0, 0.5),
        *stamps,
        *(p for p in own if markers or p.field != "robot.wheel_radius_error"),
    )


@dataclass(frozen=True)
class Identified:
    """What was found. values, half: of each parameter, and half of its 95 % interval. together:
    pairs of parameters that the record does not tell apart, with the cosine between what they
    change. noise: standard deviations of what was read, by name [rad, m or px]; latency_s,
    jitter_s: of the pictures from stamp to arrival, and of their stamps' distances. residual: RMS
    of the prediction errors over the noise, of parts of the record that were left out of the fit
    [1].
    """

    scenario: Scenario
    parameters: tuple[Parameter, ...]
    values: Array
    half: Array
    together: list[tuple[str, str, float]]
    noise: dict[str, float]
    latency_s: float
    jitter_s: float
    residual: float
    record: pl.DataFrame
    predicted: Array
    measured: Array
    names: list[str]


def identify(
    record: pl.DataFrame,
    scenario: Scenario,
    parameters: Sequence[Parameter] = (),
    say: Callable[[str], None] = lambda _: None,
) -> Identified:
    """Fit parameters to a record. say: told of each run of the simulator.
    Raises ParameterError: a parameter that the scenario has not, or a record of another robot.
    ScenarioError: a value is refused.
    """
    record = _within_range(cleaned(record), scenario)
    fit = tuple(parameters) or usual(scenario, record)
    commands = record.select(COMMANDS).width
    motions = _motions(scenario).shape[1]
    if commands != motions:
        words = (
            f"has commands of {commands} motions, and robot {scenario.robot.kind} has {motions}:"
            " is it of another robot?"
        )
        raise ParameterError("record", words)
    model = _Model(record, scenario, fit, say)
    errors = _Errors(model, _noise(model.measured, model.names))
    x = model.start
    # by the sensors' noise alone first; then by how the errors of that go together
    for stage in range(STAGES):
        x = _fitted(errors, x)
        if stage + 1 < STAGES:
            errors = errors.whitened(x)
    found = _summed_up(errors, x)
    if not found.residual < MISFIT:  # also where it is not known
        logging.getLogger("vstestbed").warning("the simulator does not read what the robot read")
    return found


STAGES = 3


@dataclass(frozen=True)
class _Errors:
    """Prediction errors over the parameters, whitened: those of the moment before are taken off as
    far as they go on (an AR(1) process for each reading), and what is left is weighed by its
    covariance. A craft that drifts in its own sensors' noise, or a camera whose markers move
    together, would else count as hundreds of independent surprises.

    sigma: noise of each reading (k,). rho: how much of an error goes on (k,); 0 at first. W:
    weights (k, k), W^T W the inverse covariance.
    """

    model: _Model
    sigma: Array
    rho: Array | float = 0.0
    W: Array | None = None

    def plain(self, x: Array) -> Array:
        """The errors over the noise (n, k); 0 where nothing was read."""
        measured = self.model.measured
        off = (self.model.predicted(x) - measured) / self.sigma
        return np.where(np.isfinite(measured), np.nan_to_num(off, nan=1e3), 0.0)

    def __call__(self, x: Array) -> Array:
        """The whitened errors, flat."""
        return self.weighted(self.plain(x)).ravel()

    def weighted(self, off: Array) -> Array:
        """Errors (n, k), whitened."""
        off = self._onward(off)
        return off if self.W is None else off @ self.W.T

    def _onward(self, off: Array) -> Array:
        return np.concatenate([off[:1], off[1:] - self.rho * off[:-1]])

    def whitened(self, x: Array) -> _Errors:
        """The same with rho and W of the errors at x."""
        off = self.plain(x)
        power = np.maximum((off[:-1] ** 2).sum(axis=0), 1e-12)
        rho = np.clip((off[1:] * off[:-1]).sum(axis=0) / power, 0.0, 0.995)
        made = replace(self, rho=rho)
        left = made._onward(off)[1:]
        S = left.T @ left / len(left)
        # shrunk: of few moments it is uncertain
        S = 0.95 * S + 0.05 * np.diag(np.diag(S)) + 1e-3 * np.eye(len(S))
        return replace(made, W=np.linalg.inv(np.linalg.cholesky(S)))


def _fitted(errors: _Errors, start: Array) -> Array:
    """The least squares from a start, robust against single outliers."""
    fit = errors.model.fit
    low = np.array([p.low for p in fit])
    high = np.array([p.high for p in fit])
    found = least_squares(
        errors,
        np.clip(start, low + 1e-9, high - 1e-9),
        jac=lambda x: _jacobian(errors, x, fit),  # type: ignore[arg-type] - its stubs know no function
        bounds=(low, high),
        x_scale=np.array([0.02 if p.shifts else 0.3 * (p.high - p.low) for p in fit]),
        loss="soft_l1",
        f_scale=3.0,
        max_nfev=25,
        ftol=1e-5,
        xtol=1e-5,
    )
    return found.x


def _summed_up(errors: _Errors, x: Array) -> Identified:
    """What was found at x: intervals, what is not told apart, the noise, and the test on parts that
    are left out.
    """
    model = errors.model
    fit = model.fit
    predicted = model.predicted(x)
    off = errors.plain(x)
    plain = _jacobian(errors.plain, x, fit)
    J = np.stack([errors.weighted(plain[:, :, i]) for i in range(len(fit))], axis=-1)
    half, without = _interval(J, errors.weighted(off))
    together = _together(fit, J)
    # of what is not told apart, nothing is known of each alone
    vague = {field for *pair, _ in together for field in pair}
    for i, p in enumerate(fit):
        if p.field in vague or np.linalg.norm(J[:, :, i]) < 1e-9:
            half[i] = np.inf
        elif p.field == COMMAND_LATENCY:
            # A command acts at the next step of the robot's clock, one of some phase to the
            # camera's: within a step nothing tells when it came.
            half[i] += model.grid_s
    # of the errors, since the motion itself is not smooth from picture to picture
    own = _noise(model.measured - predicted, model.names)
    left_out = []
    for part, change in zip(np.array_split(np.arange(len(off)), PARTS), without, strict=True):
        left_out.append(off[part] + plain[part] @ change)
    residual = np.sqrt(((np.concatenate(left_out) * errors.sigma / own) ** 2).mean())
    t = model.record["t"].to_numpy()
    arrived = model.record["arrived"].to_numpy() if "arrived" in model.record.columns else t
    return Identified(
        model.scenario,
        fit,
        x,
        half,
        together,
        _noise_of_kinds(own, model.names),
        float(np.median(arrived - t)),
        float(np.std(np.diff(t))),
        float(residual),
        model.record,
        predicted,
        model.measured,
        model.names,
    )


def _noise_of_kinds(own: Array, names: list[str]) -> dict[str, float]:
    """Medians of the noise of joints and of markers, of those that there are."""
    pixels = np.array(["_px_" in name for name in names])
    kinds = {"joints": own[~pixels], "markers": own[pixels]}
    return {kind: float(np.median(values)) for kind, values in kinds.items() if len(values)}


def _together(fit: Sequence[Parameter], J: Array) -> list[tuple[str, str, float]]:
    """Pairs of parameters that the record does not tell apart, with the cosine between what they do
    to the predictions, J (n, k, p).
    """
    sizes = np.maximum(np.linalg.norm(J, axis=(0, 1)), 1e-12)
    cosines = np.einsum("tki,tkj->ij", J, J) / np.outer(sizes, sizes)
    pairs = [(i, j) for i in range(len(fit)) for j in range(i) if abs(cosines[i, j]) > APART]
    return [(fit[j].field, fit[i].field, float(cosines[i, j])) for i, j in pairs]


PARTS = 8  # of a record, each left out in its turn


def _interval(J: Array, off: Array) -> tuple[Array, Array]:
    """Half of the 95 % interval of each parameter (p,), and how the parameters change without each
    part of the record (PARTS, p), by the whitened errors e (n, k) and their Jacobian J (n, k, p),
    with H = sum J^T J.

    The errors go on in time, most of all where the model lacks something. Their covariances R_l
    over l moments give H^-1 (sum_l w_l sum_t J_t+l^T R_l J_t) H^-1 (Hjalmarsson & Ljung 1992, IEEE
    Trans. Automatic Control 37, 1004-1008), with weights that fall to 0 over a quarter of the
    record (Newey & West 1987, doi:10.2307/1913610). Without a part b the parameters change by -(H -
    H_b)^-1 sum_not_b J^T e, and spread where the parts do not agree (jackknife of blocks, Kuensch
    1989, doi:10.1214/aos/1176347265). The wider of both counts. Neither knows of what changes the
    readings as a parameter does.
    """
    n = len(off)
    most = n // 4
    each = np.einsum("tki,tkj->tij", J, J)
    g = np.einsum("tki,tk->ti", J, off)
    inverse = np.linalg.pinv(each.sum(axis=0))
    S = np.zeros_like(inverse)
    for lag in range(most + 1):
        R = off[lag:].T @ off[: n - lag] / n
        one = np.einsum("tki,km,tmj->ij", J[lag:], R, J[: n - lag], optimize=True)
        S += (1 - lag / (most + 1)) * (one + one.T) / (2 if lag == 0 else 1)
    by_time = np.maximum(np.diag(inverse @ S @ inverse), 0.0)
    without = []
    for part in np.array_split(np.arange(n), PARTS):
        rest = np.delete(np.arange(n), part)
        without.append(-np.linalg.pinv(each[rest].sum(axis=0)) @ g[rest].sum(axis=0))
    by_parts = (PARTS - 1) * np.var(without, axis=0)
    of_time = student.ppf(0.975, n) * np.sqrt(by_time)
    of_parts = student.ppf(0.975, PARTS - 1) * np.sqrt(by_parts)
    return np.maximum(of_time, of_parts), np.array(without)


def _jacobian(errors: Callable[[Array], Array], x: Array, fit: Sequence[Parameter]) -> Array:
    """By central differences, wide enough for a simulator whose events fall on steps."""
    columns = []
    for i, p in enumerate(fit):
        h = 0.004 if p.shifts else 0.02 * max(abs(x[i]), 0.05 * (p.high - p.low))
        ends = np.clip(x[i] + np.array([-h, h]), p.low, p.high)
        low, high = (errors(np.where(np.arange(len(x)) == i, end, x)) for end in ends)
        columns.append((high - low) / (ends[1] - ends[0]))
    return np.stack(columns, axis=-1)


def _start(p: Parameter, scenario: Scenario) -> float:
    """Where the search begins: at the scenario's value, a factor at 1; in the middle where there is
    none.
    """
    if p.factor:
        return 1.0
    if p.shifts:
        return 0.0 if p.field == STAMPS else 0.03
    now = p.given(scenario)
    if isinstance(now, int | float) and now:
        return float(now)
    return 0.05 if p.low > 0 else 0.5 * (p.low + p.high)


def _measured(record: pl.DataFrame, scenario: Scenario) -> tuple[list[str], Array, Array]:
    """Names and values (n, k) of what was read, and its times (n,), from 0 on."""
    there = set(record.columns)
    joints = [f"q_{name}" for name in scenario.robot.joints if f"q_{name}" in there]
    moving = [name for name in joints if record[name].fill_nan(None).drop_nulls().n_unique() > 1]
    points = range(len(scenario.target.points))
    of_points = [f"{axis}_px_{i}" for i in points for axis in "uv"]
    pixels = [name for name in of_points if name in there]
    if not moving and not pixels:
        words = (
            f"has none of q_{', q_'.join(scenario.robot.joints)} that changes, and no u_px_0, ...:"
            " is it of another robot?"
        )
        raise ParameterError("record", words, record.columns[:8])
    clock = "t_q" if joints and "t_q" in there else "t"
    names = moving + pixels
    return names, record.select(names).to_numpy(), record[clock].to_numpy()


def _noise(a: Array, names: list[str]) -> Array:
    """Standard deviations (k,) of white noise on smooth signals (n, k), by third differences
    (Gasser, Sroka & Jennen-Steinmetz 1986).
    """
    out = []
    for name, column in zip(names, a.T, strict=True):
        least = LEAST_NOISE["pixel" if "_px_" in name else "joint"]
        d = np.abs(np.diff(column[np.isfinite(column)], 3))
        noise = 1.4826 * np.median(d) / math.sqrt(20) if len(d) else least
        out.append(max(noise, least))
    return np.array(out)


_EXACT = {
    "robot.imu.gyro_sigma_radps": 0.0,
    "robot.imu.accel_sigma_mps2": 0.0,
    "robot.range_sigma_m": 0.0,
}
"""Instruments without noise, of a robot that flies by them: its motion would else follow the noise
of another flight.
"""


@dataclass
class _Model:
    """What the simulator predicts, over the parameters; runs are kept. Commands reach a simulated
    robot at a step of its clock: between two latencies on a grid, predictions are interpolated.
    """

    record: pl.DataFrame
    scenario: Scenario
    fit: tuple[Parameter, ...]
    say: Callable[[str], None]

    def __post_init__(self) -> None:
        self.names, self.measured, t = _measured(self.record, self.scenario)
        self._pixels = np.array(["_px_" in name for name in self.names])
        self._t = t - t[0]
        self._stamps = self.record["t"].to_numpy() - t[0]
        arrived = self._t
        if "arrived" in self.record.columns:
            arrived = self.record["arrived"].to_numpy() - t[0]
        self._latency_s = max(0.0, float(np.median(arrived - self._t)))
        self._run = functools.cache(self._simulated)
        self._plain = as_yaml(self.scenario.made_of or to_mapping(self.scenario))
        starts = [np.clip(_start(p, self.scenario), p.low, p.high) for p in self.fit]
        self.start = np.array(starts)
        made = self._made(self._own(self.start), 0.0)
        onboard = made.robot.onboard  # which an imperfection may have switched on
        self.grid_s = made.clock[0] if onboard is None else onboard.control_period_s

    def _own(self, x: Array) -> tuple[float, ...]:
        values = zip(self.fit, x.tolist(), strict=True)
        return tuple(round(v, 9) for p, v in values if not p.shifts)

    def predicted(self, x: Array) -> Array:
        """What is read at each picture (n, k)."""
        shift = _shifts(self.fit, x)
        latency_s = shift.get(COMMAND_LATENCY, self.scenario.timing.command_latency_s)
        whole = self._between_steps(self._own(x), latency_s)
        times = np.arange(len(whole)) * self.scenario.camera.period
        values, speeds = np.split(whole, [len(self.names)], axis=1)
        out = np.empty_like(self.measured)
        pixels = self._pixels
        joints = ~pixels
        if joints.any():
            moved = CubicHermiteSpline(times, values[:, joints], speeds)
            out[:, joints] = moved(np.clip(self._t, 0, times[-1]))
        if pixels.any():
            taken = self._stamps - shift.get(STAMPS, 0.0)
            seen = CubicSpline(times, values[:, pixels])
            out[:, pixels] = seen(np.clip(taken, 0, times[-1]))
        return out

    def _between_steps(self, own: tuple[float, ...], latency_s: float) -> Array:
        """What is read at a latency between two steps of the grid: between what is read at both."""
        steps, share = divmod(latency_s / self.grid_s, 1.0)
        before = self._run(own, steps)
        if share <= 1e-9:
            return before
        return (1 - share) * before + share * self._run(own, steps + 1)

    def _made(self, own: tuple[float, ...], latency_s: float) -> Scenario:
        """The scenario with these values."""
        s = self.scenario
        values = iter(own)
        given = {p.field: p.value(s, next(values)) for p in self.fit if not p.shifts}
        # exact sensors and an ideal camera: what is read is what there is
        timeout_s = s.timing.command_timeout_s
        given |= {
            "timing": {"command_latency_s": latency_s, "command_timeout_s": timeout_s},
            "noise": {},
            "detector": {"kind": "oracle", "field_of_view": "unlimited"},
            "calibration": {},
            "camera.latency_s": self._latency_s,
            "camera.readout_s": 0.0,
        }
        if (flow := getattr(s.robot, "velocity", None)) is not None:
            given |= {**_EXACT, "robot.velocity": {**to_mapping(flow), "sigma_mps": 0.0}}
        if "image" in s.law.inputs:  # it moves nothing here
            given["law"] = {"kind": "ibvs", "depth": "goal"}
        elif s.law.depth.needs_pose and not s.goal.needs_pose:
            # a quarter of the time would be for a pose that nobody reads
            given["law.depth"] = "goal"
        for name in ("exposure", "stream"):
            if getattr(s.camera, name) is not None:
                given[f"camera.{name}"] = None
        return parse(self._plain, s.name or "scenario", given)

    def _simulated(self, own: tuple[float, ...], steps: float) -> Array:
        """What is read without noise (frames, k), and then the joints' speeds, with these values
        and a latency of so many steps of the grid.
        """
        latency_s = steps * self.grid_s
        self.say(f"{1e3 * latency_s:g} ms, {', '.join(f'{v:.5g}' for v in own)}")
        s = self._made(own, latency_s)
        period = s.camera.period
        commands = self.record.select(COMMANDS).to_numpy()
        at = np.arange(math.ceil(self._t[-1] / period + 1e-6) + 1) * period
        last = np.searchsorted(self._t, at + period / 2) - 1
        u = commands[np.clip(last, 0, len(commands) - 1)]
        table = fly(s, pl.DataFrame({"t": at, **{f"u_{i}": v for i, v in enumerate(u.T)}}))
        if len(table) < len(at):
            words = (
                f"ends after {len(table) * period:.2f} of {at[-1]:.2f} s,"
                " though it is commanded as in the record: does its start fit?"
            )
            raise ParameterError("robot", words)
        speeds = [f"qd_{name[2:]}" for name in self.names if "_px_" not in name]
        return table.select(*self.names, *speeds).to_numpy()


def _shifts(fit: Sequence[Parameter], x: Array) -> dict[str, float]:
    """What shifts the predictions, by fields."""
    return {p.field: v for p, v in zip(fit, x.tolist(), strict=True) if p.shifts}


def robot_preset(found: Identified) -> dict[str, Any]:
    """The robot's fields that were found, as a file for `robot.realism`."""
    block: dict[str, Any] = {}
    for p, v in zip(found.parameters, found.values.tolist(), strict=True):
        if p.field.startswith("robot."):
            *path, last = p.field.split(".")[1:]
            place = block
            for part in path:
                place = place.setdefault(part, {})
            value = p.value(found.scenario, v)
            digits = [float(f"{one:.6g}") for one in np.atleast_1d(value)]
            place[last] = digits if isinstance(value, list) else digits[0]
    return block


def overrides(found: Identified) -> dict[str, float]:
    """The scenario's other fields that were found, by their paths."""
    shifts = _shifts(found.parameters, found.values)
    given = {"camera.latency_s": max(found.latency_s + shifts.get(STAMPS, 0.0), 0.0)}
    if COMMAND_LATENCY in shifts:
        given[COMMAND_LATENCY] = max(shifts[COMMAND_LATENCY], 0.0)
    if "markers" in found.noise:
        given["noise.pixel_sigma_px"] = found.noise["markers"]
    return {name: float(f"{v:.4g}") for name, v in given.items()}


INTERVAL = (
    "The intervals are as wide as what is left of the prediction errors makes them,"
    " by how long these go on and by how far the parts of the record disagree. Of a robot that has"
    " what the model lacks, they are intervals of the values with which the model fits best."
)


def tested(found: Identified) -> str:
    """How well parts of the record are predicted that were left out of the fit, in a sentence."""
    words = (
        "Each eighth of the record is predicted by the rest of it with errors of"
        f" {found.residual:.3g} times the sensors' noise (RMS)"
    )
    if found.residual < MISFIT:
        return f"{words}; 1 is all that can be asked for."
    return f"{words}: the robot has what this model lacks, and what was found may be wrong."


def lines_of(found: Identified) -> list[list[str]]:
    """Each parameter with its value and its interval."""
    lines = []
    for p, v, h in zip(found.parameters, found.values, found.half, strict=True):
        name = f"{p.field} (factor)" if p.factor else p.field
        value = f"{v:.5g}"
        if min(v - p.low, p.high - v) < 1e-3 * (p.high - p.low) and p.field != STAMPS:
            value += " at its bound"
        lines.append([name, value, f"{v - h:.5g} to {v + h:.5g}"])
    return lines


def write(folder: Path, found: Identified, source: str, command: str) -> Path:
    """Write `robot.yaml` (for `robot.realism`), and the page, into a folder; the page's path."""
    preset = folder / "robot.yaml"
    text = f"# found in {source}; robot.realism: this file\n{as_yaml(robot_preset(found))}"
    write_whole(preset, text)
    sets = " ".join(f"--set {name}={v:g}" for name, v in overrides(found).items())
    sentences = [tested(found), INTERVAL]
    for a, b, c in found.together:
        sentences.append(
            f"{a} and {b} are not told apart by this record (cosine of what they change {c:.4f}): "
            f"only their {'sum' if c > 0 else 'difference'} is known."
        )
    for name, s in found.noise.items():
        sentences.append(
            f"Noise of the {name}: {s:.3g} {'px' if name == 'markers' else 'rad or m'}."
        )
    sentences.append(
        f"Pictures come {1e3 * found.latency_s:.1f} ms after their stamps (median),"
        f" which are {1e3 * found.jitter_s:.2f} ms uneven."
    )
    head = "The simulator reads what the robot read"
    state = "good"
    if not found.residual < MISFIT:  # also where it is not known
        head = "The simulator does not read what the robot read"
        state = "open"
    elif found.together:
        head = "Not all is told apart"
        state = "open"
    tables = [("What was found", ["Parameter", "Value", "95 % interval"], lines_of(found))]
    with style():
        drawn = publish(_drawn(found), "predicted", "Readings and predictions", None)
    return write_page(
        folder,
        "study.html",
        f"Identification from {source}",
        outcome=(head, state, sentences),
        take=f"vstestbed run {found.scenario.name} --set robot.realism={preset} {sets}",
        plots=[("Read, and predicted", drawn, CAPTION)],
        tables=tables,
        command=command,
    )


CAPTION = (
    "Dots: what was read; lines: what the simulator predicts with the numbers found;"
    " both less the first reading."
)


def _drawn(found: Identified) -> Figure:
    drawn = new_figure(4.4, 7.16)
    t = found.record["t"].to_numpy()
    kinds = {"q_": "joints [rad, m]", "u_px_": "markers u [px]"}
    for axes, (start, label) in zip(drawn.subplots(2, 1, sharex=True), kinds.items(), strict=True):
        those = [i for i, name in enumerate(found.names) if name.startswith(start)][:7]
        for k, i in enumerate(those):
            colour = LINE_COLORS[k % len(LINE_COLORS)]
            origin = found.measured[0, i]
            axes.plot(t, found.measured[:, i] - origin, ".", markersize=2, color=colour)
            axes.plot(t, found.predicted[:, i] - origin, color=colour, linewidth=0.8)
        axes.set_ylabel(label)
    drawn.axes[-1].set_xlabel("time [s]")
    return drawn
