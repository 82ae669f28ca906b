"""The live view of a run: one thread turns the session and sends what is due; pages only put orders
into its inbox.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

import viser

from vstestbed.apps.live.page import LiveView, add_gizmo
from vstestbed.apps.live.panel import Controls, HandPanel, StatusLine, on_click, transport_panel
from vstestbed.apps.live.run import SEED, LiveRun, Served, Settings
from vstestbed.apps.live.server import LocalServer
from vstestbed.core.errors import ScenarioError, VstestbedError
from vstestbed.core.geometry import Array
from vstestbed.scenario.yaml_marks import read_value

# how long a view that rests waits for orders before it looks whether it has to end [s]
IDLE_S = 0.2


class LiveApp(Served):
    """A run in the browser, at `address`. port: None for a free one. Raises ParameterError: the
    port is taken.
    """

    def __init__(self, settings: Settings, port: int | None = None):
        self.run = LiveRun(settings)
        super().__init__()
        self._gizmos: dict[str, viser.TransformControlsHandle] = {}
        scenario = self.run.scenario
        try:
            self._server = LocalServer(port, scenario.name)
        except BaseException:
            self.run.close()
            raise
        self.address = self._server.address
        self._view = LiveView(self._server, scenario, self.run.last)
        self._add_panel()
        self._server.gui.main_panel.dock_right()
        self._view.add(self.run.last)
        self._show(now=True)

    def _add_panel(self) -> None:
        gui = self._server.gui
        inbox = self._inbox
        run = self.run
        self._status = StatusLine(gui)
        transport_panel(gui, inbox, run.transport, self.reset)
        self._controls = Controls(
            gui,
            run.settings.scenario,
            lambda path, value: inbox.put(lambda: self.change(path, value), path),
            inbox.waits,
        )
        with gui.add_folder("any other field", expand_by_default=False):
            field = gui.add_text("field", "goal.T_camera_target.xyz")
            value = gui.add_text("value", "[0, 0, 0.8]")
            set_ = gui.add_button("set", hint="as --set field=value")
            on_click(set_, inbox, lambda: self.change(field.value, read_value(value.value)))
        self._hand = HandPanel(gui, inbox, run, self.gizmo)
        start = gui.add_button("start without a seed", hint="the scenario's own start")
        on_click(start, inbox, lambda: self.change(SEED, None))
        hint = "what repeats these settings from the start"
        on_click(gui.add_button("save as scenario", hint=hint), inbox, self._save)

    def serve(self) -> None:
        """Turn the run and obey its pages, until `stop` or an interrupt."""
        try:
            while not self._stop.is_set():
                self._once()
        finally:
            self.close()

    @property
    def said(self) -> str:
        """The sentence that pages show."""
        return self._status.message

    def close(self) -> None:
        """Free page and simulation."""
        self._server.stop()
        self._view.close()
        self.run.close()

    def _once(self) -> None:
        wait = self.run.wait_s()
        orders = self._inbox.take(IDLE_S if wait is None else min(wait, IDLE_S))
        for order in orders:
            self._tried(order)
        if orders:
            self._show(now=self.run.wait_s() is None)
        if self.run.wait_s() == 0.0:
            self._tried(self._turn)
            self._show(now=self.run.wait_s() is None)

    def _turn(self) -> None:
        try:
            self.run.turn()
        except BaseException:
            self.run.transport.play(False)  # else the same failure would come again at once
            raise
        self._view.add(self.run.last)

    def _tried(self, action: Callable[[], object]) -> None:
        """Do something; what goes wrong is told on the page, and ends nothing."""
        try:
            action()
        except VstestbedError as error:
            self._status.say(_sentence(error), refused=True)
            self._hand.show(set(self._gizmos))
            self._controls.show(self.run.settings.scenario)
        except Exception as error:
            # a plugin, or a bug: the page must stay, so that the rest can still be looked at
            logging.getLogger(__name__).warning(
                "the live view went on after an error", exc_info=error
            )
            self._status.say(f"{type(error).__name__}: {error}", refused=True)

    def _show(self, now: bool) -> None:
        self._view.draw(
            self.run.last,
            lambda: self._status.show(self.run.last, self.run.transport, self.run.by_hand),
            now,
        )

    def change(self, path: str, value: object) -> None:
        """Change a setting, and tell it on the page; by the thread that serves."""
        restarted = self.run.change(path, value)
        self._controls.show(self.run.settings.scenario)
        how = "in force from the next frame on"
        if restarted:
            self._restarted()
            how = "a new start"
        self._status.say(f"{path} = {value}: {how}")

    def reset(self) -> None:
        """Begin the run again; by the thread that serves."""
        self.run.restart()
        self._restarted()
        self._status.say("")

    def _restarted(self) -> None:
        for what in list(self._gizmos):
            self._let_go(what)
        self._hand.show(set())
        self._view.restart(self.run.scenario, self.run.last)
        self._view.add(self.run.last)
        self._show(now=True)

    def _save(self) -> None:
        note = ""
        if self.run.by_hand:
            changed = ", ".join(self.run.by_hand)
            note = f"Its run was changed by hand, which this file does not repeat: {changed}."
        path = self.run.settings.keep(note)
        self._status.say(f"saved: vstestbed run {path}. {note}")

    def gizmo(self, what: str, on: bool) -> None:
        """Show or take away what the `target`, or the `plate`, is dragged by; by the thread that
        serves.
        """
        self._let_go(what)
        if what == "plate" and on:
            T = self.run.before_marker(self._hand.marker)
            self._hold_plate(T)
            self._grip(what, T, self._hold_plate)
        elif what == "plate":
            self._hold_plate(None)
        elif on:
            self.run.check_target_free()
            self._grip(what, self.run.last.film.T_world_target, self.run.move_target)

    def _grip(self, what: str, T: Array, dragged: Callable[[Array], None]) -> None:
        def asked(T_now: Array) -> None:
            self._inbox.put(lambda: dragged(T_now), f"drag.{what}")

        self._gizmos[what] = add_gizmo(
            self._server, f"/gizmo_{what}", T, self._view.scene.reach_m, asked
        )

    def _let_go(self, what: str) -> None:
        if (gizmo := self._gizmos.pop(what, None)) is not None:
            gizmo.remove()
        if what == "plate":
            self._view.scene.put_plate(None, self.run.plate_m)

    def _hold_plate(self, T: Array | None) -> None:
        if T is None and "plate held" not in self.run.by_hand:
            return  # never held in this run: nothing to take away
        self.run.hold_plate(T)
        self._view.scene.put_plate(T, self.run.plate_m)


def _sentence(error: VstestbedError) -> str:
    if isinstance(error, ScenarioError):
        return "; ".join(
            f"{m.field}: {m.sentence}" if m.field else m.sentence for m in error.mistakes
        )
    return str(error)
