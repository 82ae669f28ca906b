"""A recorded run in the browser, with a slider for its time; the same scene, picture and curves as
of one that goes on.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from vstestbed.apps.live.app import IDLE_S
from vstestbed.apps.live.page import LiveView
from vstestbed.apps.live.panel import StatusLine, on_change, transport_panel
from vstestbed.apps.live.run import Sample, Served, Transport, sample
from vstestbed.apps.live.server import LocalServer
from vstestbed.core.errors import NOTHING_RAN, RunFolderError
from vstestbed.loop.log_file import open_log
from vstestbed.report.video.film import ending_of
from vstestbed.report.video.overlay import FilmFrame
from vstestbed.scenario.dump import load_run
from vstestbed.tasks.metrics import TWIST

SLIDER = "slider"  # key of the orders of the time slider


class Recorded:
    """The samples of a recorded run. Raises RunFolderError: no run, a damaged one, or one without
    frames.
    """

    def __init__(self, folder: Path, plugins: Sequence[str] = ()):
        self.scenario = load_run(folder, plugins)
        log = open_log(folder, self.scenario)
        if not len(log):
            raise RunFolderError(
                folder, "has a log without frames; there is nothing to show", NOTHING_RAN
            )
        self._log = log
        self._ending = ending_of(folder)
        self.t = log["t"]

    def __len__(self) -> int:
        return len(self._log)

    def sample(self, i: int) -> Sample:
        """Frame i."""
        row = dict(zip(self._log.columns, self._log.table[i].tolist(), strict=True))
        film = FilmFrame.of_row(row, self.scenario)
        twist = np.array([row[f"applied_{name}"] for name in TWIST])
        ending = self._ending if i == len(self) - 1 else None
        return sample(self.scenario, film, row, twist, ending)

    def at(self, t: float) -> int:
        """Number of the last frame that is not after a time [s]; the first one before all."""
        return max(0, int(np.searchsorted(self.t, t + 1e-9, side="right")) - 1)


class PlaybackApp(Served):
    """A recorded run in the browser, at `address`; i: number of the frame that is shown. Errors:
    those of `Recorded` and `LiveApp`.
    """

    def __init__(self, folder: Path, port: int | None = None, plugins: Sequence[str] = ()):
        self.recorded = Recorded(folder, plugins)
        self.i = 0
        super().__init__()
        self.transport = Transport()
        self._sample = self.recorded.sample(0)
        self._server = LocalServer(port, f"{self.recorded.scenario.name}: recorded")
        self.address = self._server.address
        self._view = LiveView(self._server, self.recorded.scenario, self._sample, recorded=True)
        gui = self._server.gui
        self._status = StatusLine(gui)
        transport_panel(gui, self._inbox, self.transport, lambda: self.go_to(0))
        last = float(self.recorded.t[-1])
        self._slider = gui.add_slider("t [s]", 0.0, max(last, 1e-3), max(1e-3, last / 1000), 0.0)
        on_change(
            self._slider, lambda t: self._inbox.put(lambda: self.go_to(self.recorded.at(t)), SLIDER)
        )
        gui.main_panel.dock_right()
        self.go_to(0)

    def serve(self) -> None:
        """Play the run while a page is open, and obey its pages, until `stop` or an interrupt."""
        try:
            while not self._stop.is_set():
                self._once()
        finally:
            self._server.stop()
            self._view.close()

    def _once(self) -> None:
        wait = self._wait_s()
        orders = self._inbox.take(IDLE_S if wait is None else min(wait, IDLE_S))
        for order in orders:
            order()
        if orders:
            self._view.draw(self._sample, self._tell, now=True)
        if self._wait_s() == 0.0:
            self._show(self.i + 1)
            self.transport.passed(self._sample.film.t)

    def _wait_s(self) -> float | None:
        """How long the next frame is not due [s]; None where none is to come: paused, at the end,
        or nobody looks.
        """
        ended = self.i + 1 >= len(self.recorded)
        if ended or not self._server.get_clients():
            return None
        return self.transport.wait_s(self._sample.film.t)

    def go_to(self, i: int) -> None:
        """Show another frame (by the thread that serves),
        with the curves and the trail up to it.
        """
        self._view.forget()
        every = max(1, i // 300)
        for earlier in range(0, i, every):
            self._view.add(self.recorded.sample(earlier))
        self.transport.restart_pace()
        self._show(i, now=True)

    def _show(self, i: int, now: bool = False) -> None:
        self.i = i
        self._sample = self.recorded.sample(i)
        self._view.add(self._sample)
        self._view.draw(self._sample, self._tell, now or i + 1 == len(self.recorded))

    def _tell(self) -> None:
        self._status.show(self._sample, self.transport)
        if not self._inbox.waits(SLIDER) and math.isfinite(self._sample.film.t):
            self._slider.value = self._sample.film.t
