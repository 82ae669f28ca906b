"""Loss of sight, of pictures, of the law: every robot comes to rest within stated bounds, and the
outcome says why.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.core.geometry import Array
from vstestbed.robots.base import STOP_S
from vstestbed.robots.puma560 import SPEED_LIMITS
from vstestbed.sim.base import IdealPlant, Plant
from vstestbed.sim.plant import MujocoPlant
from vstestbed.timing.plan import Planned, Shutter
from vstestbed.vision.base import Detection
from vstestbed.vision.oracle import Oracle

LATENCY_S, TIMEOUT_S = 0.04, 0.3
BLACK_FRAME = 30
TIMING = {
    "detector": "oracle",
    "camera.latency_s": LATENCY_S,
    "timing.command_timeout_s": TIMEOUT_S,
}


class Way:
    """What a plant does in truth, at every call: times, speeds of the camera, its positions,
    controls.
    """

    def __init__(self) -> None:
        self.t: list[float] = []
        self.x: list[Array] = []

    def watch(self, monkeypatch: pytest.MonkeyPatch) -> None:
        for plant in (MujocoPlant, IdealPlant):
            monkeypatch.setattr(plant, "advance", self._stepped(plant.advance))

    def _stepped(self, advance: Callable[[Any, int], bool]) -> Callable[[Any, int], bool]:
        def stepped(plant: Plant, steps: int) -> bool:
            most = max(1, round(0.01 / plant.step_s))  # 10 ms
            while steps > 0:
                ahead = min(most, steps)
                if not advance(plant, ahead):
                    return False
                steps -= ahead
                self.t.append(plant._steps * plant.step_s)  # type: ignore[attr-defined] - both plants have it
                self.x.append(plant.truth().T_world_camera[:3, 3].copy())
            return True

        return stepped

    def since(self, t: float) -> tuple[float, float]:
        """From a time [s] on: the camera's way [m],
        and how long it moved faster than 2 cm/s [s].
        """
        times, x = np.array(self.t), np.array(self.x)
        after = times >= t - 1e-9
        steps = np.linalg.norm(np.diff(x[after], axis=0), axis=1)
        moving = np.flatnonzero(steps / np.diff(times[after]) > 0.02)
        return float(steps.sum()), float(times[after][moving[-1] + 1] - t) if len(moving) else 0.0


@pytest.fixture
def way(monkeypatch: pytest.MonkeyPatch) -> Way:
    found = Way()
    found.watch(monkeypatch)
    return found


def black_from(monkeypatch: pytest.MonkeyPatch, frame: int) -> None:
    """The oracle finds nothing in pictures from this one on, as a detector in black ones."""
    real, taken = Oracle.detect, iter(range(10**6))

    def detect(self: Oracle, *given: Any) -> tuple[None, Detection]:
        found = real(self, *given)[1]
        return None, found if next(taken) < frame else Detection(np.full_like(found.uv, np.nan))

    monkeypatch.setattr(Oracle, "detect", detect)


def shutter_that(monkeypatch: pytest.MonkeyPatch, change: Callable[[Planned], Planned]) -> None:
    """Pictures whose plan is changed."""
    real = Shutter.following
    monkeypatch.setattr(
        Shutter, "following", lambda shutter, exposure_s=None: change(real(shutter, exposure_s))
    )


def bound(
    scenario: vs.Scenario, speed: float, blind_s: float, blind_m: float = np.inf
) -> tuple[float, float]:
    """Stated bounds on time [s] and way [m] to rest at a speed [m/s], when the stop is ordered
    after `blind_s` or `blind_m`.
    """
    robot = scenario.robot
    stop_s = {"free": 0.0, "puma560": STOP_S, "car": speed / 1.5 + 0.1, "quadrotor": 2.0}.get(
        robot.kind
    ) or getattr(robot, "stop_s", 0.0)
    order_s = min(blind_s, blind_m / max(speed, 1e-9)) + scenario.camera.period + LATENCY_S
    lag_s = 0.15  # of servos and springs
    return order_s + stop_s + lag_s, speed * (order_s + stop_s / 2 + lag_s)


def speed_before(r: vs.Recording, frame: int) -> float:
    """The largest true speed of the camera up to a frame [m/s], for limits that no robot may exceed
    afterwards.
    """
    return float(
        np.linalg.norm(np.column_stack([r[f"act_v{a}"] for a in "xyz"]), axis=1)[: frame + 1].max()
    )


@pytest.mark.parametrize(
    "name", ["arm_ibvs", "ibvs_book", "omni_ibvs", "car_pursuit", "arm_track_circle"]
)
def test_black_pictures_stop_a_robot_whose_law_rests_or_coasts(
    name: str, monkeypatch: pytest.MonkeyPatch, way: Way
):
    scenario = vs.load(name, TIMING)
    black_from(monkeypatch, BLACK_FRAME)
    r = vs.run(scenario)
    last_good = (BLACK_FRAME - 1) * scenario.camera.period
    assert r.outcome is vs.Outcome.target_lost
    assert "in sight for 1 s" in r.reason and r.reason.endswith("; the robot stands")
    np.testing.assert_array_equal(np.unique(r["supervisor"][:BLACK_FRAME]), [0])
    assert r["supervisor"][BLACK_FRAME] == 1 and r["supervisor"][-1] == 2
    # The laws that coast do so for a second at most, the others rest at once; `lost_after_s` bounds
    # both.
    coasts = name in ("car_pursuit", "arm_track_circle")
    longest_s, farthest_m = bound(
        scenario, speed_before(r, BLACK_FRAME + 1), 1.0 if coasts else 0.0
    )
    walked, took = way.since(last_good)
    assert 0 < walked <= farthest_m and took <= longest_s


@pytest.mark.parametrize("limits", [{"stop.lost_after_m": 0.4}, {"stop.lost_after_s": 0.4}])
def test_a_car_drives_by_odometry_alone_no_farther_than_stated(
    limits: dict[str, float], monkeypatch: pytest.MonkeyPatch, way: Way
):
    scenario = vs.load("car_pbvs", TIMING | {"stop.lost_after_s": 5} | limits)
    black_from(monkeypatch, BLACK_FRAME)
    r = vs.run(scenario)
    assert r.outcome is vs.Outcome.target_lost
    said = "0.4 m of the way" if "stop.lost_after_m" in limits else "0.4 s"
    assert r.reason.startswith(f"no marker was in sight for {said}; ")
    assert r.reason.endswith("; the robot stands")
    speed = speed_before(r, BLACK_FRAME)
    longest_s, farthest_m = bound(
        scenario, speed, scenario.stop.lost_after_s, scenario.stop.lost_after_m
    )
    walked, took = way.since((BLACK_FRAME - 1) * scenario.camera.period)
    assert 0.3 < walked <= farthest_m and took <= longest_s
    # It goes on by odometry before, and slows down at no more than its limit of 1.5 m/s^2.
    assert r["supervisor"][BLACK_FRAME + 5] == 1 and np.abs(r["cmd_vz"][BLACK_FRAME + 5]) > 0.1
    assert np.diff(np.array(r["ctrl_drive"])).min() * 0.15 / scenario.camera.period > -1.5 * 1.2


def test_by_too_few_landmarks_it_drives_no_farther(monkeypatch: pytest.MonkeyPatch):
    """One landmark of five fixes no place: the car is at its dead reckoning all the same."""
    real, taken = Oracle.detect, iter(range(10**6))

    def detect(self: Oracle, *given: Any) -> tuple[None, Detection]:
        found = real(self, *given)[1]
        if next(taken) < BLACK_FRAME:
            return None, found
        return None, Detection(np.where(np.arange(len(found.uv))[:, None] == 1, found.uv, np.nan))

    monkeypatch.setattr(Oracle, "detect", detect)
    r = vs.run(vs.load("car_pbvs", TIMING | {"stop.lost_after_m": 0.4, "law.depth": "pnp"}))
    assert r.outcome is vs.Outcome.target_lost
    assert r.reason.startswith(
        "too few markers were in sight for 0.4 m of the way; markers 0, 2, 3, 4 were "
    )


def test_a_craft_without_sight_holds_and_sets_down(monkeypatch: pytest.MonkeyPatch, way: Way):
    scenario = vs.load("quadrotor_hover", TIMING | {"stop.lost_after_s": 0.5})
    black_from(monkeypatch, BLACK_FRAME)
    r = vs.run(scenario)
    assert r.outcome is vs.Outcome.target_lost and r.reason.endswith("; the craft set down")
    x, t = np.array(way.x), np.array(way.t)
    at = np.searchsorted(t, (BLACK_FRAME - 1) * scenario.camera.period)
    away = np.linalg.norm(x[:, :2] - x[at, :2], axis=1)[at:].max()
    assert away <= bound(scenario, speed_before(r, BLACK_FRAME), 0.0)[1]


def test_the_arm_stops_within_its_limits_and_not_at_once(monkeypatch: pytest.MonkeyPatch):
    scenario = vs.load(
        "arm_ibvs", {"detector": "oracle", "law.gain": 2, "robot.actuation": "ideal"}
    )
    black_from(monkeypatch, 10)
    r = vs.run(scenario)
    ctrl = np.column_stack([r[f"ctrl_joint_{i}"] for i in range(1, 7)])
    rate = np.abs(np.diff(ctrl[10:], axis=0)) / scenario.camera.period
    assert np.abs(ctrl[10]).max() > 0.3  # it was under way
    assert (rate <= SPEED_LIMITS / STOP_S + 1e-9).all()
    assert np.abs(ctrl[13]).max() > 0 and not ctrl[18:].any()  # a ramp of a quarter of a second
    # as a whole
    np.testing.assert_allclose(
        ctrl[13] / np.linalg.norm(ctrl[13]), ctrl[10] / np.linalg.norm(ctrl[10]), atol=1e-12
    )


@pytest.mark.parametrize("name", one_quick("arm_ibvs", "ibvs_book", "omni_ibvs", "car_pbvs"))
def test_a_dead_camera_stops_the_robot_and_ends_the_run(
    name: str, monkeypatch: pytest.MonkeyPatch, way: Way
):
    scenario = vs.load(name, TIMING | {"stop.lost_after_s": 1.0})
    never = 10**9
    shutter_that(
        monkeypatch,
        lambda p: (
            p if p.frame < BLACK_FRAME else p._replace(opens=(never,), middle=never, arrives=never)
        ),
    )
    r = vs.run(scenario)
    assert len(r.table) == BLACK_FRAME
    assert (r.outcome, r.reason) == (
        vs.Outcome.target_lost,
        "no picture arrived for 1 s; the robot stands",
    )
    longest_s, farthest_m = bound(scenario, speed_before(r, BLACK_FRAME - 1), TIMEOUT_S)
    walked, took = way.since((BLACK_FRAME - 1) * scenario.camera.period)
    assert 0 < walked <= farthest_m and took <= longest_s
    assert way.t[-1] <= r["t"][-1] + LATENCY_S + TIMEOUT_S + 1.0 + 2 * scenario.camera.period


def test_a_camera_that_never_delivers_ends_the_run_too(monkeypatch: pytest.MonkeyPatch):
    shutter_that(monkeypatch, lambda p: p._replace(arrives=10**9))
    r = vs.run(vs.load("car_pbvs", TIMING | {"stop.duration_s": 20}))
    assert len(r.table) == 0
    assert (r.outcome, r.reason) == (
        vs.Outcome.target_lost,
        "no picture arrived for 5 s, from the start on; the robot stands",
    )
    r = vs.run(vs.load("ibvs_book", TIMING | {"stop": {"duration_s": 2, "lost_after_s": 60}}))
    assert r.outcome is vs.Outcome.timed_out


@pytest.mark.study
def test_a_craft_whose_camera_is_dead_sets_down(monkeypatch: pytest.MonkeyPatch):
    never = 10**9
    shutter_that(
        monkeypatch,
        lambda p: (
            p if p.frame < BLACK_FRAME else p._replace(opens=(never,), middle=never, arrives=never)
        ),
    )
    start = {"robot.start.nominal": {"xyz": [0.2, 0, 1.2]}, "stop.lost_after_s": 0.5}
    r = vs.run(vs.load("quadrotor_hover", TIMING | start))
    assert r.outcome is vs.Outcome.target_lost
    assert r.reason.startswith("no picture arrived for 0.5 s at")
    assert r.reason.endswith("; the craft set down")


def test_pictures_that_come_ever_later_are_none(monkeypatch: pytest.MonkeyPatch, way: Way):
    # From frame 30 on, each picture is 60 ms later than the one before: the law's pictures get old,
    # but still arrive.
    shutter_that(
        monkeypatch, lambda p: p._replace(arrives=p.arrives + 30 * max(0, p.frame - BLACK_FRAME))
    )
    r = vs.run(vs.load("arm_ibvs", TIMING))
    assert (
        r.outcome is vs.Outcome.target_lost
        and "pictures arrived" in r.reason
        and "s late" in r.reason
    )
    late = (r["t_cmd"] - r["t"]) > LATENCY_S + TIMEOUT_S + 1e-9
    assert late.any() and not late.all()
    np.testing.assert_array_equal(r["supervisor"] > 0, late)


def test_dropped_pictures_within_the_timeout_change_nothing(monkeypatch: pytest.MonkeyPatch):
    shutter_that(monkeypatch, lambda p: p)
    r = vs.run(vs.load("arm_ibvs", {"detector": "oracle", "timing.drop_probability": 0.5}))
    assert r.outcome is vs.Outcome.converged and not r["supervisor"].any()


class TestLawThatFails:
    STUDIES = tuple(
        pytest.param(name, fails, marks=pytest.mark.study)
        for fails, names in (
            ("raises", ("ibvs_book", "omni_ibvs", "car_pbvs", "quadrotor_hover")),
            ("nan", ("arm_ibvs",)),
        )
        for name in names
    )

    @pytest.mark.parametrize(
        ("name", "fails"),
        [("arm_ibvs", "raises"), ("ibvs_book", "nan"), *STUDIES],  # it ends a run at the same place
    )
    def test_the_robot_stops_and_the_outcome_names_the_law(
        self, name: str, fails: str, monkeypatch: pytest.MonkeyPatch, way: Way
    ):
        scenario = vs.load(
            name,
            TIMING
            | (
                {"robot.start.nominal": {"xyz": [0.2, 0, 1.2]}} if name == "quadrotor_hover" else {}
            ),
        )
        law, asked = type(scenario.law), iter(range(10**6))
        step = law.step

        def failing(self: Any, *given: Any) -> Any:
            state, command = step(self, *given)
            if next(asked) < BLACK_FRAME:
                return state, command
            if fails == "raises":
                raise ZeroDivisionError("float division by zero")
            return state, replace(command, twist=np.full(6, np.nan))

        monkeypatch.setattr(law, "step", failing)
        r = vs.run(scenario)
        assert r.outcome is vs.Outcome.law_failed and not r.outcome.success
        words = (
            "raised ZeroDivisionError: float division by zero (test_loss_of_sight.py, line"
            if fails == "raises"
            else "not finite, [nan"
        )
        assert r.reason.startswith(f"law {scenario.law.kind} ") and words in r.reason
        assert next(asked) == BLACK_FRAME + 1  # it is not asked again
        if scenario.robot.base == "floating":
            assert r.reason.endswith("; the craft set down")
            return
        assert r.reason.endswith("; the robot stands")
        longest_s, farthest_m = bound(scenario, speed_before(r, BLACK_FRAME), 0.0)
        walked, took = way.since((BLACK_FRAME - 1) * scenario.camera.period)
        assert walked <= farthest_m and took <= longest_s
