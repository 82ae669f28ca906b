"""What is behind the page: settings, the fields that get controls, pace, and the run itself."""

from __future__ import annotations

import math
import threading
from pathlib import Path

import numpy as np
import pytest

import vstestbed as vs
from tests.robots.arms import where_installed
from vstestbed.apps.live.panel import fields_of
from vstestbed.apps.live.run import Inbox, LiveRun, Settings, Transport
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.named_files import bundled_scenarios

IDEAL = "ibvs_book"  # no body and no pictures of its own: the quickest


class TestSettings:
    def test_a_change_is_what_set_does(self):
        settings = Settings("arm_ibvs", {"law.gain": 0.7})
        settings.change("camera.latency_s", 0.1)
        assert settings.change("law.feature", "polar") == vs.load(
            "arm_ibvs", {"law.gain": 0.7, "camera.latency_s": 0.1, "law.feature": "polar"}
        )

    def test_a_refused_one_changes_nothing(self):
        settings = Settings("arm_ibvs")
        for path, value in (
            ("law.gain", -1),
            ("law.gain", "much"),
            ("law.depth", "oracle"),
            ("lwa.gain", 1),
            ("seed", -1),
            ("seed", 1.5),
        ):
            with pytest.raises(ScenarioError, match=path.partition(".")[0]):
                settings.change(path, value)
        assert settings.scenario == vs.load("arm_ibvs") and settings.seed is None

    def test_what_is_set_inside_a_block_goes_with_it(self):
        settings = Settings("arm_ibvs")
        settings.change("law.gain", {"kind": "adaptive"})
        settings.change("law.gain.at_zero", 3.0)
        assert settings.change("law.gain", 0.5) == vs.load("arm_ibvs")

    def test_a_seed_is_that_of_the_command_line_and_none_the_files_start(self):
        settings = Settings("arm_ibvs")
        assert settings.change("seed", 4) == vs.load("arm_ibvs").randomised(4)
        assert settings.change("seed", None) == vs.load("arm_ibvs")

    def test_one_coefficient_of_the_distortion_keeps_the_others(self):
        settings = Settings("arm_ibvs")
        settings.change("camera.distortion.0", -0.05)
        assert settings.change("camera.distortion.1", 0.02).camera.distortion == (
            -0.05,
            0.02,
            0.0,
            0.0,
            0.0,
        )

    def test_a_page_cannot_load_a_plugin(self):
        with pytest.raises(ScenarioError, match="command line alone"):
            Settings("arm_ibvs").change("plugins", ["/tmp/x.py"])

    @pytest.mark.parametrize(
        ("path", "value"),
        [
            ("law", {"kind": "policy", "file": "HERE/code.py:act"}),
            ("law", {"kind": "policy", "file": "code.py:act"}),
            ("law", {"kind": "policy", "file": "HERE/net.onnx"}),
            (
                "law",
                {
                    "kind": "switched",
                    "turns": [{"law": {"kind": "policy", "file": "HERE/code.py:act"}}],
                },
            ),
            ("law.file", "code.py:act"),
            ("law.weights", "code.py"),
            ("randomise", [{"field": "law.file", "choice": ["HERE/code.py:act"]}]),
            ("robot", {"kind": "mjcf", "file": "HERE/model.xml", "flange": "x"}),
            ("robot", {"kind": "mjcf", "file": "package:numpy/model.xml", "flange": "x"}),
            ("robot.file", "line"),  # a word, too
            ("target", {"kind": "picture", "file": "HERE/picture.png", "width": 0.2}),
            ("target", {"kind": "mesh", "file": "~/solid.stl"}),
            ("goal.picture", "HERE/picture.png"),
            ("goal.picture", {"file": "picture.png"}),
            ("world.scenery", "HERE/model.xml"),
            ("world.scenery.file", "..\\model.xml"),
            ("world.floor.texture", "HERE/picture.png"),
            ("world.floor.texture", b"picture.png"),
            ("camera.mount", "HERE/hand_eye.yaml"),
            ("calibration", "HERE/hand_eye.yaml"),
            ("robot.realism", "HERE/robot.yaml"),
            ("name", "../../elsewhere"),
        ],
    )
    def test_a_page_can_name_no_file(
        self, path: str, value: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ):
        monkeypatch.chdir(tmp_path)
        (tmp_path / "code.py").write_text(
            f"open({str(tmp_path / 'ran')!r}, 'w')\ndef act(seen): pass\n"
        )
        for name in ("net.onnx", "model.xml", "picture.png", "line"):
            (tmp_path / name).touch()
        settings = Settings("arm_ibvs")

        def here(plain: object) -> object:
            if isinstance(plain, dict):
                return {key: here(inner) for key, inner in plain.items()}
            if isinstance(plain, list):
                return [here(inner) for inner in plain]
            return plain.replace("HERE", str(tmp_path)) if isinstance(plain, str) else plain

        with pytest.raises(ScenarioError, match="is no word of this scenario; "):
            settings.change(path, here(value))
        assert settings.scenario == vs.load("arm_ibvs") and not (tmp_path / "ran").exists()

    def test_a_level_of_realism_is_a_word(self):
        assert Settings("arm_ibvs").change("robot.realism", "lab").robot.realism == "lab"

    def test_a_file_of_the_command_line_may_be_named_again(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ):
        monkeypatch.chdir(tmp_path)
        (tmp_path / "mine.py").write_text(
            "def act(seen): return None\n\ndef other(seen): return None\n"
        )
        settings = Settings("arm_ibvs", {"law": {"kind": "policy", "file": "mine.py:act"}})
        settings.change("law", "pbvs")
        assert (
            settings.change("law", {"kind": "policy", "file": "mine.py:act"}).law.kind == "policy"
        )
        with pytest.raises(ScenarioError, match=r"'mine\.py:other' is no word of this scenario"):
            settings.change("law.file", "mine.py:other")

    def test_a_word_with_a_slip_has_its_nearest(self):
        with pytest.raises(
            ScenarioError, match="'poler' is no word of this scenario; did you mean 'polar'"
        ):
            Settings("arm_ibvs").change("law.feature", "poler")

    def test_a_bundled_texture_may_be_named(self):
        assert (
            Settings("arm_ibvs").change("world.floor.texture", "texture:brick").world.floor.texture
            == "texture:brick"
        )

    def test_a_saved_scenario_is_read_as_the_same(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ):
        monkeypatch.chdir(tmp_path)
        settings = Settings("arm_ibvs", seed=3)
        settings.change("law.gain", 0.9)
        first, second = settings.keep(), settings.keep("Pushed.")
        assert (
            vs.load(first) == settings.scenario
            and first.parent.name == "001"
            and second.parent.name == "002"
        )
        assert vs.load(second).description.endswith("Pushed.")


class TestFields:
    @pytest.mark.parametrize("name", where_installed(sorted(bundled_scenarios())))
    def test_every_value_in_force_is_accepted_again(self, name: str):
        scenario = vs.load(name)
        fields = fields_of(scenario)
        keys = [(f.path, f.control == "choice") for f in fields]
        assert len(keys) == len(set(keys))
        assert {f.path.partition(".")[0] for f in fields} >= {
            "law",
            "camera",
            "noise",
            "timing",
            "seed",
        }
        for field in fields:
            if field.control == "slider":
                assert field.low <= field.value <= field.high and field.step > 0, field
            if field.control == "choice":
                assert field.value in field.choices, field

    def test_sliders_have_what_counts(self):
        sliders = {f.path: f for f in fields_of(vs.load("arm_ibvs")) if f.control == "slider"}
        gain = sliders["law.gain"]
        assert (gain.low, gain.high, gain.step, gain.value) == (0.02, 4.0, 0.02, 0.5)
        assert {
            "camera.latency_s",
            "noise.image_sigma",
            "noise.pixel_sigma_px",
            "camera.distortion.0",
        } <= set(sliders)
        menus = {f.path: f.choices for f in fields_of(vs.load("arm_ibvs")) if f.control == "choice"}
        assert (
            menus["law.interaction"] == ("current", "desired", "mean")
            and "polar" in menus["law.feature"]
        )
        assert (
            menus["robot.actuation"] == ("ideal", "industrial", "raw")
            and "estimate" in menus["law.depth"]
        )

    @pytest.mark.parametrize(
        ("name", "gains"),
        [
            ("arm_ibvs", ["law.gain"]),
            ("arm_partitioned", ["law.gain", "law.gain_z", "law.gain_turn", "law.gain_xy"]),
            ("arm_policy", []),
        ],
    )
    def test_gains_latency_noise_and_rate_come_first(self, name: str, gains: list[str]):
        fields = fields_of(vs.load(name))
        first = [f.path for f in fields if f.comes_first]
        assert first == [
            *gains,
            "camera.latency_s",
            "noise.image_sigma",
            "noise.pixel_sigma_px",
            "camera.rate_hz",
            "seed",
        ]
        assert [f.path for f in fields[: len(first)]] == first
        assert [f.label for f in fields if f.path == "camera.latency_s"] == ["camera.latency_s"]

    def test_an_ends_of_a_slider_are_valid(self):
        settings = Settings("arm_ibvs")
        for field in fields_of(settings.scenario):
            if field.control == "slider" and field.path.startswith(
                ("law.gain", "noise", "camera.latency")
            ):
                settings.change(field.path, field.low)
                settings.change(field.path, field.high)
                settings.change(field.path, field.value)
        assert settings.scenario == vs.load("arm_ibvs")


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class TestTransport:
    def test_frames_are_due_at_their_speed(self):
        clock = Clock()
        transport = Transport(clock)
        assert transport.wait_s(0.0) == 0.0
        clock.now += 0.01
        assert transport.wait_s(0.04) == pytest.approx(0.03)
        transport.set_speed(0.5)
        assert transport.wait_s(0.04) == 0.0 and transport.wait_s(0.08) == pytest.approx(0.08)
        transport.set_speed(math.inf)
        assert transport.wait_s(0.08) == 0.0 and transport.wait_s(50.0) == 0.0

    def test_one_that_is_late_does_not_hurry_for_ever(self):
        clock = Clock()
        transport = Transport(clock)
        transport.wait_s(0.0)
        clock.now += 10.0
        assert transport.wait_s(0.04) == 0.0
        assert transport.wait_s(0.08) == pytest.approx(0.04)

    def test_steps_are_counted_and_a_new_run_forgets_them(self):
        transport = Transport(Clock())
        transport.step()
        transport.step()
        assert not transport.playing
        assert transport.wait_s(0.0) == 0.0
        transport.passed(0.04)
        assert transport.wait_s(0.04) == 0.0
        transport.passed(0.08)
        assert transport.wait_s(0.08) is None
        transport.step()
        transport.begin()
        assert transport.wait_s(0.0) is None

    def test_the_pace_is_measured(self):
        clock = Clock()
        transport = Transport(clock)
        assert math.isnan(transport.pace)
        for i in range(20):
            clock.now += 0.1
            transport.passed(0.04 * i)
        assert transport.pace == pytest.approx(0.4)


class TestInbox:
    def test_of_one_key_the_last_stays_and_clicks_all(self):
        inbox, done = Inbox(), []
        for i in range(3):
            inbox.put(lambda i=i: done.append(("gain", i)), "gain")
            inbox.put(lambda i=i: done.append(("step", i)))
        assert inbox.waits("gain") and not inbox.waits("seed")
        for order in inbox.take(0.0):
            order()
        assert (
            done == [("step", 0), ("step", 1), ("gain", 2), ("step", 2)] and inbox.take(0.0) == []
        )

    def test_it_wakes_who_waits(self):
        inbox = Inbox()
        threading.Timer(0.05, inbox.put, [lambda: None]).start()
        assert len(inbox.take(20.0)) == 1


class TestRun:
    def test_a_gain_is_in_the_next_command_without_a_new_start(self):
        run, twin = LiveRun(Settings("arm_ibvs")), LiveRun(Settings("arm_ibvs"))
        for _ in range(3):
            run.turn()
            twin.turn()
        assert run.change("law.gain", 1.0) is False
        run.turn()
        twin.turn()
        np.testing.assert_allclose(
            run.frame.command.twist, 2 * twin.frame.command.twist, rtol=1e-12
        )
        assert run.restarts == 1 and run.by_hand == ("law",)
        assert (
            "Changed by hand during the run: law from 0.12 s on"
            in run.session.recording().scenario.description
        )
        run.close()
        twin.close()

    @pytest.mark.parametrize(
        ("path", "value"),
        [("law.feature", "polar"), ("camera.latency_s", 0.08), ("seed", 2), ("law.depth", "goal")],
    )
    def test_what_cannot_change_under_way_starts_again(self, path: str, value: object):
        run = LiveRun(Settings("arm_ibvs"))
        run.turn()
        assert (
            run.change(path, value) is True
            and run.restarts == 2
            and run.frames == 1
            and run.frame.timing.number == 0
        )
        assert run.by_hand == ()
        run.close()

    def test_a_refused_setting_leaves_the_run(self):
        run = LiveRun(Settings(IDEAL))
        with pytest.raises(ScenarioError):
            run.change("law.gain", -1.0)
        with pytest.raises(ParameterError, match="needs a robot with a mass"):
            run.push(np.array([1.0, 0, 0]), 0.1)
        run.turn()
        assert run.frames == 2 and run.restarts == 1 and run.scenario == vs.load(IDEAL)
        run.close()

    def test_a_run_that_cannot_start_leaves_the_one_before(self, monkeypatch: pytest.MonkeyPatch):
        run = LiveRun(Settings(IDEAL))
        before = run.scenario

        def fails(self: object, seed: object = None) -> None:
            raise vs.errors.SessionError(
                "the run ended before a picture arrived", "change the camera's timing"
            )

        with monkeypatch.context() as patch:
            patch.setattr(vs.Session, "reset", fails)
            with pytest.raises(vs.errors.SessionError):
                run.change("noise.pixel_sigma_px", 1.0)
        run.turn()
        assert run.scenario == before and run.restarts == 1
        run.close()

    def test_its_end_is_an_outcome_and_it_can_be_reset(self):
        run = LiveRun(Settings(IDEAL, {"stop.duration_s": 0.5}))
        while run.wait_s() is not None:
            run.turn()
        assert (
            run.ended
            and run.last.verdict is not None
            and run.last.verdict[1] == "0.5 s were not enough"
        )
        with pytest.raises(ParameterError, match="has ended; reset it first"):
            run.move_target(np.eye(4))
        run.restart()
        assert not run.ended and run.frames == 1
        run.close()

    def test_the_plate_hides_its_marker(self):
        run = LiveRun(Settings("arm_ibvs"))
        run.turn()
        run.hold_plate(run.before_marker(2))
        run.turn()
        assert np.flatnonzero(~run.frame.observation.seen).tolist() == [2]
        run.hold_plate(None)
        run.turn()
        assert run.frame.observation.seen.all() and run.by_hand == ("plate held",)
        run.close()
