"""Measured gain limits against the discrete loop; the command and its folder."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import polars as pl
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed import Timing
from vstestbed.apps.maps.commands import _summary_line
from vstestbed.apps.maps.delay import (
    OFF,
    OFF_WITH_FRICTION,
    Lag,
    Limit,
    _warn_unless_linear,
    delays_of,
    displaced,
    find_limit,
    find_limits,
    growth,
    measure_lags,
    prepared,
)
from vstestbed.cli import app as cli
from vstestbed.core.errors import ParameterError
from vstestbed.laws.feedforward import Smith
from vstestbed.loop.stability import closed_form, gain_limit
from vstestbed.scenario.scenario import Scenario
from vstestbed.timing.clock import CameraStamps

PERIOD = 0.04


@pytest.fixture(scope="module")
def free() -> Scenario:
    return prepared(vs.load("ibvs_book", {"camera.rate_hz": 25}))


@pytest.fixture(scope="module")
def arm() -> Callable[[str], Scenario]:
    at_goal = prepared(vs.load("arm_ibvs", {"robot.actuation": "ideal"}))
    start = at_goal.robot.start
    return lambda actuation: vs.load(
        "arm_ibvs",
        {
            "robot": {
                "kind": "puma560",
                "actuation": actuation,
                "start": {"nominal": {"q_deg": list(start.nominal.q_deg)}},
            },
            "detector": {"kind": "oracle", "field_of_view": "unlimited"},
        },
    )


@pytest.mark.parametrize("d", [0, 5])
def test_the_ideal_camera_goes_unstable_where_theory_says(free, d):
    start, g = displaced(free), closed_form(d)
    # The bound is 5 %; it is a tenth of that (the study below).
    assert growth(start, 0.98 * g / PERIOD, d) < 1 < growth(start, 1.02 * g / PERIOD, d)


@pytest.mark.parametrize("between", one_quick("ramp", "smooth"))
@pytest.mark.parametrize("d", [0, 2])
def test_commands_that_are_led_to_cost_half_a_period_of_the_delay_margin(free, d, between):
    """At the limit of held commands the loop grows, and it is stable up to its own, 2 tan(pi / (4
    (d + 1))): 0.536 instead of 0.618.
    """
    start, g = displaced(free), 2 * np.tan(np.pi / (4 * (d + 1)))
    led = replace(start, timing=Timing(interpolation=between, command_hz=100))
    assert growth(led, 0.97 * g / PERIOD, d) < 1 < growth(led, 1.03 * g / PERIOD, d)
    if d:
        assert (
            growth(start, 0.95 * closed_form(d) / PERIOD, d)
            < 1
            < growth(led, 0.95 * closed_form(d) / PERIOD, d)
        )


def test_a_predictor_whose_stamps_are_those_of_the_arrival_is_none():
    """Beyond the limit of the loop without prediction, a Smith predictor keeps it stable, if it
    knows the age of its pictures.
    """
    start = displaced(
        prepared(vs.load("ibvs_book", {"camera.rate_hz": 25, "law.feedforward": "smith"}))
    )
    gain = 1.3 * closed_form(2) / PERIOD
    stamps = {
        by: replace(start, timing=Timing(camera_clock=CameraStamps(stamped=by)))
        for by in ("middle", "arrival")
    }
    assert growth(stamps["middle"], gain, 2) < 1 < growth(stamps["arrival"], gain, 2)


@pytest.mark.usefixtures("own_kinds")
def test_a_law_whose_gain_falls_with_the_error_has_the_limit_of_its_gain_at_the_goal(
    free, caplog, monkeypatch
):
    """Over it the loop swings at the size at which its gain is that of the limit, which is no
    stable loop.
    """
    points = vs.features.Point()

    @vs.LAWS.add
    @vs.spec
    class Soft(vs.ErrorLaw):
        """The law of points, whose gain falls with the error: lambda / (1 + |e| / 0.01)."""

        kind: Literal["soft"] = "soft"
        inputs = ("xy", "depth")

        def equations(self, view, goal):
            e = points.measure(view.xy) - points.measure(goal.xy)
            return e / (1 + np.linalg.norm(e) / 0.01), points.interaction(view.xy, view.depth)

    soft = replace(free, law=Soft())
    assert find_limit(soft, 1).g == pytest.approx(1.0, rel=0.02)
    _warn_unless_linear(soft)
    assert not caplog.text
    monkeypatch.setattr("vstestbed.apps.maps.delay.OFF", 0.02)  # that of joints with friction
    _warn_unless_linear(soft)
    assert "the law's gain depends on the error" in caplog.text


def test_bisection_lands_on_the_limit(free):
    limit = find_limit(free, 1)
    assert limit.g == pytest.approx(1.0, rel=0.003)  # the bracket that is left
    assert limit.gain == pytest.approx(25.0, rel=0.003) and limit.g_lag is None and limit.runs == 11


@pytest.mark.parametrize(
    ("d", "timing"),
    one_quick((0.6, Timing()), (1.5, Timing()), (1, Timing(command_latency_s=0.02))),
)
def test_a_delay_of_part_of_a_frame_and_of_commands_goes_unstable_where_theory_says(
    free, d, timing
):
    at_goal = replace(free, timing=timing)
    limit = find_limit(at_goal, d)
    assert limit.g / limit.g_theory == pytest.approx(1.0, rel=0.004)
    # the part of a frame, or the command's latency, lowers it
    assert limit.g < 0.9 * closed_form(int(d))


def test_the_scenarios_own_latency_comes_first_in_seconds(free):
    late = replace(free, camera=replace(free.camera, latency_s=0.06))
    assert delays_of(late, [0, 1]) == [1.5, 0, 1] and delays_of(free, [0, 1]) == [0, 1]
    assert delays_of(replace(free, camera=replace(free.camera, latency_s=PERIOD)), [0, 1, 2]) == [
        1,
        0,
        2,
    ]
    with pytest.raises(
        ParameterError,
        match=r"camera\.latency_s must be at most 2 s, which are 50 frames at 25 Hz, got 3",
    ):
        delays_of(replace(free, camera=replace(free.camera, latency_s=3.0)), [0])


def test_an_arm_with_ideal_servos_goes_unstable_where_theory_says(arm):
    start, g = displaced(arm("ideal")), closed_form(2)
    assert growth(start, 0.97 * g / PERIOD, 2) < 1 < growth(start, 1.03 * g / PERIOD, 2)


def test_an_arm_with_industrial_servos_goes_unstable_where_their_lag_says(arm):
    at_goal = arm("industrial")
    lags = measure_lags(at_goal, 2, OFF_WITH_FRICTION)
    # Integrating servos rise in 40 ms; at the swing of the limit they lag by 27 to 40 ms.
    assert all(0.02 < lag.lag_s < 0.05 and 0.85 < lag.gain < 1.05 for lag in lags)
    g = min(gain_limit(2, lag.shares) for lag in lags)
    assert g < 0.9 * closed_form(2)  # a shift that theory without lag does not explain
    start = displaced(at_goal)
    assert growth(start, 0.95 * g / PERIOD, 2) < 1 < growth(start, 1.05 * g / PERIOD, 2)


@pytest.mark.parametrize("actuation", one_quick("industrial", "ideal"))
def test_with_a_predictor_the_limit_of_an_arm_is_that_without_delay(arm, actuation):
    """docs/results/constraints.md: Smith's predictor with the encoders' motion takes the delay out,
    so that the lag of the servos is left; with ideal ones nothing is, and the limit is two a
    period, as deadbeat control with overshoot of the whole error.
    """
    plain = arm(actuation)
    limit = 2 / PERIOD if actuation == "ideal" else 37.3  # the table's, without delay and predictor
    start = displaced(replace(plain, law=replace(plain.law, feedforward=Smith())))
    assert growth(start, 0.95 * limit, 3) < 1 < growth(start, 1.05 * limit, 3)
    assert growth(displaced(plain), 0.95 * limit, 0) < 1 < growth(displaced(plain), 1.05 * limit, 0)
    assert growth(displaced(plain), 0.3 * limit, 3) > 1  # without the predictor


@pytest.mark.study
def test_servos_that_move_against_a_fast_swing_are_measured_at_a_slower_one():
    """Without delay the first guess is a swing of two frames; these servos lag by nearly one: b_0 +
    b_1 is below 0 there.
    """
    lags = measure_lags(prepared(vs.load("arm_docking")), 0, OFF_WITH_FRICTION)
    assert all(0.85 < sum(lag.shares) < 1.05 and 0.5 * PERIOD < lag.lag_s < PERIOD for lag in lags)


def test_ideal_servos_hardly_lag(arm):
    for lag in measure_lags(arm("ideal"), 2, OFF):
        assert lag.shares == pytest.approx((1.0, 0.0), abs=0.01) and abs(lag.lag_s) < 0.5e-3


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        ("omni_ibvs", {}, "must be free or puma560"),
        ("partitioned_book", {}, "one gain for all directions"),
        ("camera_photometric", {}, "works on whole pictures"),
        ("arm_insert", {}, "must be velocity or computed_torque"),
        ("ibvs_retreat", {"goal.T_camera_target": {"xyz": [0, 0, 1]}}, None),
    ],
)
def test_what_has_no_such_limit_is_refused(name, settings, words):
    scenario = vs.load(name, settings)
    if words is None:
        assert prepared(scenario).robot.start.nominal.xyz[2] == pytest.approx(
            scenario.T_world_goal[2, 3]
        )
        return
    with pytest.raises(ParameterError, match=words):
        prepared(scenario)


def command(words: list[str]) -> int:
    with pytest.raises(SystemExit) as ended:
        cli.main(words)
    return int(ended.value.code or 0)


def test_command_leaves_its_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "study"
    words = [
        "gain-limit",
        "ibvs_book",
        "--frames",
        "1",
        "--set",
        "camera.rate_hz=20",
        "--set",
        "law.gain=0.8",
        "--out",
        str(out),
        "--json",
    ]
    assert command(words) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["delay_frames"] for row in rows] == [1]
    assert [row["gain_limit"] for row in rows] == pytest.approx([20], rel=0.005)  # 1 over .05 s
    assert {p.name for p in out.iterdir()} == {
        "delay.csv",
        "delay.parquet",
        "delay.json",
        "delay.png",
        "delay.svg",
        "delay.pdf",
        "report.html",
    }
    assert pl.read_parquet(out / "delay.parquet")["measured_to_theory"].to_list() == pytest.approx(
        [1], rel=0.005
    )
    page = (out / "report.html").read_text()
    assert "gain limit [1/s]" in page and "data:image/png" in page
    assert command(words) == 2  # never over an older study
    assert command(["gain-limit", "ibvs_book", "--frames", "one"]) == 2


def test_the_command_names_the_answer_in_seconds_first_and_says_why_the_theory_is_off(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    words = [
        "gain-limit",
        "ibvs_book",
        "--frames",
        "1",
        "--set",
        "camera.rate_hz=25",
        "--set",
        "camera.latency_s=0.06",
    ]
    assert command([*words, "--out", str(tmp_path / "study")]) == 0
    first, second = capsys.readouterr().err.splitlines()[:2]
    assert first.startswith("0.06 s (1.5 frames): unstable from 20.7")
    assert second.startswith("0.04 s (1 frame): unstable from 25.0")
    lags = (Lag("a", (0.4, 0.6), 0.028, 1.0, 0.16), Lag("b", (0.9, 0.1), 0.004, 1.0, 0.16))
    panda = Limit(0, 0.0, 29.6, 1.184, 2.0, 1.57, lags, 11, g_linear=1.19)
    told = _summary_line(panda)
    assert (
        "0.592 of theory for the delay alone, since its servos lag;"
        " 0.754 of theory with their lag (a by 28.0 ms), 0.995 of a linear" in told
    )
    assert "not explained" not in told
    assert "not explained" in _summary_line(replace(panda, g_linear=1.9))


@pytest.mark.study
@pytest.mark.parametrize(
    ("name", "settings", "of_theory", "of_lag"),
    [
        ("ibvs_book", {"camera.rate_hz": 25}, [0.005] * 6, None),
        ("arm_ibvs", {"robot.actuation": "ideal"}, [0.05] * 6, [0.02] * 6),
        # Without delay the swing is so quick (4 frames) that friction decides more than two numbers
        # can tell.
        ("arm_ibvs", {"robot.actuation": "industrial"}, None, [0.08, 0.03, 0.03, 0.03, 0.03, 0.03]),
    ],
)
def test_limits_from_no_delay_to_five_frames(name, settings, of_theory, of_lag):
    limits = find_limits(vs.load(name, settings), range(6), lambda limit: print(limit.row()))
    if of_theory:
        assert np.all(
            [abs(x.g / x.g_theory - 1) < bound for x, bound in zip(limits, of_theory, strict=True)]
        )
    if of_lag:
        assert np.all(
            [
                x.g_lag is not None and abs(x.g / x.g_lag - 1) < bound
                for x, bound in zip(limits, of_lag, strict=True)
            ]
        )


def test_noise_is_switched_off_with_a_word_and_a_law_that_takes_no_larger_gain_says_so(
    caplog: pytest.LogCaptureFixture,
) -> None:
    noisy = prepared(vs.load("ibvs_book", {"camera.rate_hz": 25, "noise.pixel_sigma_px": 0.5}))
    assert (
        noisy.noise == vs.load("ibvs_book").noise and "without the scenario's noise" in caplog.text
    )
    law = noisy.law

    class Small(type(law)):  # pyright: ignore[reportGeneralTypeIssues, reportUntypedBaseClass] - the class of the law
        """A law whose gain is at most 3 1/s."""

        def __post_init__(self) -> None:
            if self.gain.value > 3:
                raise ParameterError.bound("gain", "<=", 3, self.gain.value)

    small = replace(noisy, law=vs.spec(Small)(gain=2.0))
    with pytest.raises(
        ParameterError,
        match=r"law\.gain must be <= 3: the gain limit is beyond what law ibvs takes",
    ):
        find_limit(small, 1)
