"""The controls of a scenario's fields: what they ask for goes to the inbox, what is in force comes back into them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser

from vstestbed.live.fields import Field, fields_of
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.yaml_marks import read_value

Ask = Callable[[str, object], None]
"""Ask for a setting: path and value."""
DIGITS = 9
"""To which a slider's number is rounded: the browser adds up steps."""


class Controls:
    """The controls of a scenario: those that a person turns first, and the others in folders, one a block, which are closed.

    Args:
        gui: where they are added, in the container that is open. scenario: the experiment. ask: told what a page sets, at once and
            from another thread. waits: whether what was asked for a path is still to come.
    """

    def __init__(self, gui: viser.GuiApi, scenario: Scenario, ask: Ask, waits: Callable[[str], bool]):
        self._gui, self._ask, self._waits = gui, ask, waits
        self._parts: list[Any] = []
        self._handles: dict[str, tuple[Field, Any]] = {}
        self._holder = gui.add_folder("settings", expand_by_default=True)
        self.show(scenario)

    def show(self, scenario: Scenario) -> None:
        """Put the values in force into the controls; made anew where the fields are others than before."""
        fields = {_key(f): f for f in fields_of(scenario)}
        before = {key: (f.control, f.choices) for key, (f, _) in self._handles.items()}
        if before == {key: (f.control, f.choices) for key, f in fields.items()}:
            for key, field in fields.items():
                old, handle = self._handles[key]
                value = min(max(field.value, old.low), old.high) if field.control == "slider" else field.value
                if not self._waits(field.path):  # a slider that is still being drawn must not jump back
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
        gui, hint = self._gui, f"--set {field.path}=..."
        handle: Any
        if field.control == "choice":
            label = f"{field.label}.kind" if field.path in KIND_AND_NUMBER else field.label
            handle = gui.add_dropdown(label, field.choices, initial_value=field.value, hint=hint)
        elif field.control == "switch":
            handle = gui.add_checkbox(field.label, field.value, hint=hint)
        elif field.control == "slider":
            handle = gui.add_slider(field.label, field.low, field.high, field.step, float(field.value), hint=hint)
        else:
            handle = gui.add_number(field.label, field.value if field.whole else float(field.value), hint=hint)

        async def asked(event: viser.GuiEvent[Any]) -> None:  # async: run at once and in order, not in a pool of threads
            if event.client is not None:
                self._ask(field.path, _plain(field, event.target.value))

        handle.on_update(asked)
        self._handles[_key(field)] = field, handle
        return handle


KIND_AND_NUMBER = {"law.gain"}
"""Fields whose kind has a menu, and whose number a slider."""


def _key(field: Field) -> str:
    return f"{field.path}.kind" if field.control == "choice" else field.path


def _plain(field: Field, value: Any) -> object:
    if field.control == "choice":
        return read_value(value)
    return round(value, DIGITS) if isinstance(value, float) else value
