"""Outcome `unstable`: gains just under the limit of theory converge, just over it they do not; what
only takes long is `timed_out`.
"""

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.core.outcome import Outcome
from vstestbed.loop.stability import (
    FEWEST,
    LastPart,
    closed_form,
    grows,
    period,
    reversal,
    swing,
    swing_frames,
    swings,
    to_and_fro,
)
from vstestbed.report.run.page import sentences
from vstestbed.studies.batch import simulate_batch, start_of
from vstestbed.tasks.metrics import TWIST

PERIOD_S = 0.04
NEAR = {
    "camera.rate_hz": 25,
    "robot.start": {"nominal": {"xyz": [0.03, -0.02, -1.02], "rpy_deg": [1, -1, 2]}},
    "target.pose.xyz": [0, 0, 0],
    "detector": {"kind": "oracle", "field_of_view": "unlimited"},
    "law.depth": "oracle",
}
"""The ideal camera near its goal, where the loop is linear."""
ALL_SEEN = {"detector": {"kind": "oracle", "field_of_view": "unlimited"}}
RNG = np.random.default_rng(1)


def flown(share: float, d: int, **changes: object) -> vs.Recording:
    """The ideal camera with a share of the largest stable gain, and d frames of latency."""
    return vs.run(
        vs.load(
            "ibvs_book",
            NEAR
            | {"camera.latency_s": d * PERIOD_S, "law.gain": share * closed_form(d) / PERIOD_S}
            | changes,
        )
    )


def part(
    x: np.ndarray,
    error: float | np.ndarray = 5.0,
    limited: bool = False,
    reference: np.ndarray | None = None,
) -> LastPart:
    """Commands x (n,) along one axis."""
    n = len(x)
    still = np.zeros((n, 1)) if reference is None else reference
    return LastPart(
        np.arange(n) * PERIOD_S,
        np.full(n, error),
        np.outer(x, np.eye(6)[3]),
        np.full(n, limited),
        still,
        np.array([[1, 0.1], [2, 0.1]]),
    )


@pytest.mark.parametrize("d", one_quick(1, 0, 2, 3))
def test_the_ideal_camera_is_unstable_where_theory_says(d: int):
    under, over = flown(0.95, d), flown(1.01, d, **{"stop.duration_s": 20})
    assert under.outcome is Outcome.converged
    assert (
        over.outcome is Outcome.unstable and not over.outcome.success and over.outcome.out_of_time
    )
    g = closed_form(d)
    assert reversal(swing_frames(d)) in over.reason
    assert (
        f"is {1.01 * g:.4g} a frame" in over.reason
        and f"unstable over {g:.4g} a frame ({g / PERIOD_S:.4g} 1/s)" in over.reason
    )
    assert (
        f"a delay of {d * PERIOD_S:g} s ({d} frames)" if d else "no delay"
    ) in over.reason and "at 25 Hz" in over.reason


def test_a_run_that_converged_says_for_how_long_its_command_swung():
    summary = flown(0.97, 1).summary()
    assert (
        summary["outcome"] == "converged"
        and summary["swing_frames"] == 6
        and summary["swung_s"] > 3
    )
    assert "On the way its command reversed every 3 frames, for " in sentences(summary)
    calm = flown(0.3, 1).summary()
    assert "swung_s" not in calm and "reversed" not in sentences(calm)


@pytest.mark.parametrize("limit", one_quick(None, 0.3))
@pytest.mark.parametrize("share", [0.9, 1.02])
def test_a_batch_ends_as_a_run(share: float, limit: float | None):
    recording = flown(share, 0, **{"law.limits.speed_mps": limit, "stop.duration_s": 10})
    batch = simulate_batch(recording.scenario, np.array([start_of(recording.scenario)] * 2))
    assert batch.outcome.tolist() == [recording.outcome] * 2
    assert batch.unstable[1] == (recording.reason if share > 1 else "")
    assert (recording.outcome is Outcome.unstable) is (share > 1)


class TestRobots:
    def test_an_arm_whose_lag_leaves_less_than_theory(self):
        late = ALL_SEEN | {"camera.latency_s": 0.1}
        swung = vs.run(vs.load("arm_ibvs", late | {"law.gain": 12, "stop.duration_s": 10}))
        assert (
            swung.outcome is Outcome.unstable
            and "we do not know what makes the difference" in swung.reason
        )
        assert vs.run(vs.load("arm_ibvs", late | {"law.gain": 3})).outcome is Outcome.converged

    @pytest.mark.study
    def test_friction_at_the_goal_is_no_instability(self):
        sticks = vs.run(
            vs.load("arm_ibvs", ALL_SEEN | {"stop.converged.error_px": 0.02, "stop.duration_s": 20})
        )
        assert sticks.outcome is Outcome.timed_out and sticks.reason == "20 s were not enough"
        assert 0.02 < np.median(sticks["error_px"][-100:]) < 0.5

    def test_noise_at_the_goal_is_no_instability(self):
        for gain in (3, 25):
            noisy = flown(
                gain * PERIOD_S / closed_form(0),
                0,
                **{"noise.pixel_sigma_px": 3, "stop.duration_s": 10},
            )
            assert noisy.outcome is Outcome.timed_out, gain
            assert np.median(noisy["error_px"][-100:]) > 2

    def test_a_slow_approach_is_none(self):
        assert flown(0.001, 0, **{"stop.duration_s": 5}).outcome is Outcome.timed_out

    @pytest.mark.study
    def test_an_arm_that_lags_behind_a_moving_target_is_none(self):
        lags = vs.run(
            vs.load("arm_track_circle", {"detector": "oracle", "law.feedforward": "none"})
        )
        assert (
            lags.outcome is Outcome.timed_out
            and lags.reason.startswith("out of its band")
            and lags.reason.endswith("off")
        )
        swings_too = vs.run(
            vs.load(
                "arm_track_circle",
                ALL_SEEN | {"camera.latency_s": 0.1, "law.gain": 20, "law.feedforward": "none"},
            )
        )
        assert swings_too.outcome is Outcome.unstable
        assert swings_too.reason.startswith("out of its band")

    @pytest.mark.study
    def test_a_vehicle(self):
        late = ALL_SEEN | {"camera.latency_s": 0.4, "stop.duration_s": 20}
        assert vs.run(vs.load("omni_ibvs", late | {"law.gain": 5})).outcome is Outcome.unstable
        assert vs.run(vs.load("omni_ibvs", late | {"law.gain": 1})).outcome is Outcome.converged

    @pytest.mark.parametrize(
        ("name", "gain", "detector"),
        one_quick(
            ("arm_ibvs", 30, "oracle"),
            ("arm_pbvs", 40, "oracle"),
            ("arm_ibvs", 40, "blobs"),
        ),
    )
    def test_a_gain_far_too_high_that_loses_markers_every_few_frames(
        self, name: str, gain: float, detector: str
    ):
        run = vs.run(vs.load(name, {"detector": detector, "law.gain": gain, "stop.duration_s": 12}))
        assert np.isnan(run["error_px"]).mean() > 0.2
        assert run.outcome is Outcome.unstable
        assert (
            "the command turned round " in run.reason
            and "% of the frames had no measurement" in run.reason
        )
        assert (
            f"a gain of {gain} 1/s at 25 Hz is {gain * PERIOD_S:.4g} a frame" in run.reason
            and "up to 2 a frame (50 1/s)" in run.reason
        )

    @pytest.mark.study
    def test_a_quadrotor_just_over_the_limit(self):
        late = {"detector": "oracle", "law.gain": 5, "camera.latency_s": 0.3, "stop.duration_s": 40}
        swung = vs.run(vs.load("quadrotor_hover", late))
        assert (
            swung.outcome is Outcome.unstable
            and "unstable over 0.197 a frame (4.925 1/s)" in swung.reason
        )

    @pytest.mark.study
    def test_markers_that_a_slow_loop_loses_are_no_instability(self):
        blinks = {
            "detector": "oracle",
            "noise.dropout": 0.2,
            "noise.pixel_sigma_px": 3,
            "stop.duration_s": 12,
        }
        assert vs.run(vs.load("arm_ibvs", blinks)).outcome is Outcome.timed_out
        biased = vs.run(vs.load("arm_ibvs_raw", {"detector": "oracle", "stop.duration_s": 12}))
        assert biased.outcome is Outcome.timed_out and biased.reason == "12 s were not enough"

    @pytest.mark.study
    def test_grey_levels_without_a_clean_period(self):
        swung = vs.run(vs.load("arm_photometric", {"law.gain": 60, "stop.duration_s": 5}))
        assert (
            swung.outcome is Outcome.unstable
            and "grey levels" in swung.reason
            and "unstable over 1 a frame" in swung.reason
        )

    @pytest.mark.study
    def test_grey_levels_count_as_well(self):
        swung = vs.run(vs.load("camera_photometric", {"law.gain": 60, "stop.duration_s": 6}))
        assert (
            swung.outcome is Outcome.unstable
            and "grey levels" in swung.reason
            and "in every frame" in swung.reason
        )


def test_where_it_drives_a_run_elsewhere_the_reason_says_so():
    lost = flown(1.05, 2)
    assert lost.outcome is Outcome.target_lost
    assert (
        "; before, the loop was unstable: over the last " in lost.reason
        and "lower law.gain" in lost.reason
    )


@pytest.mark.parametrize(
    ("changes", "outcome"),
    [({}, Outcome.target_lost), (NEAR | {"stop.duration_s": 0.4}, Outcome.timed_out)],
)
def test_with_too_few_frames_the_reason_names_a_gain_over_the_limit(
    changes: dict[str, object], outcome: Outcome
):
    ended = vs.run(vs.load("ibvs_book", {"law.gain": 60} | changes))
    assert ended.outcome is outcome and len(ended["t"]) < FEWEST
    rate_hz = ended.scenario.camera.rate_hz
    assert ended.reason.startswith(
        ("the camera crossed the plane of the target; ", "0.4 s were not enough; ")
    )
    assert (
        f"is {60 / rate_hz:.4g} a frame" in ended.reason
        and f"is unstable over 2 a frame ({2 * rate_hz:g} 1/s)" in ended.reason
    )
    calm = vs.run(vs.load("ibvs_book", NEAR | {"stop.duration_s": 0.4}))
    assert calm.reason == "0.4 s were not enough"


def test_commands_from_outside_are_not_judged():
    with vs.Session(vs.load("ibvs_book", NEAR | {"stop.duration_s": 4})) as session:
        frame, sign = session.reset(), 1.0
        while frame.outcome is None:
            frame, sign = session.step(np.array([0, 0, 0, sign, 0, 0])), -sign
        assert np.median(session.recording()["error_px"]) > 2
    assert frame.outcome is Outcome.timed_out


class TestPeriod:
    K = np.arange(200)

    @pytest.mark.parametrize("frames", [2, 3, 6, 10, 14, 26, 2.5, 7.4])
    def test_of_a_swing(self, frames: float):
        x = np.cos(2 * np.pi * self.K / frames + 0.3) * np.linspace(1, 2, 200)
        assert period(x[:, None]) == pytest.approx(frames, abs=0.5)

    def test_of_what_is_none(self):
        walk = np.cumsum(RNG.normal(size=(200, 6)), axis=0)
        for x in (
            RNG.normal(size=(200, 6)),
            walk,
            np.diff(RNG.normal(size=(201, 6)), axis=0),
            0.98 ** self.K[:, None],
            self.K[:, None] % 50,
        ):
            assert period(np.asarray(x, dtype=float)) == 0

    def test_it_must_come_back_four_times(self):
        assert period(np.cos(2 * np.pi * self.K / 80)[:, None]) == 0


class TestSwings:
    K = np.arange(240)
    X = np.cos(np.pi * K / 3)

    def test_a_swing_that_decays_is_none(self):
        for decay, limited, found in (
            (1.0, False, 6),
            (1.01, False, 6),
            (0.995, False, 0),
            (0.998, True, 6),
            (0.99, True, 0),
        ):
            assert swings(part(self.X * decay**self.K, limited=limited), 1.0) == found

    def test_nor_one_at_the_goal(self):
        assert swings(part(self.X, error=0.4), 1.0) == 0

    def test_nor_one_that_the_target_makes(self):
        assert swings(part(self.X, reference=self.X[:, None]), 1.0) == 0
        assert swings(part(self.X, reference=np.cos(np.pi * self.K / 40)[:, None]), 1.0) == 6


class TestToAndFro:
    N = 240
    X = np.sign(np.sin(np.cumsum(RNG.uniform(0.2, 1.2, N))))
    """At the limits, and turning round after a time that is never the same."""
    LOST = np.where(RNG.uniform(size=N) < 0.4, np.nan, 40.0)

    def count(self, share: float = 0.6, first: float = 90.0, **changes: object) -> int:
        given = {"x": self.X, "error": self.LOST, "limited": True} | changes
        return to_and_fro(part(**given), 1.0, share, first)  # pyright: ignore[reportArgumentType]

    def test_it_is_told_although_there_is_no_period(self):
        assert swings(part(self.X, error=self.LOST, limited=True), 1.0) == 0
        assert self.count() > 20

    def test_what_it_is_not(self):
        assert self.count(share=0.02) == 0  # a gain far under the limit
        assert self.count(limited=False) == 0 < self.count(limited=False, share=1.5)
        assert self.count(error=0.01 * self.LOST) == self.count(first=400.0) == 0  # at the goal
        assert self.count(error=self.LOST * np.linspace(1, 0.2, self.N)) == 0  # it comes nearer
        assert self.count(x=np.abs(self.X)) == 0  # a slow approach
        assert self.count(x=self.X * np.linspace(1, 0.2, self.N)) == 0  # a swing that decays
        # it turns round once
        assert self.count(x=np.sin(np.arange(self.N) * 2 * np.pi / self.N)) == 0
        assert self.count(reference=self.X[:, None]) == 0  # a target that moves
        assert self.count(error=np.full(self.N, np.nan)) == 0


def test_growth_without_a_swing():
    up = 1.01 ** np.arange(200)
    assert grows(part(up, error=up), 1.0) and not grows(part(up, error=up[::-1]), 1.0)
    # a command that falls: the law comes nearer by what it measures itself
    assert not grows(part(up[::-1], error=up), 1.0)
    assert not grows(part(up, error=up)._replace(away=np.array([[2.0, 1], [1.0, 1]])), 1.0)
    assert not grows(part(up, error=up, reference=up[:, None]), 1.0)


def test_the_longest_swing_of_a_log():
    n = 40 * FEWEST
    x = np.where(np.arange(n) < 10 * FEWEST, 1.0, (-1.0) ** np.arange(n))
    log = {"error_px": np.full(n, 5.0)} | {f"cmd_{name}": x for name in TWIST}
    assert swing(vs.load("ibvs_book", NEAR), log) == {
        "swung_s": pytest.approx(30 * FEWEST * PERIOD_S),
        "swing_frames": 2.0,
    }
