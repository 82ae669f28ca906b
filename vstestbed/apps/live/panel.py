"""The panel of a live run: its state in words, play and pause, what is done by hand, settings,
saving.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import viser
from annotated_types import Gt

from vstestbed.apps.live.run import Inbox, LiveRun, Sample, Transport
from vstestbed.core.fields import Node, fields
from vstestbed.core.quantity import GainOrZero, PositiveGain, SignedGain
from vstestbed.core.registry import kind_of
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.yaml_marks import read_value

Control = Literal["slider", "number", "choice", "switch"]
BLOCKS = ("law", "camera", "robot", "timing", "noise", "calibration", "detector")
"""Blocks of a scenario whose fields get controls; the others define what the experiment is."""
FIRST = "camera.latency_s", "noise.image_sigma", "noise.pixel_sigma_px", "camera.rate_hz", "seed"
"""Fields that a person turns first, after the law's gains; the others are folded away."""
LEFT_OUT = {"camera.mount", "camera.width", "camera.height", "robot.start"}
HIGH = {
    "camera.latency_s": 0.4,
    "camera.rate_hz": 100.0,
    "camera.readout_s": 0.03,
    "camera.fovy_deg": 120.0,
    "timing.command_latency_s": 0.4,
    "timing.exposure_s": 0.04,
    "timing.exposure_jitter_s": 0.02,
    "timing.latency_jitter_s": 0.1,
    "timing.drop_probability": 0.9,
    "noise.image_sigma": 40.0,
    "noise.pixel_sigma_px": 5.0,
    "noise.dropout": 0.9,
    "calibration.depth_factor": 3.0,
    "law.smooth_start_s": 3.0,
    "law.smoothing_s": 1.0,
    "law.visibility.margin_px": 120.0,
    "law.speed_mps": 3.0,
}
"""Right ends of sliders: far over what is usual, far under what is valid."""
STEPS = 200


@dataclass(frozen=True)
class Field:
    """One control. path: dotted, as `--set` takes it. value: in force. low, high, step: of a
    slider. is_gain: of a law or a loop.
    """

    path: str
    control: Control
    value: Any
    low: float = 0.0
    high: float = 0.0
    step: float = 0.0
    choices: tuple[str, ...] = ()
    whole: bool = False
    is_gain: bool = False

    @property
    def block(self) -> str:
        """The first part of the path."""
        return self.path.partition(".")[0]

    @property
    def comes_first(self) -> bool:
        """Whether it is one of those that a person turns first."""
        return self.path in FIRST or (self.is_gain and self.block == "law")

    @property
    def label(self) -> str:
        """The path, without its block where that is written above."""
        if self.comes_first:
            return self.path
        return self.path.partition(".")[2] or self.path


def fields_of(scenario: Scenario) -> list[Field]:
    """The controls of a scenario as it is now: those that come first, then block by block."""
    found = [Field("seed", "number", scenario.seed, whole=True)]
    for block in BLOCKS:
        value = getattr(scenario, block)
        if block not in ("robot", "camera"):
            found += _kinds(block, fields(Scenario)[block].node, value)
        found += _inside(block, value)
    if hasattr(scenario.camera, "distortion"):
        now = getattr(scenario.camera, "distortion", None) or (0.0,) * 5
        for i in (0, 1):
            path = f"camera.distortion.{i}"
            found.append(Field(path, "slider", now[i], -0.4, 0.4, 0.4 / STEPS))

    def rank(field: Field) -> int:
        if not field.comes_first:
            return len(FIRST)
        return FIRST.index(field.path) if field.path in FIRST else -1

    return sorted(found, key=rank)


def _kinds(path: str, node: Node, value: Any) -> list[Field]:
    if node.registry is None or len(node.registry.members) < 2:
        return []
    choices = tuple(sorted(node.registry.members))
    return [Field(path, "choice", kind_of(type(value)), choices=choices)]


def _inside(path: str, value: Any) -> Iterator[Field]:
    for name, field in fields(type(value)).items():
        inner = f"{path}.{name}"
        if name != "kind" and inner not in LEFT_OUT:
            yield from _of(inner, field.node, getattr(value, name))


def _of(path: str, node: Node, value: Any) -> Iterator[Field]:
    if node.words:
        yield Field(path, "choice", str(value), choices=tuple(map(str, node.words)))
    elif isinstance(value, bool):
        yield Field(path, "switch", value)
    elif isinstance(value, int | float):
        yield _number(path, value, node)
    elif dataclasses.is_dataclass(value):
        yield from _kinds(path, node, value)
        kind, shorthand = (node.registry and node.registry.number) or ("", "")
        if getattr(value, "kind", None) == kind:
            yield _number(path, getattr(value, shorthand), fields(type(value))[shorthand].node)
        else:
            yield from _inside(path, value)


GAINS = [
    bound
    for quantity in (PositiveGain, GainOrZero, SignedGain)
    for bound in quantity.__metadata__  # pyright: ignore[reportAttributeAccessIssue] - of Annotated
]


def _number(path: str, value: float, node: Node) -> Field:
    """A slider where its useful range is known, else a number to type."""
    is_gain = node.within in GAINS
    whole = node.type is int
    high = HIGH.get(path, max(4.0, 4.0 * abs(value)) if is_gain else 0.0)
    if not high or whole:
        return Field(path, "number", value, whole=whole)
    least, top = node.limits
    high = min(max(high, value), top)
    power = 10.0 ** int(f"{high / STEPS:e}".partition("e")[2])
    step = next(m * power for m in (5, 2, 1) if m * power <= high / STEPS * (1 + 1e-9))
    low = 0.0
    if least < 0:
        low = -high
    elif Gt(0) in node.bounds:
        low = min(step, value)
    return Field(path, "slider", value, low=low, high=high, step=step, is_gain=is_gain)


class Controls:
    """The controls of a scenario: those that a person turns first, and the others in folders, one a
    block, which are closed. ask: told what a page sets, at once and from another thread. waits:
    whether what was asked for a path is still to come.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        scenario: Scenario,
        ask: Callable[[str, object], None],
        waits: Callable[[str], bool],
    ):
        self._gui = gui
        self._ask = ask
        self._waits = waits
        self._parts: list[Any] = []
        self._handles: dict[str, tuple[Field, Any]] = {}
        self._holder = gui.add_folder("settings", expand_by_default=True)
        self.show(scenario)

    def show(self, scenario: Scenario) -> None:
        """Put the values in force into the controls; made anew where the fields are others than
        before.
        """
        fields = {_key(f): f for f in fields_of(scenario)}
        before = {key: (f.control, f.choices) for key, (f, _) in self._handles.items()}
        if before == {key: (f.control, f.choices) for key, f in fields.items()}:
            for key, field in fields.items():
                old, handle = self._handles[key]
                value = field.value
                if field.control == "slider":
                    value = min(max(value, old.low), old.high)
                # a slider that is still being drawn must not jump back
                if not self._waits(field.path):
                    handle.value = value
        else:
            self._rebuild(list(fields.values()))

    def _rebuild(self, fields: list[Field]) -> None:
        for part in self._parts:
            part.remove()
        self._handles = {}
        with self._holder:
            self._parts = [self._made(field) for field in fields if field.comes_first]
            for block in dict.fromkeys(f.block for f in fields if not f.comes_first):
                folder = self._gui.add_folder(block, expand_by_default=False)
                self._parts.append(folder)
                with folder:
                    for field in fields:
                        if field.block == block and not field.comes_first:
                            self._made(field)

    def _made(self, field: Field) -> Any:
        gui = self._gui
        hint = f"--set {field.path}=..."
        handle: Any
        if field.control == "choice":
            # the number of a gain has a slider
            label = f"{field.label}.kind" if field.path == "law.gain" else field.label
            handle = gui.add_dropdown(label, field.choices, initial_value=field.value, hint=hint)
        elif field.control == "switch":
            handle = gui.add_checkbox(field.label, field.value, hint=hint)
        elif field.control == "slider":
            handle = gui.add_slider(
                field.label, field.low, field.high, field.step, float(field.value), hint=hint
            )
        else:
            value = field.value if field.whole else float(field.value)
            handle = gui.add_number(field.label, value, hint=hint)

        def asked(value: Any) -> None:
            if field.control == "choice":
                value = read_value(value)
            elif isinstance(value, float):
                value = round(value, 9)  # the browser adds up a slider's steps
            self._ask(field.path, value)

        on_change(handle, asked)
        self._handles[_key(field)] = field, handle
        return handle


def _key(field: Field) -> str:
    return f"{field.path}.kind" if field.control == "choice" else field.path


SPEEDS = {
    "0.1 x": 0.1,
    "0.25 x": 0.25,
    "0.5 x": 0.5,
    "1 x": 1.0,
    "2 x": 2.0,
    "5 x": 5.0,
    "as fast as it can": math.inf,
}
# of what is changed by hand, that which a scenario can repeat, though from the start alone
LAW = "law"
PUSH_S = 0.2  # how long a push lasts [s]


def transport_panel(
    gui: viser.GuiApi, inbox: Inbox, transport: Transport, reset: Callable[[], None]
) -> None:
    """Play, pause, step, reset, speed."""
    orders = {
        "play": lambda: transport.play(True),
        "pause": lambda: transport.play(False),
        "step": transport.step,
        "reset": reset,
    }
    buttons = gui.add_button_group(
        "run", tuple(orders), hint="step: one frame, then pause; reset: from the start"
    )

    async def clicked(event: viser.GuiEvent[Any]) -> None:
        inbox.put(orders[event.target.value])

    buttons.on_click(clicked)
    speed = gui.add_dropdown(
        "speed", tuple(SPEEDS), initial_value="1 x", hint="simulated time against real time"
    )
    on_change(speed, lambda wanted: inbox.put(lambda: transport.set_speed(SPEEDS[wanted]), "speed"))


class StatusLine:
    """The state of a run in words, and what was last refused or done (`message`, in Markdown)."""

    def __init__(self, gui: viser.GuiApi):
        self._state, self._hand, self._said = (gui.add_markdown("") for _ in range(3))
        self._words = self.message = ""
        self._done: tuple[str, ...] = ()

    def show(self, sample: Sample, transport: Transport, by_hand: tuple[str, ...] = ()) -> None:
        """Time, error, pace, or the outcome; what was done by hand in this run."""
        if by_hand != self._done:
            self._done = by_hand
            self._hand.content = _told(by_hand)
        error = "target not in sight"
        if math.isfinite(sample.judged):
            error = f"{sample.judged:.3g} {sample.unit}"
        words = (
            f"**t = {sample.film.t:.2f} s** · frame {sample.number} · error {error}  \n"
            f"{_state(sample, transport)}"
        )
        if words != self._words:
            self._words = self._state.content = words

    def say(self, message: str, refused: bool = False) -> None:
        """A sentence that stays until the next one; "" for none."""
        content = escaped(message)
        if content and refused:
            content = f"**refused:** {content}"
        if content != self.message:
            self.message = self._said.content = content


def _told(by_hand: tuple[str, ...]) -> str:
    if not by_hand:
        return ""
    if by_hand == (LAW,):
        return (
            "The law was changed during this run;"
            " *save as scenario* keeps the last setting, from the start."
        )
    return f"By hand in this run: {', '.join(by_hand)}. No scenario file repeats this."


def _state(sample: Sample, transport: Transport) -> str:
    if sample.verdict is not None:
        outcome, reason = sample.verdict
        return f"**{outcome.value}**: {escaped(reason)} — *reset* begins again"
    if not transport.playing:
        return "paused"
    pace = transport.pace
    wanted = transport.speed
    if math.isnan(pace):
        return "running"
    if math.isfinite(wanted) and pace < 0.95 * wanted:
        return f"running at {pace:.2f} x real time: slower than the {wanted:g} x asked for"
    return f"running at {pace:.2f} x real time"


class HandPanel:
    """What is done by hand: a push, the target at a gizmo, a plate before a marker. gizmo: shows or
    hides one (target, plate).
    """

    def __init__(
        self, gui: viser.GuiApi, inbox: Inbox, run: LiveRun, gizmo: Callable[[str, bool], None]
    ):
        with gui.add_folder("by hand", expand_by_default=False):
            # moves the robot, and breaks nothing
            well = 0.0, round(run.session.weight_n / 2, 1), 0.0
            force = gui.add_vector3(
                "force [N]", well, hint=f"along world axes, for {PUSH_S:g} s at the flange"
            )
            push = gui.add_button("push the robot")
            on_click(push, inbox, lambda: run.push(np.array(force.value), PUSH_S))
            target = gui.add_checkbox("drag the target", False)
            plate = gui.add_checkbox("hold a plate", False)
            shown = run.scenario.target
            self._called = [shown.called(i) for i in range(len(shown.places))] or ["0"]
            self._marker = gui.add_dropdown("before marker", self._called)
        self._boxes = {"target": target, "plate": plate}

        def ask(what: str, on: bool) -> None:
            inbox.put(lambda: gizmo(what, on), f"hand.{what}")

        on_change(target, lambda on: ask("target", on))
        on_change(plate, lambda on: ask("plate", on))
        on_change(self._marker, lambda _: ask("plate", plate.value))

    @property
    def marker(self) -> int:
        """Number of the marker before which the plate is held."""
        return self._called.index(self._marker.value)

    def show(self, held: set[str]) -> None:
        """What has a gizmo now."""
        for what, box in self._boxes.items():
            box.value = what in held


def on_change(control: Any, act: Callable[[Any], None]) -> None:
    """Call `act` with the value of a control when a page has set it."""

    async def changed(event: viser.GuiEvent[Any]) -> None:
        # async: run at once and in order, not in a pool of threads
        if event.client is not None:
            act(event.target.value)

    control.on_update(changed)


def on_click(button: Any, inbox: Inbox, order: Callable[[], None]) -> None:
    """Every click of a page is an order of its own."""

    async def clicked(event: viser.GuiEvent[Any]) -> None:
        inbox.put(order)

    button.on_click(clicked)


def escaped(text: str) -> str:
    """Text that Markdown shows as it is."""
    return "".join(f"\\{c}" if c in "\\`*_{}[]<>#|" else c for c in text)
