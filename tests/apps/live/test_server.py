"""The server of pages without a browser: who is let in, ports, Ctrl-C, a recorded run; a client
that speaks for a page.
"""

from __future__ import annotations

import contextlib
import gc
import http.client
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

import msgspec
import numpy as np
import pytest
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

import vstestbed as vs
from tests.conftest import Ended
from vstestbed.apps.live.app import LiveApp
from vstestbed.apps.live.page import Eye
from vstestbed.apps.live.panel import StatusLine
from vstestbed.apps.live.playback import PlaybackApp, Recorded
from vstestbed.apps.live.run import Sample, Settings
from vstestbed.apps.live.server import Gate, LocalServer
from vstestbed.core.errors import EnvironmentLackError, RunFolderError
from vstestbed.studies.run_folder import new_folder, run_into


def until(condition, seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)  # between two looks at what another thread changes


def own_origin(server: LocalServer) -> str:
    return f"http://127.0.0.1:{server.get_port()}"


def joined(server: LocalServer):
    """A client that speaks for a page of the server."""
    address = server.address.replace("http", "ws", 1)
    return connect(
        address,
        origin=own_origin(server),
        subprotocols=[f"viser-v{viser.__version__}"],
        max_size=None,
    )


def message(**fields: object) -> bytes:
    return msgspec.msgpack.encode(fields)


CAMERA = message(
    type="ViewerCameraMessage",
    wxyz=[1, 0, 0, 0],
    position=[0, 0, 0],
    look_at=[0, 0, 1],
    up_direction=[0, 1, 0],
    fov=1,
    near=0.1,
    far=10,
    image_height=100,
    image_width=100,
)
"""With its first one a page is there for viser."""
SOCKET = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Protocol": f"viser-v{viser.__version__}",
}


def asked(
    server: LocalServer, path: str | None = None, **headers: str
) -> tuple[int, str, dict[str, str]]:
    """Status, text and headers of the answer to a request with these headers; by default for the
    page, as a browser asks for it.
    """
    connection = http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=10)
    names = {name.replace("_", "-"): value for name, value in headers.items()}
    connection.request(
        "GET", urlsplit(server.address).path if path is None else path, headers=names
    )
    answer = connection.getresponse()
    found = (
        answer.status,
        "" if answer.status == 101 else answer.read().decode(),
        dict(answer.headers),
    )
    connection.close()
    return found


@pytest.fixture(scope="class")
def server() -> Iterator[LocalServer]:
    server = LocalServer(None, "test")
    yield server
    server.stop()


@pytest.fixture(scope="class")
def app() -> Iterator[LiveApp]:
    app = LiveApp(Settings("ibvs_book"))
    app.run.transport.play(False)
    thread = threading.Thread(target=app.serve)
    thread.start()
    app.ask(lambda: app.gizmo("target", True))
    yield app
    app.stop()
    thread.join(10)


class TestWhoIsLetIn:
    def test_who_opens_the_address(self, server: LocalServer):
        status, text, headers = asked(server)
        assert status == 200 and "<html" in text and headers["Referrer-Policy"] == "no-referrer"
        # without the last stroke
        assert (
            asked(server, server.address.rpartition("/")[0].removeprefix(own_origin(server)))[0]
            == 200
        )
        assert asked(server, Host=f"localhost:{server.get_port()}")[0] == 200
        with joined(server) as socket_:
            assert len(socket_.recv(timeout=10)) > 0

    def test_a_tunnel_with_another_port_here(self, server: LocalServer):
        assert (
            asked(server, Host="localhost:9000", Origin="http://localhost:9000", **SOCKET)[0] == 101
        )

    @pytest.mark.parametrize(
        "path", ["/", "/index.html", "/AAAAAAAAAAAAAAAAAAAAAA/", "//", "/?websocket=x", "/%FF"]
    )
    @pytest.mark.parametrize("socket_", [{}, SOCKET])
    def test_nobody_without_the_secret(
        self, server: LocalServer, path: str, socket_: dict[str, str]
    ):
        status, text, _ = asked(server, path, Origin=own_origin(server), **socket_)
        assert status == 403 and "Open the whole address" in text and server.address not in text

    def test_nobody_with_a_part_of_the_secret_or_more(self, server: LocalServer):
        path = urlsplit(server.address).path.rstrip("/")
        assert [
            asked(server, wrong)[0]
            for wrong in (path[:-1], f"{path}x", path.swapcase(), f"/x{path}")
        ] == [403] * 4

    @pytest.mark.parametrize(
        "host",
        [
            "example.com",
            "127.0.0.1.example.com",
            "localhost.example.com",
            "me@127.0.0.1",
            "0.0.0.0",
            "",
        ],
    )
    @pytest.mark.parametrize("socket_", [{}, SOCKET])
    def test_no_other_name_of_this_machine(
        self, server: LocalServer, host: str, socket_: dict[str, str]
    ):
        status, text, _ = asked(server, Host=host, Origin=f"http://{host}", **socket_)
        assert status == 403 and "answers only to the names 127.0.0.1 and localhost" in text

    @pytest.mark.parametrize(
        "origin",
        [
            "https://example.com",
            "http://127.0.0.1:1",
            "http://localhost:PORT",
            "https://127.0.0.1:PORT",
            "null",
        ],
    )
    @pytest.mark.parametrize("socket_", [{}, SOCKET])
    def test_no_page_of_another_place(
        self, server: LocalServer, origin: str, socket_: dict[str, str]
    ):
        status, text, _ = asked(
            server, Origin=origin.replace("PORT", str(server.get_port())), **socket_
        )
        assert status == 403 and "its own pages only" in text

    def test_no_socket_without_an_origin(self, server: LocalServer):
        assert (
            asked(server, **SOCKET)[0] == 403
            and asked(server, Origin=own_origin(server), **SOCKET)[0] == 101
        )

    def test_no_page_of_another_version(
        self, server: LocalServer, capfd: pytest.CaptureFixture[str]
    ):
        for protocol in ("viser-v0.0.1", "x"):
            status, text, _ = asked(
                server, Origin=own_origin(server), **SOCKET | {"Sec-WebSocket-Protocol": protocol}
            )
            assert status == 403 and f"pages of viser {viser.__version__} only" in text
        assert capfd.readouterr().out == ""

    def test_nobody_on_another_machine(self, server: LocalServer):
        assert server.get_host() == "127.0.0.1" and server.request_share_url() is None

    def test_each_start_has_a_secret_that_no_log_tells(
        self, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
    ):
        caplog.set_level("DEBUG")
        servers = [LocalServer(None, "test") for _ in range(2)]
        told = [urlsplit(server.address).path.strip("/") for server in servers]
        for server in servers:
            assert asked(server)[0] == 200 and asked(server, "/x")[0] == 403
            with joined(server) as socket_:
                socket_.send(b"rubbish")
            server.stop()
        said = capfd.readouterr()
        # the client's own log tells what it sends
        logs = "".join(
            record.getMessage()
            for record in caplog.records
            if not record.name.startswith("websockets.client")
        )
        assert (
            len(set(told)) == 2
            and not any(secret in f"{logs}{said.out}{said.err}" for secret in told)
            and min(map(len, told)) > 20
        )

    def test_a_viser_that_opens_its_server_in_another_way_is_not_used(
        self, monkeypatch: pytest.MonkeyPatch
    ):
        monkeypatch.setattr(Gate, "before_next_server", lambda self: contextlib.nullcontext())
        with pytest.raises(
            EnvironmentLackError, match="opens its server in a new way; pip install"
        ):
            LocalServer(None, "test")


class TestMalformedMessages:
    @pytest.mark.parametrize(
        "sent",
        [
            "text",
            b"",
            b"\xff\x00rubbish",
            b"\x91" * 5000,
            message(),
            message(type="Nope"),
            message(type="GuiUpdateMessage"),
            message(type="ViewerCameraMessage", wxyz=[1]),
            message(
                type="TransformControlsUpdateMessage", name="/gizmo_target", wxyz=[1], position=[0]
            ),
        ],
    )
    def test_what_is_no_message_is_told_in_a_line(
        self, sent: bytes, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
    ):
        server = LocalServer(None, "test")
        with joined(server) as socket_, pytest.raises(ConnectionClosed):
            socket_.send(sent)
            while True:
                socket_.recv(timeout=10)
        until(lambda: caplog.records)
        server.stop()
        (record,) = [r for r in caplog.records if r.levelname != "DEBUG"]
        assert (
            record.getMessage().startswith(
                "a page was disconnected, since it sent a malformed message: "
            )
            and not record.exc_info
        )
        assert "\n" not in record.getMessage() and "Traceback" not in capfd.readouterr().err

    @pytest.mark.parametrize("value", ["abc", [1], None])
    def test_a_wrong_value_is_told_in_a_line_and_changes_nothing(
        self,
        app: LiveApp,
        value: object,
        caplog: pytest.LogCaptureFixture,
        capfd: pytest.CaptureFixture[str],
    ):
        sliders = {
            h.label: h
            for h in app._server.gui._gui_input_handle_from_uuid.values()
            if isinstance(h, viser.GuiSliderHandle)
        }
        gain = sliders["law.gain"]
        with joined(app._server) as socket_:
            socket_.send(
                message(type="GuiUpdateMessage", uuid=gain._impl.uuid, updates={"value": value})
            )
            # asyncio tells what a task raised when the task is freed
            until(lambda: gc.collect() >= 0 and caplog.records)
        assert caplog.records[0].getMessage().startswith("a message of a page is without effect: ")
        assert (
            "Traceback" not in capfd.readouterr().err
            and gain.value == app.run.scenario.law.gain.value
        )

    def test_a_target_at_no_place_is_refused(self, app: LiveApp):
        with joined(app._server) as socket_:
            socket_.send(CAMERA)
            nowhere = message(
                type="TransformControlsUpdateMessage",
                name="/gizmo_target",
                wxyz=[1, 0, 0, 0],
                position=[float("nan")] * 3,
            )
            socket_.send(nowhere)
            until(lambda: "refused" in app.said)
        assert app.run.by_hand == ()

    def test_what_is_no_request_says_nothing_here(
        self, app: LiveApp, caplog: pytest.LogCaptureFixture
    ):
        for raw in (
            b"rubbish\r\n\r\n",
            b"\x16\x03\x01",
            b"POST / HTTP/1.1\r\nContent-Length: 3\r\n\r\nabc",
        ):
            with socket.create_connection(
                ("127.0.0.1", app._server.get_port()), timeout=10
            ) as stranger:
                stranger.sendall(raw)
                stranger.shutdown(socket.SHUT_WR)
                assert b"200" not in stranger.recv(100)
        assert not [r for r in caplog.records if r.levelname != "DEBUG"]


def test_a_live_run_goes_on_without_pages_and_after_wrong_orders(
    capsys: pytest.CaptureFixture[str],
):
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


def told_and_drawn(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, int]]:
    """What becomes of each frame: (picture, its number), (words, its number)."""
    sent: list[tuple[str, int]] = []
    draw, show = Eye.draw, StatusLine.show

    def drawn(self: Eye, sample: Sample) -> object:
        sent.append(("picture", sample.number))
        return draw(self, sample)

    def told(self: StatusLine, sample: Sample, *more: object) -> None:
        sent.append(("words", sample.number))
        show(self, sample, *more)

    monkeypatch.setattr(Eye, "draw", drawn)
    monkeypatch.setattr(StatusLine, "show", told)
    return sent


def assert_alike(sent: list[tuple[str, int]], least: int) -> None:
    """What is said is always of the frame whose picture was sent last."""
    drawn = -1
    for what, number in sent:
        drawn = number if what == "picture" else drawn
        assert number == drawn
    assert len({number for what, number in sent if what == "words"}) >= least


def test_words_and_picture_of_a_live_run_are_of_one_frame(monkeypatch: pytest.MonkeyPatch):
    sent = told_and_drawn(monkeypatch)
    app = LiveApp(Settings("ibvs_book", {"law.gain": 0.2}))
    thread = threading.Thread(target=app.serve)
    thread.start()
    until(lambda: app.run.frames > 3)  # nobody looks
    with joined(app._server) as page:
        page.send(CAMERA)
        n = app.run.frames
        until(lambda: app.run.frames > n + 5)
    app.stop()
    thread.join(10)
    assert_alike(sent, 2)


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
        until(lambda: "it goes where its carrier goes" in app.said)
        assert app.run.by_hand == ()
        app.stop()
        thread.join(10)


class TestTheCommand:
    def test_a_taken_port_is_told(self, command):
        with socket.socket() as other:
            other.bind(("127.0.0.1", 0))
            other.listen()
            ended: Ended = command("live", "ibvs_book", "--port", other.getsockname()[1])
        assert (
            ended.code == 2
            and "--port is taken; give another one, or none for a free one" in ended.err
        )

    def test_without_viser_it_names_the_extra(self, command, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
        ended: Ended = command("live", "ibvs_book")
        assert ended.code == 4 and "pip install 'vstestbed[live]'" in ended.err

    def test_wrong_settings_are_told_as_of_run(self, command):
        ended: Ended = command("live", "ibvs_book", "--set", "law.gain=-1")
        assert ended.code == 2 and "--set: law.gain: must be > 0, got -1" in ended.err

    @pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGINT for another process")
    @pytest.mark.process
    def test_ctrl_c_ends_it(self, tmp_path: Path):
        words = [sys.executable, "-m", "vstestbed", "live", "ibvs_book", "--no-open"]
        with subprocess.Popen(
            words, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=tmp_path
        ) as process:
            try:
                assert process.stderr is not None
                # before the address it may say that there is no OpenGL
                lines = iter(process.stderr.readline, "")
                assert any(
                    re.match(r"http://127\.0\.0\.1:\d+/[\w-]{20,}/   ", line) for line in lines
                )
                time.sleep(1.0)  # the run is under way, not its start, when it is interrupted
                began = time.monotonic()
                process.send_signal(signal.SIGINT)
                out, err = process.communicate(timeout=20)
            finally:
                process.kill()  # else a failure above would wait for it for ever
        assert (
            process.returncode == 130
            and out == ""
            and err == "interrupted\n"
            and time.monotonic() - began < 5.0
        )
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
        assert (
            len(recorded) == 11
            and first.film.t == 0.0
            and first.verdict is None
            and last.verdict is not None
        )
        assert [recorded.at(t) for t in (-1.0, 0.0, 0.25, 1.0, 99.0)] == [0, 0, 2, 10, 10]
        run = vs.run(recorded.scenario)
        np.testing.assert_array_equal(
            [recorded.sample(i).twist[0] for i in range(11)], run["applied_vx"]
        )
        assert first.judged == run["error_px"][0] and first.unit == "px"

    def test_it_plays_to_its_end_and_back_while_a_page_is_open(self, folder: Path):
        app = PlaybackApp(folder)
        app.transport.set_speed(5.0)
        thread = threading.Thread(target=app.serve)
        thread.start()
        time.sleep(0.5)  # 2.5 s of its time, in which nothing may go on
        assert app.i == 0
        with joined(app._server) as page:
            page.send(CAMERA)
            until(lambda: app.i == 10)
            app.ask(lambda: app.go_to(3))
            until(lambda: app.i != 10)
            until(lambda: app.i == 10)
        app.stop()
        thread.join(10)
        assert not thread.is_alive()

    def test_its_words_and_its_picture_are_of_one_frame(
        self, folder: Path, monkeypatch: pytest.MonkeyPatch
    ):
        sent = told_and_drawn(monkeypatch)
        app = PlaybackApp(folder)
        thread = threading.Thread(target=app.serve)
        thread.start()
        time.sleep(0.3)  # nobody looks
        with joined(app._server) as page:
            page.send(CAMERA)
            until(lambda: app.i == 10)
        app.stop()
        thread.join(10)
        assert_alike(sent, 2)

    def test_a_folder_without_a_run_is_told(self, tmp_path: Path, folder: Path):
        (tmp_path / "scenario.yaml").write_text((folder / "scenario.yaml").read_text())
        with pytest.raises(RunFolderError, match=r"log\.parquet"):
            Recorded(tmp_path)
