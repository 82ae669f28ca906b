"""The law's step with its result checked: a law that fails during a run orders rest from then on, and says why."""

from __future__ import annotations

import traceback
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, all_finite
from vstestbed.core.modules import is_file_module
from vstestbed.features.observation import Goal, Observation
from vstestbed.laws import Command, Law


class GuardedLaw:
    """A law that has failed is not asked again: its robot must be stopped, whatever the law does next.

    Attributes:
        failure: what the law did, in words; "" while it works.
    """

    def __init__(self, law: Law[Any]):
        self._law, self.failure = law, ""
        self._mode = 0  # in which it failed: to fail is no switch

    def step(self, memory: Any, seen: Observation, goal: Goal, basis: Array) -> tuple[Any, Command]:
        """One frame of the law; after a failure rest, with `failure` as its reason.

        Raises:
            ParameterError: the law returned something other than a memory and a command of six numbers.
        """
        if not self.failure:
            try:
                memory, command = self._checked(self._law.step(memory, seen, goal, basis))
            except (ParameterError, KeyboardInterrupt):
                raise
            except BaseException as error:  # also sys.exit: a law must not end the program
                self.failure = f"law {self._law.kind} raised {type(error).__name__}: {error} ({self._where(error)})"
            else:
                self._mode = command.mode
                if all_finite(command.twist):
                    return memory, command
                self.failure = f"law {self._law.kind} gave a twist that is not finite, {np.round(command.twist, 3)}"
        return memory, replace(Command.rest(basis, self.failure), mode=self._mode)

    def _checked(self, stepped: Any) -> tuple[Any, Command]:
        """What `step` returned, if it is a memory and a command of six numbers."""
        kind = self._law.kind
        if not (isinstance(stepped, tuple) and len(stepped) == 2 and isinstance(stepped[1], Command)):
            names = [type(part).__name__ for part in stepped] if isinstance(stepped, tuple) else []
            got = f"({', '.join(names)})" if names else type(stepped).__name__
            raise ParameterError("law.kind", f"{kind}: step must return (memory, Command), got {got}")
        twist = stepped[1].twist
        if (twist.shape if isinstance(twist, np.ndarray) else np.shape(twist)) != (6,):
            raise ParameterError("law.kind", f"{kind}: the twist of a Command must be six numbers, got {twist}")
        return stepped

    def _where(self, error: BaseException) -> str:
        """File and line where the error came from, of the law's module or a file of others; the innermost ones where neither has a part."""
        frames = list(traceback.walk_tb(error.__traceback__))
        names = [str(f.f_globals.get("__name__")) for f, _ in frames]
        ours = [name == type(self._law).__module__ or is_file_module(name) for name in names]
        written = [not f.f_code.co_filename.startswith("<string>") for f, _ in frames]  # what dataclasses generate has no line
        own = [at for at, mine, there in zip(frames, ours, written, strict=True) if mine and there]
        frame, line = (own or frames)[-1]
        return f"{Path(frame.f_code.co_filename).name}, line {line}"
