"""The panel of a live run: its state in words, play and pause, what is done by hand, settings, saving."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from vstestbed.live.controls import Controls
from vstestbed.live.inbox import Inbox
from vstestbed.live.run import LiveRun
from vstestbed.live.transport import Sample, Transport
from vstestbed.scenario.yaml_marks import read_value

SPEEDS = {"0.1 x": 0.1, "0.25 x": 0.25, "0.5 x": 0.5, "1 x": 1.0, "2 x": 2.0, "5 x": 5.0, "as fast as it can": math.inf}
LAW = "law"
"""Of what is changed by hand, that which a scenario can repeat, though from the start alone."""
SLOWER = 0.95
"""Share of the asked pace under which the page says that the machine is slower."""
PUSH_S = 0.2
"""How long a push lasts [s]."""


class TransportPanel:
    """Play, pause, step, reset, speed.

    Args:
        gui: where they are added. inbox: takes what pages ask for. transport: obeys it. reset: begins again.
    """

    def __init__(self, gui: viser.GuiApi, inbox: Inbox, transport: Transport, reset: Callable[[], None]):
        orders = {"play": lambda: transport.play(True), "pause": lambda: transport.play(False), "step": transport.step, "reset": reset}
        buttons = gui.add_button_group("run", tuple(orders), hint="step: one frame, then pause; reset: from the start")

        async def clicked(event: viser.GuiEvent[Any]) -> None:
            inbox.put(orders[event.target.value])

        buttons.on_click(clicked)
        speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1 x", hint="simulated time against real time")

        async def asked(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                wanted = SPEEDS[event.target.value]
                inbox.put(lambda: transport.set_speed(wanted), "speed")

        speed.on_update(asked)


class StatusLine:
    """The state of a run in words, and what was last refused or done.

    Attributes:
        message: what was last refused or done, in Markdown.
    """

    def __init__(self, gui: viser.GuiApi):
        self._state, self._hand, self._said = (gui.add_markdown("") for _ in range(3))
        self._words = self.message = ""
        self._done: tuple[str, ...] = ()

    def show(self, sample: Sample, transport: Transport, by_hand: tuple[str, ...] = ()) -> None:
        """Time, error, pace, or the outcome; what was done by hand in this run."""
        if by_hand != self._done:
            self._done, self._hand.content = by_hand, _told(by_hand)
        error = f"{sample.judged:.3g} {sample.unit}" if math.isfinite(sample.judged) else "target not in sight"
        words = f"**t = {sample.film.t:.2f} s** · frame {sample.number} · error {error}  \n{_state(sample, transport)}"
        if words != self._words:
            self._words = self._state.content = words

    def say(self, message: str, refused: bool = False) -> None:
        """A sentence that stays until the next one; "" for none."""
        content = "" if not message else f"**refused:** {escaped(message)}" if refused else escaped(message)
        if content != self.message:
            self.message = self._said.content = content


def _told(by_hand: tuple[str, ...]) -> str:
    """What a run has that its scenario has not."""
    if not by_hand:
        return ""
    if by_hand == (LAW,):
        return "The law was changed during this run; *save as scenario* keeps the last setting, from the start."
    return f"By hand in this run: {', '.join(by_hand)}. No scenario file repeats this."


def _state(sample: Sample, transport: Transport) -> str:
    if sample.verdict is not None:
        outcome, reason = sample.verdict
        return f"**{outcome.value}**: {escaped(reason)} — *reset* begins again"
    if not transport.playing:
        return "paused"
    pace, wanted = transport.pace, transport.speed
    if math.isnan(pace):
        return "running"
    if math.isfinite(wanted) and pace < SLOWER * wanted:
        return f"running at {pace:.2f} x real time: slower than the {wanted:g} x asked for"
    return f"running at {pace:.2f} x real time"


class HandPanel:
    """What is done by hand: a push, the target at a gizmo, a plate before a marker.

    Args:
        gui: where it is added. inbox: takes what pages ask for. run: to which it is done. gizmo: shows or hides the target's and the
            plate's gizmos (target, plate).
    """

    def __init__(self, gui: viser.GuiApi, inbox: Inbox, run: LiveRun, gizmo: Callable[[str, bool], None]):
        with gui.add_folder("by hand", expand_by_default=False):
            force = gui.add_vector3("force [N]", push_of(run), hint=f"along world axes, for {PUSH_S:g} s at the flange")
            on_click(gui.add_button("push the robot"), inbox, lambda: run.push(np.array(force.value), PUSH_S))
            target = gui.add_checkbox("drag the target", False)
            plate = gui.add_checkbox("hold a plate", False)
            shown = run.scenario.target
            self._called = [shown.called(i) for i in range(len(shown.places))] or ["0"]
            self._marker = gui.add_dropdown("before marker", self._called)
        self._boxes = {"target": target, "plate": plate}
        for what, box in self._boxes.items():
            box.on_update(self._asked(inbox, what, gizmo))
        self._marker.on_update(self._asked(inbox, "plate", gizmo))

    @property
    def marker(self) -> int:
        """Number of the marker before which the plate is held."""
        return self._called.index(self._marker.value)

    def show(self, held: set[str]) -> None:
        """What has a gizmo now."""
        for what, box in self._boxes.items():
            box.value = what in held

    def _asked(self, inbox: Inbox, what: str, gizmo: Callable[[str, bool], None]) -> Any:
        async def asked(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                on = bool(self._boxes[what].value)
                inbox.put(lambda: gizmo(what, on), f"hand.{what}")

        return asked


def push_of(run: LiveRun) -> tuple[float, float, float]:
    """A force that moves the robot well and breaks nothing [N]."""
    return (0.0, round(run.session.weight_n / 2, 1), 0.0)


class RunPanel:
    """The whole panel of a live run.

    Args:
        gui: where it is added. inbox: takes what pages ask for. run: obeys. set_, gizmo, reset, save: do what is asked for.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        inbox: Inbox,
        run: LiveRun,
        *,
        set_: Callable[[str, object], None],
        gizmo: Callable[[str, bool], None],
        reset: Callable[[], None],
        save: Callable[[], None],
    ):
        self.status = StatusLine(gui)
        TransportPanel(gui, inbox, run.transport, reset)
        self.controls = Controls(gui, run.scenario, lambda path, value: inbox.put(lambda: set_(path, value), path), inbox.waits)
        with gui.add_folder("any other field", expand_by_default=False):
            field, value = gui.add_text("field", "goal.T_camera_target.xyz"), gui.add_text("value", "[0, 0, 0.8]")
            on_click(gui.add_button("set", hint="as --set field=value"), inbox, lambda: set_(field.value, read_value(value.value)))
        self.hand = HandPanel(gui, inbox, run, gizmo)
        on_click(gui.add_button("start without a seed", hint="the scenario's own start"), inbox, lambda: set_("seed", None))
        on_click(gui.add_button("save as scenario", hint="what repeats these settings from the start"), inbox, save)


def on_click(button: Any, inbox: Inbox, order: Callable[[], None]) -> None:
    """Every click of a page is an order of its own."""

    async def clicked(event: viser.GuiEvent[Any]) -> None:
        inbox.put(order)

    button.on_click(clicked)


def escaped(text: str) -> str:
    """Text that Markdown shows as it is."""
    return "".join(f"\\{c}" if c in "\\`*_{}[]<>#|" else c for c in text)
