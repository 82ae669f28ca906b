"""The server of pages without a browser: who is let in, ports, Ctrl-C, a recorded run; a client that speaks for a page."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

import vstestbed as vs
from tests.conftest import Ended
from vstestbed.core.errors import RunFolderError
from vstestbed.experiments.run_folder import new_folder, run_into
from vstestbed.live.app import LiveApp
from vstestbed.live.playback import PlaybackApp, Recorded
from vstestbed.live.server import LocalServer
from vstestbed.live.settings import Settings


def until(condition, seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)  # between two looks at what another thread changes


class TestWhoIsLetIn:
    @pytest.fixture
    def server(self):
        server = LocalServer(None, "test")
        yield server
        server.stop()

    def joined(self, server: LocalServer, origin: str | None):
        address = server.address.replace("http", "ws", 1)
        return connect(address, origin=origin, subprotocols=[f"viser-v{viser.__version__}"], max_size=None)

    @pytest.mark.parametrize("origin", [None, "http://127.0.0.1:1234", "http://localhost:80"])
    def test_pages_of_this_machine(self, server: LocalServer, origin: str | None):
        with self.joined(server, origin) as socket_:
            assert len(socket_.recv(timeout=10)) > 0

    @pytest.mark.parametrize("origin", ["https://example.com", "http://127.0.0.1.example.com", "null"])
    def test_no_page_of_another_site(self, server: LocalServer, origin: str, caplog: pytest.LogCaptureFixture):
        with self.joined(server, origin) as socket_, pytest.raises(ConnectionClosed):
            socket_.recv(timeout=10)
        assert not caplog.records

    def test_nobody_on_another_machine(self, server: LocalServer):
        assert server.get_host() == "127.0.0.1" and server.request_share_url() is None


def test_a_live_run_goes_on_without_pages_and_after_wrong_orders(capsys: pytest.CaptureFixture[str]):
    app = LiveApp(Settings("ibvs_book", {"law.gain": 0.2}))
    thread = threading.Thread(target=app.serve)
    thread.start()
    until(lambda: app.run.frames > 2)

    def wrong() -> None:
        raise ZeroDivisionError("a bug")

    app.ask(wrong)
    app.ask(lambda: app.run.change("law.gain", -1.0))
    n = app.run.frames
    until(lambda: app.run.frames > n + 2)
    assert app.said == r"**refused:** law.gain: must be \> 0, got -1.0"
    app.stop()
    thread.join(10)
    assert not thread.is_alive() and capsys.readouterr().out == ""


def test_a_law_that_fails_ends_the_run_and_not_the_server(monkeypatch: pytest.MonkeyPatch):
    app = LiveApp(Settings("ibvs_book"))
    thread = threading.Thread(target=app.serve)

    def broken(*_: object) -> None:
        raise ValueError("no matrix")

    with monkeypatch.context() as patch:
        patch.setattr(type(app.run.scenario.law), "step", broken)
        thread.start()
        until(lambda: app.run.ended)
    assert app.run.frame.outcome.name == "law_failed" and "no matrix" in app.run.last.verdict[1]
    app.ask(app.reset)
    until(lambda: app.run.restarts == 2 and app.run.frames > 2)
    app.stop()
    thread.join(10)


class TestGizmos:
    def test_a_plate_is_held_let_go_and_gone_after_a_reset(self):
        app = LiveApp(Settings("arm_ibvs"))
        app.run.transport.play(False)
        thread = threading.Thread(target=app.serve)
        thread.start()
        app.ask(lambda: app.gizmo("plate", True))
        until(lambda: app.run.by_hand == ("plate held",))
        app.ask(app.run.transport.step)
        until(lambda: app.run.frames == 2)
        assert not app.run.frame.observation.seen[0]
        app.ask(lambda: app.gizmo("target", True))
        app.ask(app.reset)
        until(lambda: app.run.restarts == 2)
        app.ask(app.run.transport.step)
        until(lambda: app.run.frames == 2)
        assert app.run.frame.observation.seen.all() and app.run.by_hand == ()
        app.stop()
        thread.join(10)

    def test_a_target_that_is_carried_has_none(self):
        app = LiveApp(Settings("arm_eye_to_hand"))
        app.run.transport.play(False)
        thread = threading.Thread(target=app.serve)
        thread.start()
        app.ask(lambda: app.gizmo("target", True))
        until(lambda: "is carried, and goes where its carrier goes" in app.said)
        assert app.run.by_hand == ()
        app.stop()
        thread.join(10)


class TestTheCommand:
    def test_a_taken_port_is_told(self, command):
        with socket.socket() as other:
            other.bind(("127.0.0.1", 0))
            other.listen()
            ended: Ended = command("live", "ibvs_book", "--port", other.getsockname()[1])
        assert ended.code == 2 and "--port is taken; give another one, or none for a free one" in ended.err

    def test_without_viser_it_names_the_extra(self, command, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
        ended: Ended = command("live", "ibvs_book")
        assert ended.code == 4 and "pip install 'vstestbed[live]'" in ended.err

    def test_wrong_settings_are_told_as_of_run(self, command):
        ended: Ended = command("live", "ibvs_book", "--set", "law.gain=-1")
        assert ended.code == 2 and "--set: law.gain: must be > 0, got -1" in ended.err

    @pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT for another process")
    def test_ctrl_c_ends_it(self, tmp_path: Path):
        words = [sys.executable, "-m", "vstestbed", "live", "ibvs_book", "--no-open"]
        with subprocess.Popen(words, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=tmp_path) as process:
            try:
                assert process.stderr is not None
                lines = iter(process.stderr.readline, "")  # before the address it may say that there is no OpenGL
                assert any(line.startswith("http://127.0.0.1:") for line in lines)
                time.sleep(1.0)  # the run is under way, not its start, when it is interrupted
                began = time.monotonic()
                process.send_signal(signal.SIGINT)
                out, err = process.communicate(timeout=20)
            finally:
                process.kill()  # else a failure above would wait for it for ever
        assert process.returncode == 130 and out == "" and err == "interrupted\n" and time.monotonic() - began < 5.0
        assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run of a second."""
    scenario = vs.load("ibvs_book", {"stop.duration_s": 1.0})
    made = new_folder(scenario, tmp_path_factory.mktemp("run") / "recorded")
    run_into(made, scenario, "none", report=False)
    return made


class TestPlayback:
    def test_its_samples_are_those_of_the_log(self, folder: Path):
        recorded = Recorded(folder)
        first, last = recorded.sample(0), recorded.sample(len(recorded) - 1)
        assert len(recorded) == 11 and first.film.t == 0.0 and first.verdict is None and last.verdict is not None
        assert [recorded.at(t) for t in (-1.0, 0.0, 0.25, 1.0, 99.0)] == [0, 0, 2, 10, 10]
        run = vs.run(recorded.scenario)
        np.testing.assert_array_equal([recorded.sample(i).twist[0] for i in range(11)], run["applied_vx"])
        assert first.judged == run["error_px"][0] and first.unit == "px"

    def test_it_plays_to_its_end_and_back(self, folder: Path):
        app = PlaybackApp(folder)
        app.transport.set_speed(5.0)
        thread = threading.Thread(target=app.serve)
        thread.start()
        until(lambda: app.i == 10)
        app.ask(lambda: app.go_to(3))
        until(lambda: app.i != 10)
        until(lambda: app.i == 10)
        app.stop()
        thread.join(10)
        assert not thread.is_alive()

    def test_a_folder_without_a_run_is_told(self, tmp_path: Path, folder: Path):
        (tmp_path / "scenario.yaml").write_text((folder / "scenario.yaml").read_text())
        with pytest.raises(RunFolderError, match=r"log\.parquet"):
            Recorded(tmp_path)
