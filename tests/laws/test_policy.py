"""Learned policies as laws: what they see, what their actions mean, their memory, and what is told
of mistakes.
"""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import vstestbed as vs
from tests.examples import policy as example
from tests.laws.onnx_file import DOUBLE, linear
from vstestbed.core.errors import EnvironmentLackError, ParameterError, ScenarioError
from vstestbed.imaging.chain import scaled
from vstestbed.laws.base import TwistLimits
from vstestbed.laws.policy import Policy, action_unit, observed
from vstestbed.scenario.dump import dump
from vstestbed.scenario.load import parse
from vstestbed.studies.comparison import PLAN
from vstestbed.studies.comparison.plan import chosen, read_comparison
from vstestbed.studies.folder import write_plan
from vstestbed.studies.run_folder import run_into
from vstestbed.testing.laws import quick

EXAMPLE = str(Path(example.__file__))
SCENARIO = """
robot: {kind: free, start: {nominal: {xyz: [0.1, 0.1, -1.2]}}}
camera: {width: 1000, height: 1000, focal_length_m: 0.008, pixel_size_m: 1.0e-5, rate_hz: 10}
target: {kind: square, side: 0.5, pose: {xyz: [0, 0, 0]}, marker: {kind: disc, radius: 0.03}}
detector: oracle
law: {kind: policy, file: "POLICY"}
goal: {T_camera_target: {xyz: [0, 0, 1]}}
"""


def scenario(policy: str, **changes: object) -> vs.Scenario:
    return replace(quick("view"), law=Policy(file=policy), **changes)


def written(folder: Path, text: str, name: str = "mine.py") -> str:
    (folder / name).write_text(text, encoding="utf-8")
    return str(folder / name)


def first_frame(name: str = "arm_ibvs", **law: object):
    made = vs.load(name, {"detector": {"kind": "oracle"}})
    with vs.Session(replace(made, law=Policy(file=f"{EXAMPLE}:act", **law))) as session:
        return session.reset()


class TestWhatItSees:
    def test_pixels_and_no_nan(self):
        frame = first_frame()
        gone = frame.observation.only(np.array([True, False, True, True]))
        seen = observed(gone, frame.goal)
        assert {k: v.shape for k, v in seen.items()} == {
            "markers": (4, 2),
            "seen": (4,),
            "goal": (4, 2),
        }
        assert np.array_equal(seen["seen"], [1, 0, 1, 1])
        assert np.array_equal(seen["markers"][1], [0, 0])
        assert np.array_equal(seen["markers"][0], frame.observation.uv[0].astype(np.float32))
        seen["goal"][:] = 0
        assert frame.goal.uv.any()

    def test_its_own_sensors_only_where_asked_for(self):
        frame = first_frame(agent_pos=True)
        assert np.allclose(
            observed(frame.observation, frame.goal)["agent_pos"], frame.truth.q, atol=1e-3
        )
        assert first_frame().observation.proprioception is None

    def test_of_a_vehicle_the_odometry_and_not_the_place_in_the_world(self, tmp_path: Path):
        law = Policy(
            file=written(tmp_path, "def act(o): return [0.1, 0.0, o['agent_pos'][0]]\n") + ":act",
            agent_pos=True,
        )
        made = replace(
            vs.load("omni_ibvs", {"detector": {"kind": "oracle"}, "robot.wheels": "planar"}),
            law=law,
        )
        with vs.Session(made) as session:
            frames = [session.reset(), *(session.step() for _ in range(9))]
        last = frames[-1]
        moved = observed(last.observation, last.goal)["agent_pos"]
        assert np.array_equal(moved, last.observation.odometry.astype(np.float32))
        assert 0.01 < moved[0] < 0.1 and abs(last.truth.T_world_camera[0, 3] - moved[0]) > 0.1

    def test_a_batch_of_ideal_cameras_has_no_sensors_of_its_own(self):
        from vstestbed.studies.batch import BatchSetup

        with pytest.raises(
            ParameterError, match="policy reads proprioception, which the ideal cameras"
        ):
            BatchSetup(replace(quick("view"), law=Policy(file=f"{EXAMPLE}:act", agent_pos=True)))


class TestActions:
    def test_one_is_the_largest_velocity(self):
        unit = action_unit(TwistLimits(speed_mps=0.2, rate_radps=0.5), np.eye(6))
        assert np.array_equal(unit, [0.2, 0.2, 0.2, 0.5, 0.5, 0.5])

    def test_a_turn_of_the_base_counts_as_a_rate_though_it_moves_the_camera(self):
        omni = vs.load("omni_ibvs").robot
        basis = omni.motion_basis(
            vs.Mount.of(vs.load("omni_ibvs").camera.mount.T), omni.start_joints()
        )
        assert np.array_equal(action_unit(TwistLimits(rate_radps=0.3), basis), [1, 1, 0.3])

    def test_the_twist_keeps_the_limits(self):
        frame = first_frame()
        limits = TwistLimits(speed_mps=0.01, rate_radps=0.01)
        law = Policy(file=f"{EXAMPLE}:act", limits=limits)
        _, command = law.step(law.init(frame.goal), frame.observation, frame.goal, np.eye(6))
        assert limits.scale(command.twist) > 1 - 1e-9 and command.twist.any()


class TestMemory:
    def test_every_run_has_its_own(self):
        law = Policy(file=f"{EXAMPLE}:Smooth")
        loop = replace(quick("view"), law=law)
        one = vs.run(loop)
        assert one.outcome.success
        with vs.Session(loop) as a, vs.Session(loop) as b:
            twists = [[session.reset().command.twist] for session in (a, b)]
            for _ in range(5):
                for session, mine in zip((a, b), twists, strict=True):
                    mine.append(session.step().command.twist)
        assert np.array_equal(twists[0], twists[1])

    def test_an_object_is_copied_and_reset(self, tmp_path: Path):
        text = (
            "class P:\n"
            "  n = 0\n"
            "  def reset(self): self.n = 10\n"
            "  def act(self, o):\n"
            "    self.n += 1; return [self.n / 100] * 6\n"
            "p = P()\n"
        )
        law, frame = Policy(file=written(tmp_path, text) + ":p"), first_frame()
        goal, seen = frame.goal, frame.observation
        first, second = law.init(goal), law.init(goal)
        firsts = [law.step(first, seen, goal, np.eye(6))[1].u[0] for _ in range(2)]
        assert firsts == [0.11, 0.12] and law.step(second, seen, goal, np.eye(6))[1].u[0] == 0.11

    def test_it_goes_on_without_a_marker_unless_its_action_is_nothing(self, tmp_path: Path):
        text = "def act(o): return [0.5] * 6\ndef still(o): return [0] * 6\n"
        frame, file = first_frame(), written(tmp_path, text)
        hidden = frame.observation.only(np.array([True, True, True, False]))
        laws = [Policy(file=f"{file}:{name}") for name in ("act", "still")]
        moves, rests = (
            law.step(law.init(frame.goal), hidden, frame.goal, np.eye(6))[1] for law in laws
        )
        assert moves.rest_reason == "" and np.linalg.norm(moves.twist) > 0
        assert rests.rest_reason == "the policy rests while a marker is out of sight"

    def test_no_action_is_rest_with_a_reason(self, tmp_path: Path):
        loop = scenario(written(tmp_path, "def act(o): return None\n") + ":act")
        recording = vs.run(loop)
        assert (
            recording.outcome is vs.Outcome.target_lost
            and "the policy gave no action" in recording.reason
        )


class TestMistakes:
    @pytest.mark.parametrize(
        ("text", "words"),
        [
            (
                "def act(o):\n    return [1 / 0] * 6\n",
                r"law policy raised ZeroDivisionError: division by zero \(mine.py, line 2\)",
            ),
            (
                "def act(o):\n    return [float('nan')] * 6\n",
                "law policy gave a twist that is not finite",
            ),
            ("def act(o):\n    return o['depth']\n", r"KeyError: 'depth' \(mine.py, line 2\)"),
        ],
    )
    def test_in_a_run(self, tmp_path: Path, text: str, words: str):
        recording = vs.run(scenario(written(tmp_path, text) + ":act"))
        assert recording.outcome is vs.Outcome.law_failed
        assert re.search(words, recording.reason), recording.reason

    @pytest.mark.parametrize(
        ("given", "found"),
        [("[0.0] * 3", r"shape \(3,\)"), ("'left'", "str"), ("[[0.0] * 6]", r"shape \(1, 6\)")],
    )
    def test_of_shape(self, tmp_path: Path, given: str, found: str):
        recording = vs.run(scenario(written(tmp_path, f"def act(o): return {given}\n") + ":act"))
        assert recording.outcome is vs.Outcome.law_failed
        assert re.search(
            rf"act of mine.py:act must return 6 numbers for this robot's motions, got '{found}'",
            recording.reason,
        )

    def test_of_a_class_that_cannot_be_made(self, tmp_path: Path):
        mine = written(tmp_path, "class P:\n    def __init__(self):\n        self.x = 1 / 0\n")
        with pytest.raises(
            ParameterError,
            match=r"mine.py:3: the policy cannot begin \(ZeroDivisionError: division by zero\)",
        ):
            vs.run(scenario(mine + ":P"))

    def test_of_a_class_without_act(self, tmp_path: Path):
        with pytest.raises(ParameterError, match=r"mine\.py:P: P has no method act\(observation\)"):
            vs.run(scenario(written(tmp_path, "class P: pass\n") + ":P"))

    def test_of_the_file_stand_at_its_place_in_the_scenario(self, tmp_path: Path):
        for file, words in (
            (
                "mine.py",
                "needs the form FILE.py:NAME, such as my.py:act, or FILE.onnx, got 'mine.py'",
            ),
            ("gone.py:act", "gone.py is not there; give the place of gone.py"),
            ("mine.py:drive", "mine.py has no function or class 'drive'"),
            ("bad.py:act", "bad.py:2 cannot be imported (ZeroDivisionError: division by zero)"),
            ("ends.py:act", "ends.py:1 cannot be imported (SystemExit: 3)"),
            ("gone.onnx", "gone.onnx is not there; give the place of gone.onnx"),
        ):
            written(tmp_path, "def act(o): return None\n")
            written(tmp_path, "x = 1\ny = 1 / 0\n", "bad.py")
            written(tmp_path, "raise SystemExit(3)\n", "ends.py")
            place = Path(written(tmp_path, SCENARIO.replace("POLICY", file), "mine.yaml"))
            with pytest.raises(ScenarioError) as raised:
                vs.load(place)
            assert len(raised.value.mistakes) == 1
            assert str(raised.value).startswith(f"{place}:6:21: law.file: ")
            assert words in str(raised.value)


class TestWhereItIs:
    def test_beside_the_scenario_and_remembered_for_anywhere(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ):
        lab = tmp_path / "lab"
        lab.mkdir()
        mine = written(lab, Path(EXAMPLE).read_text(encoding="utf-8"))
        made = vs.load(Path(written(lab, SCENARIO.replace("POLICY", "mine.py:act"), "mine.yaml")))
        assert made.law.file == f"{mine}:act" and parse(dump(made, defaults=True), "x.yaml") == made
        monkeypatch.chdir(lab)
        assert (
            vs.load("ibvs_book", {"law": {"kind": "policy", "file": "mine.py:Smooth"}}).law.file
            == f"{mine}:Smooth"
        )
        (tmp_path / "run").mkdir()
        run_into(tmp_path / "run", made, "none", report=False)
        monkeypatch.chdir(tmp_path)
        again = vs.load(tmp_path / "run" / "scenario.yaml")
        assert again == made and vs.run(again).outcome.success

    def test_in_the_plan_of_a_comparison(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
        mine = written(tmp_path, Path(EXAMPLE).read_text(encoding="utf-8"))
        place = written(tmp_path, SCENARIO.replace("POLICY", "mine.py:act"), "mine.yaml")
        monkeypatch.chdir(tmp_path)
        plan = chosen([place], {}, {"law.file": ("mine.py:act", "mine.py:Smooth")}, seeds=2)
        (tmp_path / "out").mkdir()
        write_plan(tmp_path / "out" / PLAN, plan, "base")
        monkeypatch.chdir("/")
        read = read_comparison(tmp_path / "out" / PLAN)
        assert read.axes["law.file"] == (f"{mine}:act", f"{mine}:Smooth")
        assert vs.load(read.base[0]).law.file == f"{mine}:act"


SEES = """import numpy as np


class Sees:
    def __init__(self):
        self.all = []

    def act(self, o):
        self.all.append(o)
        pictures = o["pixels"], o["goal_pixels"]
        here, there = (picture.astype(float).mean(axis=(0, 1)) for picture in pictures)
        return np.r_[0, 0, 0.1, 0, 0, 0.001 * (here - there).sum()]
"""


SMALL = {"camera.width": 160, "camera.height": 120, "stop.duration_s": 0.2}


class TestPictures:
    def made(self, tmp_path: Path, **law: object) -> vs.Scenario:
        file = written(tmp_path, SEES) + ":Sees"
        return vs.load(
            "camera_photometric",
            SMALL | {"law": {"kind": "policy", "file": file, "picture_px": [40, 30]} | law},
        )

    @pytest.mark.app("learn")
    def test_it_sees_this_picture_and_the_goal_s_as_an_environment_scales_them(
        self, tmp_path: Path
    ):
        from vstestbed.env import make

        s = self.made(tmp_path)
        with vs.Session(s, pictures=True) as session:
            frames = [session.reset(3), session.step()]
            law, goal = s.law, frames[0].goal
            act = law.init(goal)
            _, command = law.step(act, frames[1].observation, goal, np.eye(6))
        (seen,) = act.__self__.all
        assert (
            set(seen) == {"pixels", "goal_pixels"}
            and seen["pixels"].shape == (30, 40, 3)
            and seen["pixels"].dtype == np.uint8
        )
        # 4 x 4 pixels each
        mean = frames[1].observation.image.image.reshape(30, 4, 40, 4, 3).mean(axis=(1, 3))
        assert np.abs(seen["pixels"] - mean).max() <= 0.5 + 1e-9
        env = make("camera_photometric", overrides=SMALL, observation="pixels", picture_px=(40, 30))
        assert np.array_equal(
            env.reset(seed=3)[0]["pixels"], scaled(frames[0].observation.image.image, (40, 30))
        )
        y = [seen[name] @ np.array([0.299, 0.587, 0.114]) for name in ("pixels", "goal_pixels")]
        assert command.error_grey == pytest.approx(np.sqrt(np.mean((y[0] - y[1]) ** 2)), abs=0.5)

    def test_a_run_is_judged_by_grey_levels(self, tmp_path: Path):
        run = vs.run(self.made(tmp_path))
        assert (run["error_grey"] > 5).all() and run.summary()["judged_unit"] == "grey levels"
        near = vs.run(
            vs.load(
                "camera_photometric",
                SMALL
                | {
                    "law": self.made(tmp_path).law,
                    "stop.converged.error_grey": 200,
                    "stop.converged.hold_s": 0.1,
                },
            )
        )
        assert near.outcome.name == "converged"

    def test_without_a_picture_it_rests_and_without_the_goal_s_it_says_so(self, tmp_path: Path):
        s = self.made(tmp_path)
        with vs.Session(s, pictures=True) as session:
            frame = session.reset()
        act = s.law.init(frame.goal)
        _, command = s.law.step(act, replace(frame.observation, image=None), frame.goal, np.eye(6))
        assert command.rest_reason == "the law has no picture"
        with pytest.raises(ParameterError, match=r"goal\.image is missing"):
            s.law.step(act, frame.observation, replace(frame.goal, image=None), np.eye(6))

    def test_a_network_takes_pixels(self, tmp_path: Path):
        pytest.importorskip("onnxruntime", reason="the extra vstestbed[policy]")
        (tmp_path / "net.onnx").write_bytes(linear(np.eye(8, 6)))
        with pytest.raises(
            ParameterError, match=r"wants 'markers' .*; a policy sees pixels, goal_pixels as"
        ):
            Policy(file=str(tmp_path / "net.onnx"), picture_px=(40, 30))


HOMES = "HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME", "XDG_STATE_HOME", "TMPDIR"
"""Variables that say where a program may write beside its current folder."""


class TestOnnx:
    W = 0.002 * np.eye(8, 6)

    @pytest.mark.parametrize("kind", [1, DOUBLE])
    def test_a_network_gives_what_it_says(self, tmp_path: Path, kind: int):
        pytest.importorskip("onnxruntime", reason="the extra vstestbed[policy]")
        (tmp_path / "net.onnx").write_bytes(linear(self.W, kind=kind))
        law, frame = Policy(file=str(tmp_path / "net.onnx")), first_frame()
        _, command = law.step(law.init(frame.goal), frame.observation, frame.goal, np.eye(6))
        wanted = np.clip((frame.observation.uv - frame.goal.uv).ravel() @ self.W, -1, 1)
        assert np.allclose(command.u, wanted, atol=1e-6) and wanted.any()

    def test_an_input_that_no_policy_sees(self, tmp_path: Path):
        pytest.importorskip("onnxruntime", reason="the extra vstestbed[policy]")
        (tmp_path / "net.onnx").write_bytes(linear(self.W, inputs=("markers", "image")))
        with pytest.raises(
            ParameterError,
            match=(
                r"file net.onnx wants 'image' as tensor\(float\); a policy sees markers, seen, goal"
            ),
        ):
            Policy(file=str(tmp_path / "net.onnx"))
        (tmp_path / "joints.onnx").write_bytes(linear(self.W, inputs=("markers", "agent_pos")))
        with pytest.raises(ParameterError, match=r"agent_pos needs law.agent_pos: true"):
            Policy(file=str(tmp_path / "joints.onnx"))

    @pytest.mark.process
    @pytest.mark.parametrize("policy", ["net.onnx", "own.py:act"])
    def test_a_run_writes_nothing_outside_its_folder(
        self, policy: str, tmp_path: Path, vstestbed_process: tuple[list[str], dict[str, str]]
    ):
        """The runtime's telemetry would leave a database and an identifier of the machine in the
        user's cache, whoever imports it.
        """
        pytest.importorskip("onnxruntime", reason="the extra vstestbed[policy]")
        words, environment = vstestbed_process
        homes = {name: tmp_path / name for name in HOMES}
        for folder in (*homes.values(), tmp_path / "work"):
            folder.mkdir()
        (tmp_path / "work" / "net.onnx").write_bytes(linear(self.W))
        (tmp_path / "work" / "own.py").write_text(
            "import numpy\nimport onnxruntime\n\n\ndef act(seen):\n    return numpy.zeros(6)\n"
        )
        environment = {k: v for k, v in environment.items() if k != "ORT_DISABLE_TELEMETRY"} | {
            k: str(v) for k, v in homes.items()
        }
        # the oracle: a driver of OpenGL keeps its shaders in the user's cache
        settings = "stop.duration_s=.2", "detector=oracle", f"law={{kind: policy, file: {policy}}}"
        words = [
            *words,
            "run",
            "ibvs_book",
            "--out",
            "out",
            "--video",
            "none",
            *(f"--set={setting}" for setting in settings),
        ]
        ended = subprocess.run(
            words,
            cwd=tmp_path / "work",
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert ended.returncode == 3, ended.stderr
        left = {
            str(path.relative_to(tmp_path))
            for path in tmp_path.rglob("*")
            if path.is_file() and "__pycache__" not in path.parts
        }
        own = {str(Path("work/net.onnx")), str(Path("work/own.py"))}
        assert {name for name in left if not name.startswith(str(Path("work/out")))} == own

    def test_no_network_at_all(self, tmp_path: Path):
        pytest.importorskip("onnxruntime", reason="the extra vstestbed[policy]")
        (tmp_path / "net.onnx").write_bytes(b"no network")
        with pytest.raises(ParameterError, match=r"cannot be read .*works: an ONNX network"):
            Policy(file=str(tmp_path / "net.onnx"))

    def test_without_its_runtime_the_extra_is_named(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ):
        (tmp_path / "net.onnx").write_bytes(linear(self.W))
        monkeypatch.setitem(sys.modules, "onnxruntime", None)
        with pytest.raises(
            EnvironmentLackError,
            match=(
                r"onnxruntime is not installed, which net.onnx needs;"
                r" pip install 'vstestbed\[policy\]'"
            ),
        ):
            vs.load("ibvs_book", {"law": {"kind": "policy", "file": str(tmp_path / "net.onnx")}})


@pytest.mark.parametrize("seed", [0, 1])
def test_the_bundled_policy_reaches_its_goal(seed: int):
    recording = vs.run(vs.load("arm_policy", {"detector": {"kind": "oracle"}}, seed=seed))
    assert recording.outcome.success and recording.summary()["path_ratio"] < 1.1


def test_an_object_that_does_not_tell_of_its_memory_is_copied_for_each_run(tmp_path: Path) -> None:
    act = "def act(self, o):\n    self.n += 1; return [0.01 * self.n, 0, 0, 0, 0, 0]"
    (tmp_path / "leaky.py").write_text(f"class Leak:\n  n = 0\n  {act}\nleak = Leak()\n")
    scenario = vs.load(
        "ibvs_book",
        {
            "law": {"kind": "policy", "file": str(tmp_path / "leaky.py:leak")},
            "stop.duration_s": 0.4,
        },
    )
    first, second = vs.run(scenario), vs.run(scenario)
    assert first["cmd_vx"][0] > 0
    np.testing.assert_array_equal(first.table, second.table)
