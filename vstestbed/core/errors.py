"""Everything vstestbed raises on purpose.

    VstestbedError
    ├── ScenarioError          a scenario file that cannot be run: every mistake at once     exit 2
    ├── ParameterError         one parameter out of its range (also a ValueError)            exit 2
    ├── OutputError            a result folder that cannot be written                        exit 2 or 4
    ├── RunFolderError         a folder that holds no readable run                           exit 2
    └── EnvironmentLackError   this machine lacks OpenGL, a codec, disk space                exit 4

Each class takes data, writes its own sentence and says what would have worked.
A way in which a *run* ends (target lost, joint limit, ...) is no exception: see `recording.Outcome`.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass


class VstestbedError(Exception):
    """Base of every error that vstestbed raises on purpose; `exit_code` is what the command line ends with."""

    exit_code = 2


class ParameterError(VstestbedError, ValueError):
    """A parameter outside its domain.

    Args:
        field: the parameter's name, as the user writes it.
        problem: what is wrong, and what would be valid.
        found: the value given.
    """

    def __init__(self, field: str, problem: str, found: object = None):
        self.field, self.problem, self.found = field, problem, found
        got = "" if found is None else f", got {found!r}"
        super().__init__(f"{field} {problem}{got}")


@dataclass(frozen=True)
class Mistake:
    """One thing wrong in a scenario: where (`FILE:LINE:COL`, or `--set`), in which field, and a sentence."""

    where: str
    field: str
    sentence: str

    def __str__(self) -> str:
        """The form `FILE:LINE:COL: field: sentence`."""
        return f"{self.where}: {self.field}: {self.sentence}" if self.field else f"{self.where}: {self.sentence}"


class ScenarioError(VstestbedError):
    """A scenario that cannot be run; `mistakes` holds all of them, its text has one line for each."""

    def __init__(self, mistakes: Sequence[Mistake]):
        self.mistakes = tuple(mistakes)
        super().__init__("\n".join(str(m) for m in self.mistakes))


class OutputError(VstestbedError):
    """A result folder or file that cannot be written: its path, the reason, what to do."""

    def __init__(self, path: object, reason: str, advice: str, exit_code: int = 2):
        self.exit_code = exit_code
        super().__init__(f"{path}: {reason}; {advice}")


class RunFolderError(VstestbedError):
    """A folder that holds no run, or a damaged one."""

    def __init__(self, path: object, reason: str):
        super().__init__(f"{path}: {reason}; a run's folder holds scenario.yaml and log.parquet (or log.part)")


class EnvironmentLackError(VstestbedError):
    """Something this machine lacks (OpenGL, a codec, disk space), and the command that mends it."""

    exit_code = 4

    def __init__(self, lack: str, remedy: str):
        self.lack, self.remedy = lack, remedy
        super().__init__(f"{lack}; {remedy}")


def nearest(word: str, valid: Iterable[str]) -> str:
    """A hint for a misspelt word: `did you mean 'gain'?`, or the list of all valid words."""
    valid = sorted(valid)
    close = difflib.get_close_matches(word, valid, n=1, cutoff=0.6)
    return f"did you mean {close[0]!r}?" if close else f"valid: {', '.join(valid)}"
