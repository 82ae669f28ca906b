"""The controller alone: a run's own pictures and readings give the run's orders bit for bit,
without MuJoCo; what is odd is told.
"""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError
from vstestbed.loop.episode import Episode
from vstestbed.loop.shutter import Exposed
from vstestbed.robots import Reading
from vstestbed.robots.flight import FlightEstimate, FlightReading

SPOKEN = ("t", "arrived", "picture", "at_exposure", "now", "twist", "setpoint")
ALONE = """
import pickle, sys
import numpy as np
import vstestbed as vs
for file in sys.argv[1:]:
    kept, name, settings = pickle.load(open(file, "rb"))
    controller = vs.Controller(vs.load(name, settings))
    controller.clock = lambda: 0.0  # these pictures are a recording's
    for t, arrived, picture, at_exposure, now, twist, setpoint in kept:
        cycle = controller.step(picture, t, (at_exposure, now), arrived)
        assert cycle.notes == (), (name, cycle.notes)
        assert cycle.twist.tobytes() == twist.tobytes(), (name, t, cycle.twist, twist)
        assert cycle.setpoint.tobytes() == setpoint.tobytes(), (name, t, cycle.setpoint, setpoint)
    assert not {"mujoco", "dm_control"} & set(sys.modules), name + ": MuJoCo was imported"
    print(name, len(kept), float(np.abs(np.array([row[5] for row in kept])).max()))
"""


def overheard(
    monkeypatch: pytest.MonkeyPatch, name: str, settings: dict[str, Any]
) -> list[tuple[Any, ...]]:
    """What reached the controller of a run, and what it ordered."""
    kept, arrive = [], Episode._arrive

    def overhear(self: Episode, made: Exposed, step: int) -> vs.Frame:
        t = step * self.plant.step_s
        now, shot = self.plant.reading(), made[0]
        picture = shot.picture
        assert picture is not None
        images = tuple(image.copy() for image in picture.completed().images if image is not None)
        frame = arrive(self, made, step)
        image = images[0] if len(images) == 1 else images
        kept.append(
            (shot.t, t, image, shot.reading, now, frame.twist.copy(), frame.setpoint.copy())
        )
        return frame

    with monkeypatch.context() as patch:
        patch.setattr(Episode, "_arrive", overhear)
        vs.run(vs.load(name, settings))
    return kept


RUNS = {
    "arm_ibvs": {"camera.latency_s": 0.05, "noise.image_sigma": 2.0},
    "arm_track_circle": {},
    "omni_ibvs": {"timing.command_latency_s": 0.02},
    "car_pbvs": {},
    "quadrotor_hover": {},
    "spherical_behind": {"detector": "blobs", "robot.kind": "free"},
}


@pytest.mark.process
def test_the_pictures_and_readings_of_runs_give_their_orders_without_mujoco(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Of all runs in one process: to start it takes longer than its orders."""
    import pickle

    files, pictures = [], []
    for name, changes in RUNS.items():
        settings = changes | {"stop.duration_s": 0.28}
        kept = overheard(monkeypatch, name, settings)
        files.append(tmp_path / f"{name}.pickle")
        files[-1].write_bytes(pickle.dumps((kept, name, settings)))
        pictures.append(len(kept))
    alone = subprocess.run(
        [sys.executable, "-c", ALONE, *map(str, files)], capture_output=True, text=True
    )
    assert alone.returncode == 0, alone.stderr
    found = [line.split() for line in alone.stdout.splitlines()]
    assert [(name, int(count)) for name, count, _ in found] == list(
        zip(RUNS, pictures, strict=True)
    ) and min(pictures) > 5
    assert min(float(fastest) for *_, fastest in found) > 1e-3


FIRST = """
import json, sys
import numpy.testing  # the rig's own
from tests.loop.test_stopping import Rig
rig = Rig(*json.loads(sys.argv[1]))
before, cycles = set(sys.modules), [rig.sees() for _ in range(40)]
assert any(cycle.twist.any() for cycle in cycles), cycles[-1].reason
print(*sorted(set(sys.modules) - before))
"""
SWITCHED = {
    "law": {
        "kind": "switched",
        "laws": [{"law": "pbvs", "until": {"error_under_px": 1e4}}, {"law": "qp"}],
    }
}
ARMS = (
    "arm_ibvs",
    "arm_predictive",
    "arm_qp",
    "arm_pbvs",
    "arm_hybrid",
    "arm_partitioned",
    "arm_uncalibrated",
    "arm_switched",
    "arm_policy",
)
OTHERS = (*ARMS, "ibvs_book", "car_pbvs", "car_pursuit", "car_line", "omni_ibvs", "quadrotor_hover")


@pytest.mark.process
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("ibvs_book", SWITCHED),
        *(pytest.param(name, {}, marks=pytest.mark.study) for name in OTHERS),
    ],
)
def test_no_step_imports_anything(name: str, changes: dict[str, Any]) -> None:
    """SciPy's LAPACK and the solver of quadratic programs take a second on a loaded machine, while
    a robot waits.
    """
    import json

    alone = subprocess.run(
        [sys.executable, "-c", FIRST, json.dumps([name, changes])], capture_output=True, text=True
    )
    assert alone.returncode == 0, alone.stderr
    assert alone.stdout.split() == []


class TestWhatIsTold:
    BLACK = np.zeros((480, 640, 3), np.uint8)
    REST = Reading(np.zeros(6), np.zeros(6))

    @pytest.fixture
    def controller(self) -> vs.Controller:
        scenario = vs.load("arm_ibvs")
        assert (scenario.camera.height, scenario.camera.width) == self.BLACK.shape[:2]
        return vs.Controller(scenario)

    def test_a_picture_that_came_twice_changes_nothing(self, controller: vs.Controller) -> None:
        first = controller.step(self.BLACK, 0.0, self.REST)
        again = controller.step(self.BLACK, 0.0, self.REST)
        assert again.notes == ("the picture of 0 s came again",) and again.command is first.command
        assert controller.step(self.BLACK, 0.04, self.REST).timing.number == 1

    def test_missing_pictures_are_counted(self, controller: vs.Controller) -> None:
        controller.step(self.BLACK, 0.0, self.REST)
        assert controller.step(self.BLACK, 0.04, self.REST).notes == ()
        assert controller.step(self.BLACK, 0.16, self.REST).notes == (
            "2 pictures are missing before this one",
        )
        assert controller.step(self.BLACK, 0.24, self.REST).notes == (
            "1 picture is missing before this one",
        )

    def test_a_late_picture_stops_the_robot(self, controller: vs.Controller) -> None:
        cycle = controller.step(self.BLACK, 0.0, self.REST, arrived=2.0)
        assert (
            cycle.notes == ("the picture is 2 s old: the robot is told to stop",)
            and cycle.stopped
            and not cycle.setpoint.any()
        )

    def test_without_a_picture_the_robot_stops_and_the_task_is_given_up(
        self, controller: vs.Controller
    ) -> None:
        controller.step(self.BLACK, 0.0, self.REST)
        for t in (0.5, 1.0, 5.0):
            assert controller.without_picture(t, self.REST).stopped
        assert (
            controller.supervisor.aborted is not None
            and "no marker was in sight" not in controller.supervisor.aborted[1]
        )

    @pytest.mark.parametrize(
        "picture",
        [
            np.zeros((640, 480, 3), np.uint8),
            np.zeros((480, 640), np.uint8),
            np.zeros((480, 640, 3)),
            None,
            "a.png",
        ],
    )
    def test_a_wrong_picture(self, controller: vs.Controller, picture: Any) -> None:
        with pytest.raises(
            ParameterError, match=r"picture must be (\(480, 640, 3\) uint8, RGB|one image)"
        ):
            controller.step(picture, 0.0, self.REST)

    def test_a_clock_that_goes_back(self, controller: vs.Controller) -> None:
        controller.step(self.BLACK, 1.0, self.REST)
        with pytest.raises(
            ParameterError, match="t must be at least 1 s, when the last picture was taken"
        ):
            controller.step(self.BLACK, 0.9, self.REST)
        with pytest.raises(ParameterError, match="arrived must be a time after the exposure"):
            controller.step(self.BLACK, 1.1, self.REST, arrived=1.05)
        with pytest.raises(ParameterError, match="t must be the time of exposure"):
            controller.step(self.BLACK, float("nan"), self.REST)
        # a mistake has changed nothing
        assert controller.step(self.BLACK, 1.04, self.REST).notes == ()

    def test_a_time_that_is_none(self, controller: vs.Controller) -> None:
        for t in (None, "0", np.zeros(1)):
            with pytest.raises(ParameterError, match="t must be the time of exposure in seconds"):
                controller.step(self.BLACK, t, self.REST)
        controller.step(self.BLACK, 1.0, self.REST, arrived=1.5)
        with pytest.raises(ParameterError, match=r"arrived must be at least 1\.5 s"):
            controller.step(self.BLACK, 1.04, self.REST, arrived=1.45)
        with pytest.raises(ParameterError, match="t must be at least"):
            controller.without_picture(0.5, self.REST)
        with pytest.raises(ParameterError, match=r"readings\.q must be 6 finite numbers"):
            controller.without_picture(2.0, Reading(np.full(6, np.nan), np.zeros(6)))
        with pytest.raises(
            ParameterError,
            match="readings must be one or two readings: at the exposure and now, got 3",
        ):
            controller.step(self.BLACK, 1.04, (self.REST,) * 3)
        assert controller.step(self.BLACK, 1.04, self.REST).notes == ()

    def test_a_scenarios_name_is_no_scenario(self) -> None:
        with pytest.raises(ParameterError, match="must be a Scenario"):
            vs.Controller("arm_ibvs")

    def test_without_any_picture_the_order_has_the_robots_shape(
        self, controller: vs.Controller
    ) -> None:
        assert controller.without_picture(0.5, self.REST).setpoint.shape == (6,)

    def test_lists_are_readings_too(self, controller: vs.Controller) -> None:
        lists = Reading([0, 1, -3, 0, 1, 0], [0] * 6)
        assert controller.step(self.BLACK, 0.0, lists).setpoint.shape == (6,)

    @pytest.mark.parametrize(
        ("wrong", "words"),
        [
            ({"heading": np.nan}, "heading must be an angle in radians"),
            ({"tilt": np.zeros(3)}, "tilt must be roll and pitch in radians"),
        ],
    )
    def test_a_compass_that_fails(
        self, controller: vs.Controller, wrong: dict[str, Any], words: str
    ) -> None:
        """In a law, NaN would end the task for good."""
        with pytest.raises(ParameterError, match=rf"readings\.{words}"):
            controller.step(self.BLACK, 0.0, Reading(np.zeros(6), np.zeros(6), **wrong))

    def test_who_writes_to_a_cycle_changes_no_later_order(self) -> None:
        scenario = vs.load("arm_track_circle", {"stop.duration_s": 0.4})
        orders = []
        for writes in (False, True):
            controller = vs.Controller(scenario)
            with vs.Session(scenario, pictures=True) as session:
                frame = session.reset()
                while frame.outcome is None:
                    assert frame.image is not None
                    cycle = controller.step(
                        frame.image, frame.t, Reading(frame.truth.q, np.zeros(6))
                    )
                    orders.append(cycle.twist.copy())
                    if writes:
                        for array in (cycle.twist, cycle.setpoint, cycle.command.twist):
                            array *= 0.5
                    frame = session.step()
        half = len(orders) // 2
        assert np.abs(orders[0]).max() > 1e-3
        assert np.array_equal(orders[:half], orders[half:])

    def test_a_driver_may_write_the_next_reading_into_the_same_array(
        self, controller: vs.Controller
    ) -> None:
        q = np.array([0, 0.7, -3, 0, 0.7, 0])
        controller.step(self.BLACK, 0.0, Reading(q, np.zeros(6)))
        first = q.copy()
        q[:] = 0.1
        assert controller.before is not None
        assert np.array_equal(controller.before.reading.q, first)

    @pytest.mark.parametrize(
        ("name", "changed", "words"),
        [
            (
                "arm_ibvs",
                {2: 9.0},
                (
                    r"has joint_3 outside of its range of -3\.927 to 0\.7854: must be in radians,"
                    r" .* joint_1, .*got 9"
                ),
            ),
            ("arm_ibvs", {2: -170.0}, "outside of its range"),  # in degrees
            ("arm_jaco", {1: 0.1}, "outside of its range"),
            ("car_pbvs", {0: 20.0}, r"has steering outside of its range of -1\.571 to 1\.571"),
        ],
    )
    def test_a_joint_outside_of_its_range(
        self, name: str, changed: dict[int, float], words: str
    ) -> None:
        """Neither a law nor the joint limits may work on it: it is in degrees, in another order, or
        its encoder has failed.
        """
        controller = vs.Controller(vs.load(name))
        camera = controller.scenario.camera
        black, q = (
            np.zeros((camera.height, camera.width, 3), np.uint8),
            controller.scenario.robot.start_joints(),
        )
        right = Reading(q, np.zeros(len(q)))
        assert controller.step(black, 0.0, right).t == 0.0
        for joint, value in changed.items():
            q = q.copy()
            q[joint] = value
        for call in (
            lambda r: controller.step(black, 0.04, r),
            lambda r: controller.step(black, 0.04, (right, r)),
        ):
            with pytest.raises(ParameterError, match=words):
                call(Reading(q, np.zeros(len(q))))
        with pytest.raises(ParameterError, match="outside of its range"):
            controller.without_picture(0.5, Reading(q, np.zeros(len(q))))
        assert controller.step(black, 0.04, right).t == 0.04

    def test_a_joint_a_little_beyond_its_limit_is_brought_back(
        self, controller: vs.Controller
    ) -> None:
        """As encoders and soft stops have it."""
        q = controller.scenario.robot.start_joints()
        q[0] = controller.scenario.robot.body.limits[0, 1] + 0.05
        assert controller.step(self.BLACK, 0.0, Reading(q, np.zeros(6))).t == 0.0

    def test_a_crafts_range_and_tilt(self) -> None:
        for wrong, words in (
            ({"range_m": np.nan}, "range_m must be >= 0 m"),
            ({"range_m": -1.0}, "range_m must be >= 0 m"),
            ({"tilt": None}, "tilt is missing"),
        ):
            controller, still = vs.Controller(vs.load("quadrotor_hover")), np.zeros(3)
            estimate = FlightEstimate(still, still, np.zeros(2), still, 0.0, False, False)
            right: dict[str, Any] = {"tilt": np.zeros(2), "range_m": np.inf}
            none = np.zeros(0)
            assert controller.without_picture(
                0.0, FlightReading(none, none, estimate=estimate, **right)
            ).stopped
            with pytest.raises(ParameterError, match=rf"readings\.{words}"):
                controller.without_picture(
                    0.1, FlightReading(none, none, estimate=estimate, **right | wrong)
                )
            blown = replace(estimate, velocity=np.full(3, np.nan))
            with pytest.raises(
                ParameterError, match=r"readings\.estimate\.velocity must be three finite numbers"
            ):
                controller.without_picture(0.1, FlightReading(none, none, estimate=blown, **right))

    @pytest.mark.parametrize("q", [np.zeros(5), np.full(6, np.nan)])
    def test_a_wrong_reading(self, controller: vs.Controller, q: np.ndarray) -> None:
        with pytest.raises(ParameterError, match=r"readings\.q must be 6 finite numbers"):
            controller.step(self.BLACK, 0.0, Reading(q, np.zeros(6)))

    def test_the_reading_of_another_robot(self) -> None:
        controller = vs.Controller(vs.load("quadrotor_hover"))
        faces = [
            np.zeros((p.lens.height, p.lens.width, 3), np.uint8)
            for p in controller.scenario.camera.panels
        ]
        with pytest.raises(ParameterError, match="picture must be 6 images, one for each face"):
            controller.step(faces[0], 0.0, self.REST)
        with pytest.raises(ParameterError, match="readings must be FlightReadings"):
            controller.step(faces, 0.0, Reading(np.zeros(0), np.zeros(0)))

    def test_an_oracle_has_no_truth_here(self) -> None:
        controller = vs.Controller(vs.load("arm_ibvs", {"detector": "oracle"}))
        with pytest.raises(ParameterError, match="is the simulator's truth"):
            controller.step(self.BLACK, 0.0, self.REST)
