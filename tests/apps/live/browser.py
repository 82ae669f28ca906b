"""A headless Chromium, driven through its DevTools protocol."""

from __future__ import annotations

import base64
import itertools
import json
import shutil
import subprocess
import tempfile
import time
import urllib.request
from pathlib import Path
from types import TracebackType
from typing import Any

from websockets.sync.client import connect

NAMES = "chromium", "chromium-browser", "google-chrome", "chrome"
FLAGS = (
    "--headless=new --no-sandbox --disable-dev-shm-usage --no-first-run --disable-extensions"
    " --disable-background-networking --use-angle=swiftshader --enable-unsafe-swiftshader"
    " --remote-debugging-port=0 --remote-allow-origins=*"
)


def chromium() -> str | None:
    """Path of a Chromium on this machine."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


KEYS = {"ArrowRight": 39, "ArrowLeft": 37, "End": 35, "Home": 36}
"""Windows' numbers of keys, which the protocol wants."""


def labelled(label: str) -> str:
    """JavaScript for the control with a label; the last one, where several have it."""
    labels = (
        "[...document.querySelectorAll('label')].filter(l => l.innerText.trim()"
        f" === {json.dumps(label)})"
    )
    return f"document.getElementById({labels}.at(-1)?.htmlFor)"


class Tab:
    """One page."""

    def __init__(self, socket_url: str):
        self._socket = connect(socket_url, max_size=None)
        self._numbers = itertools.count(1)

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Call a DevTools method."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while True:
            answer = json.loads(self._socket.recv(timeout=60))
            if answer.get("id") == number:
                assert "error" not in answer, (method, answer["error"])
                return answer["result"]

    def js(self, expression: str) -> Any:
        """The value of a JavaScript expression, which may be a promise."""
        answer = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def go(self, url: str) -> None:
        """Open a page."""
        self.call("Page.enable")
        self.call("Page.navigate", url=url)

    def wait(self, expression: str, seconds: float = 15.0) -> float:
        """Wait until a JavaScript expression is true; how long it took [s]."""
        began = time.perf_counter()
        while not self.js(expression):
            assert time.perf_counter() - began < seconds, (
                f"not true within {seconds} s: {expression}; the page says {self.text()[:2000]}"
            )
            time.sleep(0.02)  # between two looks at a page that changes by itself
        return time.perf_counter() - began

    def text(self) -> str:
        """What the page says."""
        return str(self.js("document.body ? document.body.innerText : ''"))

    def click(self, words: str) -> None:
        """Click the button with these words."""
        found = (
            "[...document.querySelectorAll('button')].find(b => b.innerText.trim()"
            f" === {json.dumps(words)})"
        )
        self.wait(f"!!({found})")
        self.js(f"{found}.click()")

    def unfold(self, words: str) -> None:
        """Open the folder with these words."""
        self.js(
            "[...document.querySelectorAll('p,div,span,legend')].filter(e => e.innerText?.trim()"
            f" === {json.dumps(words)} && ![...e.children].some(c => c.innerText))[0]?.click()"
        )

    def set_slider(self, label: str, keys: list[str]) -> None:
        """Press keys (ArrowRight, End, ...) on the slider with a label."""
        self.wait(f"!!({labelled(label)})")
        self.js(f"{labelled(label)}.querySelector('[role=slider]').focus()")
        for key in keys:
            for kind in ("keyDown", "keyUp"):
                self.call(
                    "Input.dispatchKeyEvent",
                    type=kind,
                    key=key,
                    code=key,
                    windowsVirtualKeyCode=KEYS[key],
                )

    def type_into(self, label: str, text: str) -> None:
        """Replace what is in the field with a label, and leave it."""
        self.wait(f"!!({labelled(label)})")
        inner = f"(e => e.matches('input') ? e : e.querySelector('input'))({labelled(label)})"
        self.js(f"(i => {{ i.focus(); i.select() }})({inner})")
        self.call("Input.insertText", text=text)
        self.js("document.activeElement.blur()")

    def choose(self, label: str, word: str) -> None:
        """Choose a word from the menu with a label."""
        self.wait(f"!!({labelled(label)})")
        self.js(f"{labelled(label)}.click()")
        option = (
            "[...document.querySelectorAll('[role=option]')].find(o => o.innerText.trim()"
            f" === {json.dumps(word)})"
        )
        self.wait(f"!!({option})")
        self.js(f"{option}.click()")

    def value(self, label: str) -> str:
        """What the field, or the slider, with a label shows."""
        found = labelled(label)
        return str(
            self.js(
                f"(() => {{ const e = {found}; const s = e.querySelector('[role=slider]');"
                " return s ? s.ariaValueNow : e.value })()"
            )
        )

    def screenshot(self, path: Path | None = None) -> bytes:
        """What the page looks like, as PNG."""
        png = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        if path is not None:
            path.write_bytes(png)
        return png

    def close(self) -> None:
        """Close the connection, and with it nothing of the page."""
        self._socket.close()


class Browser:
    """A browser with its own profile; a context manager."""

    def __init__(self, width: int = 1500, height: int = 900):
        program = chromium()
        assert program is not None
        self._profile = tempfile.mkdtemp(prefix="vstestbed-chromium-")
        command = [
            program,
            *FLAGS.split(),
            f"--user-data-dir={self._profile}",
            f"--window-size={width},{height}",
            "about:blank",
        ]
        self._process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        self._port = self._devtools_port()

    def _devtools_port(self) -> int:
        path, until = Path(self._profile) / "DevToolsActivePort", time.monotonic() + 60
        while not (path.is_file() and path.read_text().strip()):
            assert time.monotonic() < until and self._process.poll() is None, (
                "Chromium does not start"
            )
            time.sleep(0.05)  # between two looks for a file of another process
        return int(path.read_text().split()[0])

    def tab(self, url: str) -> Tab:
        """A new tab with a page."""
        request = urllib.request.Request(
            f"http://127.0.0.1:{self._port}/json/new?about:blank", method="PUT"
        )
        with urllib.request.urlopen(request, timeout=30) as answer:
            tab = Tab(json.load(answer)["webSocketDebuggerUrl"])
        tab.go(url)
        return tab

    def __enter__(self) -> Browser:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.terminate()
        self._process.wait(20)
        shutil.rmtree(self._profile, ignore_errors=True)
