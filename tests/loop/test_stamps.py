"""Clocks of the camera and of the robot that are wrong: what the log, the controller and the laws
get of them.
"""

from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.loop.controller import Controller
from vstestbed.loop.ego_motion import Exposure
from vstestbed.tasks.frame import Cycle
from vstestbed.timing.clock import CameraStamps, RobotStamps

ORACLE = {"detector": {"kind": "oracle", "field_of_view": "unlimited"}}
LATE = ORACLE | {"camera.rate_hz": 25, "camera.latency_s": 0.06, "stop.duration_s": 3}


def heard(
    monkeypatch: pytest.MonkeyPatch, name: str, settings: dict[str, Any]
) -> tuple[Any, list[tuple[Exposure, float, Cycle]]]:
    """A run, and what its controller was given and made of it."""
    kept, arrive = [], Controller.arrive

    def overhear(
        self: Controller, shot: Exposure, t: float, t_cmd: float, reading: vs.Reading
    ) -> Cycle:
        cycle = arrive(self, shot, t, t_cmd, reading)
        kept.append((shot, t, cycle))
        return cycle

    with monkeypatch.context() as patch:
        patch.setattr(Controller, "arrive", overhear)
        return vs.run(vs.load(name, settings)), kept


def test_the_clocks_in_closed_form():
    assert CameraStamps(offset_s=0.1, drift_ppm=500).at(200.0) == pytest.approx(200.2)
    robot = RobotStamps(offset_s=-0.1, drift_ppm=-1000)
    assert robot.true(robot.offset_s + 50 * (1 - 1e-3)) == pytest.approx(50.0)


class TestTheCamerasClock:
    @pytest.mark.parametrize("jitter", ["uniform", "normal"])
    def test_the_log_has_offset_drift_and_jitter(self, jitter: str):
        clock = {"offset_s": -0.03, "drift_ppm": 2000, "jitter_s": 0.002}
        r = vs.run(
            vs.load(
                "ibvs_book",
                LATE
                | {
                    "timing.camera_clock": clock,
                    "timing.jitter": jitter,
                    "stop.duration_s": 20,
                    "law.gain": 0.05,
                },
            )
        )
        t, error = r["t"], r["t_stamp"] - r["t"]
        rest = error - (-0.03 + 2e-3 * t)
        # true times stay what they were
        assert len(t) > 450 and np.allclose(t * 25, np.round(t * 25))
        slope = np.polyfit(t, error, 1)[0]
        assert slope == pytest.approx(2e-3, abs=4 * 0.002 / (t.std() * np.sqrt(len(t))))
        assert rest.std() == pytest.approx(
            0.002 / (np.sqrt(3) if jitter == "uniform" else 1), rel=0.1
        )
        assert jitter == "normal" or np.abs(rest).max() <= 0.002
        assert r["refused"][-1] == 0

    def test_a_driver_that_stamps_the_arrival(self, monkeypatch: pytest.MonkeyPatch):
        settings = LATE | {
            "timing.camera_clock": {"stamped": "arrival"},
            "timing.latency_jitter_s": 0.02,
        }
        r, kept = heard(monkeypatch, "ibvs_book", settings)
        np.testing.assert_allclose(r["t_stamp"], [now for _, now, _ in kept], atol=1e-12)
        assert all(shot.t == now for shot, now, _ in kept) and (r["t_stamp"] - r["t"]).std() > 0.005

    def test_a_perfect_clock_changes_no_number(self):
        for name in ("omni_ibvs", "arm_track_circle"):
            settings = ORACLE | {"camera.latency_s": 0.03, "stop.duration_s": 0.6}
            off, on = (
                vs.run(vs.load(name, settings | more)) for more in ({}, {"timing.camera_clock": {}})
            )
            for name in off.columns:
                np.testing.assert_array_equal(off[name], on[name])
            assert set(on.columns) - set(off.columns) == {"t_stamp", "refused"}
            np.testing.assert_array_equal(on["t_stamp"], on["t"])

    @pytest.mark.parametrize(
        ("clock", "age"),
        [({"offset_s": 0.02}, 0.04), ({"offset_s": -0.05}, 0.11), ({"stamped": "arrival"}, 0.0)],
    )
    def test_a_law_compensates_the_age_that_it_believes(
        self, monkeypatch: pytest.MonkeyPatch, clock: dict[str, Any], age: float
    ):
        settings = LATE | {
            "law.feedforward": "smith",
            "timing.camera_clock": clock,
            "stop.duration_s": 0.4,
        }
        _, kept = heard(monkeypatch, "ibvs_book", settings)
        ages = [
            cycle.observation.motion.age_s
            for _, _, cycle in kept
            if cycle.observation.motion is not None
        ]
        np.testing.assert_allclose(ages, age, atol=1e-9)

    def test_a_stamp_from_the_future_is_taken_for_the_arrival(
        self, monkeypatch: pytest.MonkeyPatch
    ):
        settings = LATE | {"timing.camera_clock": {"offset_s": 5.0}}
        r, kept = heard(monkeypatch, "ibvs_book", settings)
        assert all(shot.t == now for shot, now, _ in kept)
        np.testing.assert_allclose(r["t_stamp"] - r["t"], 5.0)

    def test_pictures_whose_stamps_go_back_are_refused(self):
        r = vs.run(vs.load("ibvs_book", LATE | {"timing.camera_clock": {"jitter_s": 0.05}}))
        believed = np.minimum(r["t_stamp"], r["t"] + 0.06)
        assert (np.diff(believed) > 0).all() and r["refused"][-1] > 3
        assert r.summary()["pictures_refused"] == r["refused"][-1]

    def test_stamps_too_old_to_be_true_stop_the_robot(self):
        r = vs.run(
            vs.load(
                "ibvs_book",
                LATE | {"timing.camera_clock": {"offset_s": -2.0}, "stop.duration_s": 1},
            )
        )
        assert not any(r[f"act_{name}"].any() for name in ("vx", "vy", "vz"))


class TestTheRobotsClock:
    @pytest.mark.parametrize(
        ("camera", "robot", "ahead"),
        [
            ({"offset_s": -0.02}, None, -0.02),
            (None, {"offset_s": 0.03}, -0.03),
            ({"offset_s": 0.02}, {"offset_s": -0.01}, 0.03),
            ({"stamped": "arrival"}, None, 0.06),
            (None, {"drift_ppm": 20000}, None),
            # a reading is not known before it comes: the last one is taken
            (None, {"offset_s": -1.0}, 0.06),
        ],
    )
    def test_the_reading_of_a_picture_is_that_of_the_same_stamp(
        self, monkeypatch: pytest.MonkeyPatch, camera: Any, robot: Any, ahead: Any
    ):
        """Joints that move at known speeds tell the time at which they were read."""
        clocks = {"timing.camera_clock": camera} if camera else {}
        clocks |= {"timing.robot_clock": robot} if robot else {}
        r, kept = heard(
            monkeypatch,
            "arm_ibvs",
            LATE | clocks | {"robot.actuation": "ideal", "stop.duration_s": 1.6},
        )
        assert len(kept) > 30
        for i in range(10, len(kept) - 10):
            t = r["t"][i]
            at = t + ahead if ahead is not None else t / 1.02
            q = [np.interp(at, r["t"], r[f"q_{name}"]) for name in vs.load("arm_ibvs").robot.joints]
            speed = max(abs(r[f"qd_{name}"][i]) for name in vs.load("arm_ibvs").robot.joints)
            # read every 2 ms, logged every 40
            np.testing.assert_allclose(kept[i][0].reading.q, q, atol=0.004 * speed + 1e-4)
            assert speed * 0.02 > 3 * (0.004 * speed + 1e-4)

    def test_a_robot_without_readings_has_no_such_clock(self):
        with pytest.raises(
            ScenarioError, match=r"timing\.robot_clock.*robot free has none.*camera_clock"
        ):
            vs.load("ibvs_book", {"timing.robot_clock": {"offset_s": 0.01}})


class TestOutOfOrder:
    def test_pictures_overtake_and_the_older_ones_are_refused(self):
        jitter = {"timing.latency_jitter_s": 0.06, "camera.latency_s": 0.06, "stop.duration_s": 8}
        r = vs.run(vs.load("ibvs_book", LATE | jitter | {"timing.out_of_order": True}))
        s, number = r.summary(), r["frame"]
        assert (np.diff(number) >= 1).all() and (np.diff(r["refused"]) >= 0).all()
        missing = int(number[-1]) + 1 - len(number)
        # Those that the last ones have overtaken may still be under way.
        assert (
            s["pictures_refused"] == r["refused"][-1]
            and 20 < r["refused"][-1] <= missing <= r["refused"][-1] + 2
        )
        held_back = vs.run(vs.load("ibvs_book", LATE | jitter))
        assert (
            len(held_back.table) > len(number)
            and "refused" not in held_back.columns
            and "pictures_refused" not in held_back.summary()
        )

    def test_a_real_driver_may_send_an_old_picture(self):
        black, rest = np.zeros((480, 640, 3), np.uint8), vs.Reading(np.zeros(6), np.zeros(6))
        strict, lenient = (
            Controller(vs.load("arm_ibvs", more))
            for more in ({}, {"timing": {"out_of_order": True, "latency_jitter_s": 0.05}})
        )
        for controller in (strict, lenient):
            controller.step(black, 0.0, rest)
            controller.step(black, 0.08, rest)
        with pytest.raises(ParameterError, match="when the last picture was taken"):
            strict.step(black, 0.04, rest)
        again = lenient.step(black, 0.04, rest)
        assert again.notes == (
            "the picture of 0.04 s is older than the last one, of 0.08 s: it is refused",
        )
        assert (
            again.t == 0.08
            and lenient.refused == 1
            and lenient.step(black, 0.12, rest).timing.number == 2
        )

    def test_without_jitter_nothing_overtakes(self):
        with pytest.raises(ScenarioError, match=r"timing\.out_of_order.*latency_jitter_s"):
            vs.load("ibvs_book", {"timing.out_of_order": True})
