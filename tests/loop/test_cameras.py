"""Several cameras in one loop: what each sees, when it is known, what laws and the fused pose make
of it.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import av
import cv2
import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import Array, Image, exp, inverse, transform
from vstestbed.features.observation import CameraView, Goal, Observation
from vstestbed.laws import IBVS, PBVS
from vstestbed.scenario.load import parse
from vstestbed.tasks.frame import Frame

RIGHT = {
    "right": {
        "camera": {
            "width": 320,
            "height": 240,
            "fovy_deg": 64,
            "rate_hz": 25,
            "mount": {"xyz": [0.1, 0, 0]},
        }
    }
}
ROOM: dict[str, Any] = {
    "on": "world",
    "camera": {
        "width": 400,
        "height": 300,
        "fovy_deg": 45,
        "rate_hz": 10,
        "latency_s": 0.06,
        "mount": {"xyz": [0.3, -1.3, 1.5], "rpy_deg": [-117, 0, -47]},
    },
}
SMALL = {"camera.width": 320, "camera.height": 240, "stop.duration_s": 3}


class Frames:
    """Keeps the frames of a run."""

    def __init__(self) -> None:
        self.kept: list[Frame] = []

    def frame(self, frame: Frame) -> None:
        self.kept.append(frame)


def arm(**changes: Any) -> vs.Scenario:
    return vs.load("arm_ibvs", SMALL | {"cameras": RIGHT | {"room": ROOM}} | changes)


@pytest.fixture(scope="module")
def flown() -> tuple[vs.Recording, list[Frame]]:
    """A run with a pair in the hand and a slower, later camera in the room."""
    frames = Frames()
    return vs.run(arm(), [frames]), frames.kept


class TestPictures:
    def test_each_camera_finds_the_markers_where_its_own_true_lens_has_them(
        self, flown: tuple[vs.Recording, list[Frame]]
    ) -> None:
        log = flown[0]
        for name in ("right", "room"):
            measured, true = (
                (log[f"{name}_{axis}{which}_{i}"] for axis in "uv" for i in range(4))
                for which in ("", "_true")
            )
            off = np.array([a - b for a, b in zip(measured, true, strict=True)])
            assert np.isfinite(off).mean() > 0.9
            assert np.nanmax(np.abs(off)) < 0.7  # discs of 4 to 8 px, on a grid of whole pixels

    def test_they_arrive_when_they_arrive(self, flown: tuple[vs.Recording, list[Frame]]) -> None:
        # Ten pictures a second, 60 ms late, beside 25: at 0.16 s the last one known is that of 0.1
        # s.
        t, own, room, right = flown[0]["t"], flown[1], flown[0]["room_t"], flown[0]["right_t"]
        assert (right == t).all()
        assert np.isnan(room[t < 0.06]).all() and "room" not in own[0].cameras
        known = np.floor((t - 0.06) / 0.1 + 1e-6) * 0.1
        assert room[t >= 0.06] == pytest.approx(known[t >= 0.06], abs=1e-9)

    def test_a_camera_in_the_room_is_where_it_stands_and_one_on_the_flange_moves_with_it(
        self, flown: tuple[vs.Recording, list[Frame]]
    ) -> None:
        for frame in flown[1][3::20]:
            room, right = (
                frame.cameras["room"].T_world_camera,
                frame.cameras["right"].T_world_camera,
            )
            assert room == pytest.approx(
                vs.Pose(xyz=(0.3, -1.3, 1.5), rpy_deg=(-117, 0, -47)).T, abs=1e-6
            )
            step = inverse(frame.truth.T_world_camera) @ right
            assert step == pytest.approx(vs.Pose(xyz=(0.1, 0, 0)).T, abs=1e-6)

    def test_the_camera_of_the_law_is_not_disturbed(self) -> None:
        alone, among = vs.run(vs.load("arm_ibvs", SMALL)), vs.run(arm())
        n = len(alone.columns)
        assert among.columns[:n] == alone.columns
        assert np.array_equal(alone.table, among.table[:, :n], equal_nan=True)

    def test_one_seed_is_one_run_and_each_camera_has_noise_of_its_own(self) -> None:
        scenario = arm(
            **{"noise.pixel_sigma_px": 0.5, "stop.duration_s": 0.5, "detector": "oracle"}
        ).with_seed(3)
        first, again, other = vs.run(scenario), vs.run(scenario), vs.run(scenario.with_seed(4))
        assert np.array_equal(first.table, again.table, equal_nan=True)
        noise = [first[f"{name}u_0"] - first[f"{name}u_true_0"] for name in ("", "right_")]
        assert abs(np.corrcoef(*noise)[0, 1]) < 0.7
        assert noise[0].std() == pytest.approx(0.5, rel=0.6)
        assert not np.array_equal(first["room_u_0"], other["room_u_0"], equal_nan=True)


def view_of(T_camera_target: Array, points: Array, camera: vs.Camera) -> Observation:
    p = transform(T_camera_target, points)
    uv = camera.project(p)
    return Observation(0.0, uv, camera.normalise(uv), p[:, 2], T_camera_target)


def both(T: Array, scenario: vs.Scenario) -> tuple[Observation, Goal]:
    """What a pair sees of the target at T (4, 4) in the first camera's frame, and the first one's
    goal.
    """
    eye, goal = scenario.eyes["right"], scenario.goal_view
    T_left_right = eye.T_camera_eye(scenario.robot.start_joints(), scenario.believed_camera.mount.T)
    right = view_of(inverse(T_left_right) @ T, scenario.target.points, eye.camera)
    own = view_of(T, scenario.target.points, scenario.camera)
    return replace(
        own, cameras={"right": CameraView(right, eye.goal(goal, T_left_right), T_left_right, True)}
    ), goal


class TestStacked:
    """The equations of both pictures, one below the other."""

    MOUNT: ClassVar[dict[str, Any]] = {"xyz": [0.1, -0.02, 0.03], "rpy_deg": [3, -14, 20]}
    NEAR = vs.Pose(xyz=(0.06, -0.05, 1.15), rpy_deg=(6, -9, 12)).T

    @pytest.fixture
    def pair(self) -> vs.Scenario:
        return arm(**{"cameras": RIGHT, "cameras.right.camera.mount": self.MOUNT})

    @pytest.mark.parametrize(
        "law", [IBVS(cameras={"right": 4.0}), PBVS(cameras={"right": 4.0})], ids=["ibvs", "pbvs"]
    )
    def test_the_matrix_is_the_derivative_of_the_error_along_the_first_cameras_twist(
        self, pair: vs.Scenario, law: Any
    ) -> None:
        h = 1e-6
        seen, goal = both(self.NEAR, pair)
        stacked = law._stacked(seen, goal, np.eye(6))
        assert not isinstance(stacked, str)
        e, J = stacked
        for axis, v in enumerate(np.eye(6)):
            ahead, behind = (
                law._stacked(both(exp(-way * h * v) @ self.NEAR, pair)[0], goal, np.eye(6))[0]
                for way in (1, -1)
            )
            assert (ahead - behind) / (2 * h) == pytest.approx(
                J[:, axis], abs=2e-5 * np.abs(J).max()
            )
        rows = len(e) // 2
        alone = law.equations(seen.cameras["right"].seen, seen.cameras["right"].goal)[0]  # type: ignore[index] - it has one
        assert e[rows:] == pytest.approx(2.0 * alone)  # the root of its weight

    def test_it_is_zero_at_the_goal(self, pair: vs.Scenario) -> None:
        T = pair.goal_view.T_camera_target
        seen, goal = both(T, pair)
        stacked = IBVS(cameras={"right": 1.0})._stacked(seen, goal, np.eye(6))
        assert not isinstance(stacked, str)
        assert np.abs(stacked[0]).max() < 1e-12

    def test_markers_of_either_camera_count_and_too_few_of_both_do_not(
        self, pair: vs.Scenario
    ) -> None:
        law = IBVS(cameras={"right": 1.0})
        seen, goal = both(self.NEAR, pair)
        half = seen.only(np.array([True, False, False, False]))
        _, command = law.step(law.init(goal), half, goal, np.eye(6))
        assert command.twist.any() and not command.rest_reason
        few = replace(half, cameras={"right": replace(seen.cameras["right"], seen=half)})  # type: ignore[index] - it has one
        _, command = law.step(law.init(goal), few, goal, np.eye(6))
        assert command.rest_reason == "too few markers in sight"

    def test_a_law_of_ones_own_gets_it_with_its_equations(self, pair: vs.Scenario) -> None:
        class Mine(vs.ErrorLaw):
            inputs = ("xy", "depth")

            def equations(self, view: Any, goal: Any) -> tuple[Array, Array]:
                return IBVS().equations(view, goal)

        seen, goal = both(self.NEAR, pair)
        mine = vs.spec(Mine)(cameras={"right": 1.0})
        theirs = IBVS(cameras={"right": 1.0})
        assert mine.step(mine.init(goal), seen, goal, np.eye(6))[1].twist == pytest.approx(
            theirs.step(theirs.init(goal), seen, goal, np.eye(6))[1].twist
        )

    @pytest.mark.parametrize(
        "law",
        [
            {"kind": "qp", "law": {"kind": "ibvs", "cameras": {"right": 1}}},
            {"kind": "predictive", "cameras": {"right": 1}},
        ],
    )
    def test_programs_reach_the_goal_with_both(self, law: dict[str, Any]) -> None:
        scenario = vs.load(
            "ibvs_book",
            {
                "cameras": {"right": {"camera": {"mount": {"xyz": [0.1, 0, 0]}}}},
                "law": {**law, "gain": 1} if law["kind"] != "qp" else law,
            },
        )
        assert vs.run(scenario).outcome.success

    def test_markers_that_only_the_second_camera_sees_suffice(self) -> None:
        # Of the first camera nine of ten markers are lost in each picture: alone it gives up, the
        # second one steers to the goal.
        scenario = vs.load(
            "ibvs_book",
            {
                "cameras": {"right": {"camera": {"mount": {"xyz": [0.4, 0, 0]}}}},
                "noise.dropout": 0.9,
            },
        )
        assert vs.run(scenario).outcome is vs.Outcome.target_lost
        second = replace(scenario.cameras["right"], noise=vs.Noise())
        both = replace(
            scenario, law=replace(scenario.law, cameras={"right": 1.0}), cameras={"right": second}
        )
        run = vs.run(both)
        assert run.outcome is not vs.Outcome.target_lost and run["position_error_m"][-1] < 1e-3

    def test_a_quadrotor_with_one_eye_down_and_one_ahead(self) -> None:
        # Below the hull and turned 30 deg ahead; the one at the craft's centre goes blind for nine
        # of ten markers.
        ahead = {
            "camera": {
                "fovy_deg": 100,
                "rate_hz": 25,
                "mount": {"xyz": [0.1, 0, -0.15], "rpy_deg": [180, -30, 0]},
            },
            "noise": {},
        }
        start = {"nominal": {"xyz": [-0.5, 0.3, 4], "yaw_deg": 60}}
        given = {
            "detector": "oracle",
            "noise.dropout": 0.9,
            "cameras": {"ahead": ahead},
            "robot.start": start,
            "stop.duration_s": 16,
        }
        alone, both = (
            vs.run(vs.load("quadrotor_hover", given | law))
            for law in ({}, {"law.cameras": {"ahead": 1.0}})
        )
        assert alone.outcome is vs.Outcome.target_lost
        assert (
            both["position_error_m"][0] > 1
            and both["position_error_m"][-1] < 0.1
            and not both["lost"].any()
        )


class TestFused:
    def test_it_goes_on_where_a_plate_hides_the_target_from_the_hand(self) -> None:
        plate = {
            "world.plates": [
                {
                    "pose": {"xyz": [1.15, 0, 0.7], "rpy_deg": [0, 90, 0]},
                    "width": 0.6,
                    "height": 0.6,
                    "from_s": 0.6,
                }
            ]
        }
        given = plate | {"stop.duration_s": 4, "law": "pbvs"}
        blind, seeing = vs.run(arm(**given)), vs.run(arm(**given, fusion="pose"))
        assert blind.outcome is vs.Outcome.target_lost
        assert seeing.outcome is not vs.Outcome.target_lost and not seeing["lost"][5:].any()
        # its own picture shows none
        assert np.isnan(seeing["u_0"][20:]).all() and np.isnan(seeing["error_px"][20:]).all()
        assert seeing["position_error_m"][-1] < 0.5 * seeing["position_error_m"][14]

    def test_the_pose_is_that_of_the_exposure_whatever_the_others_age(self) -> None:
        # The truth moves on by 20 mm between the room's picture and the hand's; without noise the
        # fused pose is the true one.
        frames = Frames()
        vs.run(
            arm(fusion="pose", detector="oracle", law="pbvs", **{"stop.duration_s": 1}), [frames]
        )
        for frame in frames.kept[4:]:
            true = inverse(frame.truth.T_world_camera) @ frame.truth.T_world_target
            assert frame.observation.T_camera_target == pytest.approx(true, abs=2e-4)

    @pytest.mark.parametrize("name", ["quadrotor_perspective", "car_pbvs"])
    def test_a_second_camera_on_a_vehicle(self, name: str) -> None:
        given = vs.load(name).camera
        mount = vs.Pose.of(given.mount.T @ vs.Pose(xyz=(0.1, 0, 0.1), rpy_deg=(4, -20, 0)).T)
        changes = {"detector": "oracle", "stop.duration_s": 2, "fusion": "pose"}
        frames, camera = (
            Frames(),
            {"camera": {"rate_hz": given.rate_hz, "fovy_deg": 110, "mount": mount}},
        )
        run = vs.run(vs.load(name, changes | {"cameras": {"second": camera}}), [frames])
        assert run.outcome in (vs.Outcome.timed_out, vs.Outcome.converged)
        both = [
            frame
            for frame in frames.kept[5:]
            if "second" in frame.cameras and np.isfinite(frame.cameras["second"].uv).any()
        ]
        assert len(both) > 20


class TestController:
    """A controller with several cameras, without a simulator."""

    def test_it_orders_what_the_run_ordered(self) -> None:
        scenario, frames, shots = arm(fusion="pose", **{"stop.duration_s": 1}), Frames(), []
        with vs.Session(scenario, pictures=True, watch=[frames]) as session:
            frame = session.reset()
            while frame.outcome is None:
                exposure = session.episode.controller.before  # type: ignore[union-attr] - it runs
                others = {
                    name: (record.t, record.image.copy())
                    for name, record in frame.cameras.items()
                    if record.image is not None
                }
                shots.append(
                    (frame.t, frame.image.copy(), exposure.reading, others, frame.twist.copy())  # type: ignore[union-attr] - pictures are taken
                )
                frame = session.step()
        controller, known = vs.Controller(scenario), dict.fromkeys(("right", "room"), -1.0)
        readings = {t: reading for t, _, reading, _, _ in shots}
        for t, image, reading, others, twist in shots:
            for name, (taken, picture) in others.items():
                if taken > known[name]:
                    # The room's pictures lie between the hand's: the reading nearest to their
                    # exposure.
                    at = min(readings, key=lambda s: abs(s - taken))
                    controller.look(name, picture, taken, readings[at])
                    known[name] = taken
            assert controller.step(image, t, reading).twist == pytest.approx(twist, abs=2e-3)

    def test_pictures_of_one_time_come_by_name(self) -> None:
        scenario = arm()
        controller = vs.Controller(scenario)
        blank, small = np.zeros((240, 320, 3), np.uint8), np.zeros((300, 400, 3), np.uint8)
        reading = vs.Reading(scenario.robot.start_joints(), np.zeros(6))
        cycle = controller.step({"camera": blank, "right": blank, "room": small}, 0.0, reading)
        assert set(cycle.observation.cameras or {}) == {"right", "room"}
        for pictures, words in (
            ({"right": blank}, "picture is missing: camera"),
            ({"camera": blank, "left": blank}, "must be one of camera, right, room"),
            ({"camera": blank, "room": blank}, r"must be \(300, 400, 3\)"),
        ):
            with pytest.raises(ParameterError, match=words):
                controller.step(pictures, 0.04, reading)
        controller.look("room", small, 0.05, reading)
        with pytest.raises(ParameterError, match=r"t must be after 0\.05 s"):
            controller.look("room", small, 0.05, reading)


class TestFiles:
    """Calibrations of further cameras by their files."""

    LENS = """image_width: 320
image_height: 240
camera_matrix: {rows: 3, cols: 3, data: [192, 0, 159.5, 0, 192, 119.5, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
"""

    def test_a_runs_folder_keeps_them_and_gives_the_same_run_without_the_originals(
        self, tmp_path: Path
    ) -> None:
        lens = tmp_path / "given" / "lens.yaml"
        lens.parent.mkdir()
        lens.write_text(self.LENS)
        right = {
            "camera": {"intrinsics": str(lens), "rate_hz": 25, "mount": {"xyz": [0.1, 0, 0]}},
            "calibration": str(lens),
        }
        given = SMALL | {
            "cameras": {"right": right},
            "law.cameras": {"right": 1},
            "stop.duration_s": 0.4,
            "detector": "oracle",
        }
        recording = vs.run_into(
            tmp_path / "run", vs.load("arm_ibvs", given), films="none", report=False
        )
        lens.unlink()
        again = vs.run(vs.load(tmp_path / "run" / "scenario.yaml"))
        assert np.array_equal(again.table, recording.rows.table, equal_nan=True)

    @pytest.mark.opengl
    def test_the_film_has_all_pictures_in_a_row_and_render_one_of_them(
        self, command: Any, tmp_path: Path
    ) -> None:
        small = {
            "camera.width": 160,
            "camera.height": 120,
            "cameras": {"right": {"camera": {"width": 240, "height": 240, "rate_hz": 25}}},
        }
        vs.run_into(
            tmp_path / "run",
            vs.load("arm_ibvs", small | {"stop.duration_s": 0.2}),
            films="camera",
            report=False,
        )
        assert (
            command(
                "render", tmp_path / "run", "--camera", "right", "--out", tmp_path / "right.mp4"
            ).code
            == 0
        )

        def middle(name: str) -> Image:
            with av.open(str(tmp_path / name)) as film:
                return list(film.decode(video=0))[1].to_ndarray(format="rgb24")

        row, right = middle("run/camera.mp4"), middle("right.mp4")
        assert row.shape[1] == 160 + 120  # the second one as high as the first one
        # its name is at its foot
        beside = cv2.resize(right, (120, 120), interpolation=cv2.INTER_AREA)[:90]
        assert np.abs(row[:90, 160:].astype(float) - beside).mean() < 8  # but for the drawn paths

    def test_it_is_written_and_read_again_as_it_was(self) -> None:
        scenario = arm(fusion="pose")
        assert parse(vs.dump(scenario), "s.yaml") == scenario
        assert parse(vs.dump(scenario, defaults=True), "s.yaml") == scenario


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            {"law.cameras": {"room": 1}},
            "law.cameras.room: must name a camera that moves as the law's own does",
        ),
        ({"law.cameras": {"left": 1}}, "law.cameras.left: must be one of right, room"),
        (
            {"law.depth": {"kind": "stereo", "camera": "room"}},
            "law.depth.camera: must name a camera that moves",
        ),
        (
            {
                "cameras.right.camera.latency_s": 0.02,
                "law.depth": {"kind": "stereo", "camera": "right"},
            },
            "camera.latency_s: must be equal to 0",
        ),
        (
            {"cameras.right.camera.rate_hz": 24.0},
            (
                "cameras.right.camera.rate_hz:"
                " must be that of pictures a whole number of physics steps"
            ),
        ),
        ({"cameras.Eye": {}}, "cameras.Eye: must have a name of small letters"),
        ({"cameras.right.detector": "tags"}, "cameras.right.target.marker: may not be disc"),
        (
            {"law": {"kind": "hybrid", "cameras": {"right": 1}}},
            "law.cameras: is for laws of an error",
        ),
        ({"cameras": {}, "fusion": "pose"}, "fusion: needs further cameras"),
        (
            {
                "robot": {
                    "kind": "free",
                    "start": {"nominal": {"xyz": [0.5, 0, 0.7], "rpy_deg": [-90, 0, -90]}},
                }
            },
            "cameras.room.on: must be flange",
        ),
    ],
)
def test_what_does_not_fit_is_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ScenarioError, match=re.escape(words)):
        arm(**change)
