"""The closed loop as a whole: the arm arrives, delays are true, runs repeat to the byte, truth
stays fenced, every end is an outcome.
"""

from __future__ import annotations

import ast
import inspect
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import vstestbed as vs
from vstestbed.core.geometry import Array
from vstestbed.loop import plants as loop
from vstestbed.loop.log_file import open_log
from vstestbed.sim.base import Plant
from vstestbed.sim.plant import MujocoPlant
from vstestbed.studies.run_folder import run_into
from vstestbed.tasks import GOALS
from vstestbed.tasks.frame import Frame
from vstestbed.timing.setpoints import Stop

PACKAGE = Path(vs.__file__).parent
TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")
JOINTS = [f"joint_{i}" for i in range(1, 7)]
STEP = 0.002
# Between the camera (x = .5 .. .6) and the target (x = 1.5), wide enough to hide all of it.
PLATE = {"pose": {"xyz": [1.2, 0, 0.7], "rpy_deg": [0, 90, 0]}, "width": 0.8, "height": 0.8}


def columns(r: vs.Recording, *names: str) -> Array:
    return np.column_stack([r[name] for name in names])


@pytest.fixture(scope="module")
def arrived() -> vs.Recording:
    """The bundled scenario, as it is."""
    return vs.run(vs.load("arm_ibvs"))


class TestArm:
    def test_converges(self, arrived: vs.Recording):
        # The project's promise: .3 px, 3 mm, .3 degrees.
        assert arrived.outcome is vs.Outcome.converged
        assert arrived["error_px"][-1] < 0.3
        assert arrived["position_error_m"][-1] < 0.003
        assert np.degrees(arrived["rotation_error_rad"][-1]) < 0.3
        assert not arrived["lost"].any()

    def test_detection_is_fine_and_never_the_truth_itself(self, arrived: vs.Recording):
        seen = np.stack([columns(arrived, f"u_{i}", f"v_{i}") for i in range(4)])
        true = np.stack([columns(arrived, f"u_true_{i}", f"v_true_{i}") for i in range(4)])
        off = np.linalg.norm(seen - true, axis=-1)
        # .1 px is the project's promise; an error of exactly zero would be the truth in disguise.
        assert np.median(off) < 0.1
        assert np.all(off > 0) and np.all(seen != true)

    def test_depth_comes_from_the_picture(self, arrived: vs.Recording):
        depth = np.array([arrived[f"depth_{i}"][-1] for i in range(4)])
        # At the goal all markers are 1 m away: 3 mm of position and .3 degrees over .35 m, as
        # above; not to the last digit.
        assert depth == pytest.approx(1.0, abs=0.005)
        assert np.all(np.abs(depth - 1) > 1e-9)

    def test_what_is_ordered_is_made(self, arrived: vs.Recording):
        commanded, made = (
            columns(arrived, *(f"{kind}_{n}" for n in TWIST)) for kind in ("cmd", "act")
        )
        # Servos rise in 40 ms, one frame: what was commanded a frame before, once the first rush is
        # over (1 s).
        lag = np.linalg.norm(made[26:] - commanded[25:-1], axis=1) / np.linalg.norm(
            commanded[25:-1], axis=1
        )
        moving = np.linalg.norm(commanded[25:-1], axis=1) > 0.02
        assert np.median(lag[moving]) < 0.1

    def test_clock(self, arrived: vs.Recording):
        n = len(arrived.table)
        np.testing.assert_array_equal(arrived["frame"], np.arange(n))
        # Whole steps of 2 ms, 20 a frame: rounding.
        np.testing.assert_allclose(arrived["t"], np.arange(n) * 0.04, rtol=1e-14)


def test_free_camera_converges_on_rendered_pictures():
    r = vs.run(vs.load("ibvs_book"))
    assert r.outcome is vs.Outcome.converged
    # .2 px of the stop test at 800 px and 1 m: 1 mm and .1 degrees leave a factor of two for noise
    # of the last frame.
    assert r["error_px"][-1] < 0.2
    assert r["position_error_m"][-1] < 2e-3 and np.degrees(r["rotation_error_rad"][-1]) < 0.1
    # No servo between order and motion; true twist of a frame is the order of the one before.
    np.testing.assert_array_equal(
        columns(r, *(f"act_{n}" for n in TWIST))[1:], columns(r, *(f"cmd_{n}" for n in TWIST))[:-1]
    )


class Watched:
    """A plant that is stepped one by one, and what was true at the start and after each step."""

    def __init__(self, plant: Plant):
        self._plant = plant
        truth = plant.capture()[1]
        self.poses, self.ctrl = [truth.T_world_camera], [truth.ctrl]

    def __getattr__(self, name: str) -> object:
        return getattr(self._plant, name)

    def advance(self, steps: int) -> bool:
        for _ in range(steps):
            if not self._plant.advance(1):
                return False
            truth = self._plant.capture()[1]
            self.poses.append(truth.T_world_camera)
            self.ctrl.append(truth.ctrl)
        return True


class TestLatency:
    @pytest.fixture
    def watched(self, monkeypatch: pytest.MonkeyPatch) -> list[Watched]:
        made: list[Watched] = []
        build = loop.build_plant

        def wrapped(*parts: object, **needs: object) -> tuple[Plant, str]:
            plant, renderer = build(*parts, **needs)
            made.append(Watched(plant))
            return made[-1], renderer

        monkeypatch.setattr(loop, "build_plant", wrapped)
        return made

    @pytest.mark.parametrize("latency", [0.0, 0.05, 0.1, 0.103])
    @pytest.mark.parametrize("name", ["arm_ibvs", "ibvs_book"])
    def test_first_motion_comes_when_commanded(
        self, name: str, latency: float, watched: list[Watched]
    ):
        setting = {
            "detector": "oracle",
            "camera.rate_hz": 25,
            "camera.latency_s": latency,
            "stop.duration_s": 0.2,
        }
        # a servo that pushes at once: integrating ones first wind up against friction
        if name == "arm_ibvs":
            setting["robot.actuation"] = "ideal"
        vs.run(vs.load(name, setting))
        poses = np.array(watched[0].poses)
        # At rest the ideal arm stirs by 1e-12 m; its first step of motion is 1e-6 m and more.
        moved = np.abs(poses - poses[0]).max(axis=(1, 2)) > 1e-8
        assert moved.any()
        # Not moved after k steps, moved after k + 1: it began at k.
        assert abs(STEP * (int(np.argmax(moved)) - 1) - latency) <= STEP

    def test_the_servos_are_told_when_commanded(self, watched: list[Watched]):
        vs.run(
            vs.load(
                "arm_ibvs", {"detector": "oracle", "camera.latency_s": 0.1, "stop.duration_s": 0.2}
            )
        )
        told = np.abs(np.array(watched[0].ctrl)).max(axis=1) > 0
        assert STEP * (int(np.argmax(told)) - 1) == pytest.approx(0.1, abs=1e-12)

    def test_pictures_arrive_in_order_and_late_ones_are_of_their_time(self):
        setting = {"detector": "oracle", "camera.rate_hz": 25, "stop.duration_s": 1}
        fast, slow = (
            vs.run(vs.load("ibvs_book", setting | {"camera.latency_s": latency}))
            for latency in (0, 0.1)
        )
        np.testing.assert_array_equal(slow["t"], fast["t"])  # the time of exposure
        # Three pictures are taken before the first order takes effect (at 0, 40 and 80 ms), and all
        # show the start.
        np.testing.assert_array_equal(slow["u_0"][:3], np.full(3, fast["u_0"][0]))
        assert slow["u_0"][3] != fast["u_0"][0]

    def test_dead_time_sets_the_limit_of_the_gain(self):
        # s(k+1) = s(k) - g s(k-d), g = gain dt: stable for g < 2 sin(pi/(2(2d+1))), at d = 3 frames
        # .445. 10 % to both sides.
        growth = {}
        for g in (0.40, 0.49):
            setting = {
                "detector": {"kind": "oracle", "field_of_view": "unlimited"},
                "law.depth": "oracle",
                "law.interaction": "desired",
            }
            setting |= {
                "camera.rate_hz": 25,
                "camera.latency_s": 0.12,
                "law.gain": g * 25,
                "stop.duration_s": 6,
            }
            setting |= {"stop.converged": {"error_px": 1e-6, "hold_s": 0}}
            # 1 mm from the goal, where the law is linear.
            r = vs.run(
                vs.load("ibvs_book", setting | {"robot.start": {"nominal": {"xyz": [0.001, 0, 2]}}})
            )
            error = r["error_px"]
            growth[g] = error[-25:].max() / error[:25].max()
        assert growth[0.40] < 0.2 and growth[0.49] > 5


@pytest.fixture(scope="module")
def repeated(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Path]]:
    """One short noisy run four times: twice without films, once with both,
    once from what it wrote.
    """
    noisy = {
        "noise": {"image_sigma": 2.0, "pixel_sigma_px": 0.1},
        "stop.duration_s": 0.3,
        "law.gain": 2,
    }
    folders = {
        name: tmp_path_factory.mktemp(name) for name in ("first", "again", "filmed", "rerun")
    }
    for name, films in (("first", "none"), ("again", "none"), ("filmed", "both")):
        run_into(folders[name], vs.load("arm_ibvs", noisy), films)
    run_into(folders["rerun"], vs.load(folders["first"] / "scenario.yaml"), "none")
    yield folders


class TestRepeats:
    @pytest.mark.parametrize("other", ["again", "filmed", "rerun"])
    def test_the_same_bytes(self, repeated: dict[str, Path], other: str):
        first = repeated["first"]
        assert (repeated[other] / "log.parquet").read_bytes() == (
            first / "log.parquet"
        ).read_bytes()
        for name in ("scenario.yaml", "resolved.yaml", "model.xml"):
            assert (repeated[other] / name).read_text() == (first / name).read_text()

    def test_other_seeds_other_noise(self, repeated: dict[str, Path], tmp_path: Path):
        scenario = replace(vs.load(repeated["first"] / "scenario.yaml"), seed=1)
        r = vs.run(scenario)
        assert not np.array_equal(r["u_0"], open_log(repeated["first"]).frame()["u_0"].to_numpy())

    def test_folder(self, repeated: dict[str, Path]):
        names = {p.name for p in repeated["filmed"].iterdir()}
        given = {"scenario.yaml", "resolved.yaml", "model.xml"}
        assert names == given | {
            "log.parquet",
            "summary.json",
            "report.html",
            "camera.mp4",
            "overview.mp4",
        }
        log = open_log(repeated["first"]).frame()
        # frames at 0, 40 .. 320 ms: the first at or after the duration is the last
        assert log.height == 9
        assert log.schema["frame"] == pl.Int64 and log.schema["lost"] == pl.Boolean


class TestHidden:
    def test_target_hidden_for_good_is_lost_with_the_arm_at_rest(self, tmp_path: Path):
        scenario = vs.load(
            "arm_ibvs",
            {"world.plates": [PLATE | {"from_s": 1.0}], "law.gain": 2, "stop.lost_after_s": 0.6},
        )
        r = run_into(tmp_path, scenario, "none")
        assert r.outcome is vs.Outcome.target_lost
        t, lost = r["t"], r["lost"].astype(bool)
        np.testing.assert_array_equal(lost, t > 1.0 - 1e-9)
        # It moved before, and the time to the end is lost_after_s: a frame's rounding.
        assert np.abs(columns(r, *(f"qd_{j}" for j in JOINTS)))[~lost].max() > 0.1
        assert t[-1] - t[lost][0] == pytest.approx(0.6, abs=1e-9)
        np.testing.assert_array_equal(columns(r, *(f"cmd_{n}" for n in TWIST))[lost], 0.0)
        np.testing.assert_array_equal(columns(r, *(f"ctrl_{j}" for j in JOINTS))[-1], 0.0)
        # At rest: 1 mrad/s is the sway of a servo .6 s after it was stopped.
        assert np.abs(columns(r, *(f"qd_{j}" for j in JOINTS))[-1]).max() < 1e-3
        assert np.isnan(r["u_0"][-1]) and np.isnan(r["error_px"][-1])
        # A readable folder, in which what has no value has none.
        assert open_log(tmp_path).frame().height == len(r.table)
        summary = json.loads((tmp_path / "summary.json").read_text())
        assert (summary["outcome"], summary["success"], summary["final_error_px"]) == (
            "target_lost",
            False,
            None,
        )
        assert summary["frames_lost"] == lost.sum()
        assert (tmp_path / "report.html").stat().st_size > 10_000
        assert not (tmp_path / "log.part").exists()

    def test_recovers_when_the_plate_goes_in_time(self):
        r = vs.run(
            vs.load(
                "arm_ibvs",
                {"world.plates": [PLATE | {"from_s": 1.0, "until_s": 1.6}], "law.gain": 2},
            )
        )
        assert r.outcome is vs.Outcome.converged
        assert int(r["lost"].sum()) == 15  # 1.0 to 1.56 s
        assert r["error_px"][-1] < 0.3 and r["position_error_m"][-1] < 0.003

    def test_the_oracle_is_not_told_of_hidden_markers(self):
        setting = {"world.plates": [PLATE | {"from_s": 0.2}], "stop.lost_after_s": 0.2}
        r = vs.run(vs.load("arm_ibvs", setting | {"detector": {"kind": "oracle"}}))
        assert r.outcome is vs.Outcome.target_lost
        assert r["t"][r["lost"] > 0][0] == pytest.approx(0.2, abs=1e-9)


class TestTruthFence:
    """What the simulator knows reaches the recorder, the judge and the oracle, and nobody else."""

    # vision/base.py says what the oracle is given; its package hands that on by name.
    KNOWS = ("vision/oracle.py", "vision/base.py")
    ROOMS = ("laws", "robots", "vision", "features", "camera", "targets")
    TRUE = ("Truth", "truth", "hidden", "T_world_camera", "view", "p_camera")

    def files(self) -> list[Path]:
        found = [f for room in self.ROOMS for f in (PACKAGE / room).rglob("*.py")]
        assert len(found) > 60
        assert all(PACKAGE / name in found for name in self.KNOWS)
        return [f for f in found if f.relative_to(PACKAGE).as_posix() not in self.KNOWS]

    @staticmethod
    def spoken(tree: ast.AST) -> set[str]:
        """Names and attributes that the code reads, beside those in annotations and imports."""
        for node in ast.walk(tree):
            if isinstance(node, ast.arg | ast.AnnAssign):
                node.annotation = ast.Constant(value=None)
            elif isinstance(node, ast.FunctionDef):
                node.returns = None
        walked = list(ast.walk(tree))
        names = {n.id for n in walked if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)}
        return names | {n.attr for n in walked if isinstance(n, ast.Attribute)}

    def test_no_room_that_sees_or_decides_reads_the_truth(self):
        for file in self.files():
            tree = ast.parse(text := file.read_text())
            imported = {
                a.name
                for n in ast.walk(tree)
                if isinstance(n, ast.Import | ast.ImportFrom)
                for a in n.names
            }
            modules = {n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)}
            assert "Truth" not in imported, file
            assert not any(
                m.startswith(("vstestbed.sim", "vstestbed.loop", "mujoco", "dm_control"))
                for m in modules | imported
            ), file
            spoken = self.spoken(tree) if any(word in text for word in self.TRUE) else set()
            assert not spoken & {"Truth", "TruthView", "truth", "hidden", "T_world_camera"}, file
            # a detector is given the oracle's view, and must not read it
            if "detect" in file.parts:
                assert "view" not in spoken, file
            # A lens projects points that it is given; the observer hands on what an oracle found.
            if "camera" not in file.parts and file.name != "observe.py":
                assert "p_camera" not in spoken, file

    def readers(self, room: str, *words: str) -> set[str]:
        """Classes of a room that read one of these names or attributes."""
        files = [
            f
            for f in sorted((PACKAGE / room).rglob("*.py"))
            if any(word in f.read_text() for word in words)
        ]
        classes = [
            n
            for f in files
            for n in ast.walk(ast.parse(f.read_text()))
            if isinstance(n, ast.ClassDef)
        ]
        return {cls.name for cls in classes if self.spoken(cls) & set(words)}

    def test_of_a_task_only_what_judges_reads_the_truth(self):
        """Reference and goal views, which the law is told, are made of an observation and an error
        in the image.
        """
        judges = {"Frame", "ToleranceMonitor", "LandingMonitor", "InsertionMonitor"}
        assert self.readers("tasks", "truth", "T_world_camera", "hidden") == judges
        for task in GOALS.members.values():
            for name, arguments in (
                ("reference", ["self", "state", "seen"]),
                ("passed", ["self", "state", "error"]),
            ):
                assert list(inspect.signature(getattr(task, name)).parameters) == arguments

    def test_of_a_robot_only_its_log_is_given_the_truth(self):
        assert self.readers("robots", "T_world_base") == {"VehicleLog"}

    @pytest.mark.app()
    def test_only_the_loop_opens_the_fence_and_only_for_the_oracle(self):
        named = [(f, text) for f in PACKAGE.rglob("*.py") if "TruthView" in (text := f.read_text())]
        opened = {f.name for f, text in named if "TruthView" in self.spoken(ast.parse(text))}
        # The loop's shutter, and the suite that tests an oracle like another detector.
        assert opened == {"shutter.py", "perception.py"}
        detectors = [
            vs.load("arm_ibvs", {"detector": kind}).detector for kind in ("blobs", "oracle")
        ]
        assert [d.needs_truth for d in detectors] == [False, True]


class TestEnds:
    def test_interrupted_keeps_what_there_was(self, tmp_path: Path):
        class Impatient:
            def frame(self, frame: Frame) -> None:
                if frame.timing.number == 4:
                    raise KeyboardInterrupt

        r = run_into(tmp_path, vs.load("arm_ibvs"), "none", [Impatient()])
        assert r.outcome is vs.Outcome.interrupted and not r.outcome.success
        assert len(r.table) == open_log(tmp_path).frame().height == 5
        assert json.loads((tmp_path / "summary.json").read_text())["outcome"] == "interrupted"

    def test_an_unstable_simulation_crashes_as_an_outcome(self, monkeypatch: pytest.MonkeyPatch):
        apply = MujocoPlant.apply

        def blow(plant: MujocoPlant, setpoint: Array, stop: Stop) -> None:
            apply(plant, setpoint, stop)
            plant._stage.data.qvel[:] = np.nan

        monkeypatch.setattr(MujocoPlant, "apply", blow)
        r = vs.run(vs.load("arm_ibvs", {"detector": "oracle"}))
        assert r.outcome is vs.Outcome.crashed and "unstable" in r.reason
        assert len(r.table) == 1

    def test_time_runs_out(self):
        r = vs.run(vs.load("arm_ibvs", {"detector": "oracle", "stop.duration_s": 0.4}))
        assert r.outcome is vs.Outcome.timed_out and r["t"][-1] == pytest.approx(0.4, abs=1e-12)
