"""The law's step with its result checked: a law that fails in a step orders rest from then on, and says why."""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vstestbed.core.errors import short
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

        Whatever the law raises is its failure, a ParameterError too: the scenario was accepted, and a robot that moves must be stopped.
        """
        if not self.failure:
            stepped = self._asked(self._law.step, memory, seen, goal, basis)
            wrong = "" if self.failure else self._wrong(stepped)
            self.failure = f"law {self._law.kind} {wrong}" if wrong else self.failure
            if not self.failure:
                self._mode = stepped[1].mode
                return stepped
        return memory, replace(Command.rest(basis, self.failure), mode=self._mode)

    def init(self, goal: Goal, memory: Any) -> Any:
        """The memory for another goal of a run; the one so far where the law fails at it."""
        made = None if self.failure else self._asked(self._law.init, goal)
        return memory if self.failure else made

    def _asked(self, method: Callable[..., Any], *given: Any) -> Any:
        """What a method of the law returns; None where it raises, which is its failure."""
        try:
            return method(*given)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # also sys.exit: a law must not end the program
            self.failure = f"law {self._law.kind} raised {type(error).__name__}: {error} ({self._where(error)})"

    def _wrong(self, stepped: Any) -> str:
        """What is wrong with what `step` returned; "" for a memory and a command of finite numbers."""
        if not (isinstance(stepped, tuple) and len(stepped) == 2 and isinstance(stepped[1], Command)):
            got = type(stepped).__name__
            if isinstance(stepped, tuple):
                got = f"({', '.join(type(part).__name__ for part in stepped)})"
            return f"returned {got}; its step must return (memory, Command)"
        twist, rates, free = stepped[1].twist, stepped[1].rates, stepped[1].free
        if not isinstance(twist, np.ndarray) or twist.shape != (6,) or twist.dtype.kind not in "fiu":
            return f"gave the twist {short(twist)}; the twist of a Command must be an array of six numbers"
        if not all_finite(twist):
            self._mode = stepped[1].mode
            return f"gave a twist that is not finite, {np.round(twist, 3)}"
        if rates is not None and not all_finite(rates):
            return f"gave rates that are not finite, {np.round(rates, 3)}"
        return "" if all(math.isfinite(share) and all_finite(twists) for share, twists in free) else "gave free motions that are not finite"

    def _where(self, error: BaseException) -> str:
        """File and line where the error came from, of the law's module or a file of others; the innermost ones where neither has a part."""
        frames = list(traceback.walk_tb(error.__traceback__))
        names = [str(f.f_globals.get("__name__")) for f, _ in frames]
        ours = [name == type(self._law).__module__ or is_file_module(name) for name in names]
        written = [not f.f_code.co_filename.startswith("<string>") for f, _ in frames]  # what dataclasses generate has no line
        own = [at for at, mine, there in zip(frames, ours, written, strict=True) if mine and there]
        frame, line = (own or frames)[-1]
        return f"{Path(frame.f_code.co_filename).name}, line {line}"
