"""The exceptions that vstestbed raises for foreseen failures.

    VstestbedError
    ├── ScenarioError          a scenario file that cannot be run: all mistakes at once  exit 2
    │   └── PluginError        a plugin that is not there or cannot be imported          exit 2
    ├── ParameterError         one parameter out of its range (also a ValueError)        exit 2
    │   └── UnreachableError   a start at which the robot cannot stand                   exit 2
    ├── OutputError            a result folder that cannot be written                    exit 2 or 4
    ├── RunFolderError         a folder without a readable run                           exit 2
    ├── SessionError           a session that cannot do what it is asked in its state    exit 2
    └── EnvironmentLackError   this machine lacks OpenGL, a codec, disk space            exit 4

Each class takes data and composes its own message, which includes a remedy.
The end of a *run* (target lost, joint limit, ...) is no exception: see `core.outcome.Outcome`.
"""

from __future__ import annotations

import contextlib
import difflib
import errno
import mmap
import os
import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Self

__all__ = [
    "NOTHING_RAN",
    "EnvironmentLackError",
    "Mistake",
    "OutputError",
    "ParameterError",
    "PluginError",
    "RunFolderError",
    "ScenarioError",
    "SessionError",
    "UnreachableError",
    "VstestbedError",
    "lack_of",
    "nearest",
    "short",
    "shortage",
    "take_early",
]


class VstestbedError(Exception):
    """Base class of these exceptions; `exit_code` is the exit status of the command line."""

    exit_code = 2

    def __reduce__(self) -> tuple[object, ...]:
        """Pickled as they are: the constructors take other arguments than the message, and errors
        come from worker processes.
        """
        return type(self).__new__, (type(self), *self.args), self.__dict__


class ParameterError(VstestbedError, ValueError):
    """A parameter outside its domain: its name as the user writes it, the rest of the sentence, and
    the given value. With one argument alone, an error or its message, it says the same: so
    Gymnasium's vector environments raise a worker's error again.
    """

    def __init__(self, field: object, problem: str = "", found: object = None):
        self.field = str(field)
        self.problem = problem
        self.found = found
        got = "" if found is None else f", got {found!r}"
        super().__init__(f"{field} {problem}{got}".rstrip())

    # The sentences that many rooms need, each once. found: what was given. why: the reason. works:
    # what would be accepted.

    @classmethod
    def missing(cls, field: object, why: str, found: object = None) -> Self:
        """A value is not there, and something needs it."""
        return cls(field, f"is missing: {why}", found)

    @classmethod
    def needs(
        cls, field: object, what: str, found: object = None, why: str = "", works: str = ""
    ) -> Self:
        """A value works only together with something that is not there."""
        return cls(field, f"needs {what}{_why(why)}{_works(works)}", found)

    @classmethod
    def only_for(cls, field: object, what: str, found: object = None) -> Self:
        """A value is given where nothing uses it."""
        return cls(field, f"is for {what}", found)

    @classmethod
    def excluded(
        cls, field: object, what: str, found: object = None, why: str = "", works: str = ""
    ) -> Self:
        """A value that is valid elsewhere cannot work here. what: the value, and beside what it
        cannot be.
        """
        return cls(field, f"may not be {what}{_why(why)}{_works(works)}", found)

    @classmethod
    def fixed(
        cls,
        field: object,
        value: str,
        found: object = None,
        where: str = "",
        why: str = "",
        works: str = "",
    ) -> Self:
        """Only one value works here. where: the circumstance, such as "with lit: false"."""
        return cls(
            field, f"must be {value}{where and ' ' + where}{_why(why)}{_works(works)}", found
        )

    @classmethod
    def choice(
        cls, field: object, valid: Iterable[object], found: object = None, why: str = ""
    ) -> Self:
        """A value is none of those that are valid here."""
        return cls(field, f"must be one of {', '.join(map(str, valid))}{_why(why)}", found)

    @classmethod
    def unknown(cls, field: object, what: str, hint: str, found: object = None) -> Self:
        """A word names nothing. what: the kind of thing it should name; hint: the nearest words, by
        `nearest`.
        """
        return cls(field, f"is no {what}; {hint}", found)

    @classmethod
    def bound(
        cls, field: object, relation: str, limit: object, found: object = None, why: str = ""
    ) -> Self:
        """A number is beyond a limit. relation: how the value must stand to it, such as "at most"
        or ">". limit: with its unit.
        """
        return cls(field, f"must be {relation} {limit}{_why(why)}", found)

    @classmethod
    def count(
        cls, field: object, wanted: object, what: str, found: object = None, why: str = ""
    ) -> Self:
        """A list or an array has the wrong number of items."""
        return cls(field, f"must be {wanted} {what}{_why(why)}", found)

    @classmethod
    def infinite(cls, field: object, found: object = None) -> Self:
        """A number is infinite or not a number."""
        return cls(field, "must be finite", found)

    @classmethod
    def twice(cls, field: object, name: object, found: object = None) -> Self:
        """A list names something twice."""
        return cls(field, f"has {name} twice; name each once", found)

    @classmethod
    def conflict(cls, field: object, other: str, found: object = None) -> Self:
        """Two values are given that exclude each other, or say the same."""
        return cls(field, f"excludes {other}; leave one of the two out", found)

    @classmethod
    def form(cls, field: object, form: str, found: object = None) -> Self:
        """A text is not of the form that is read. form: with an example."""
        return cls(field, f"needs the form {form}", found)

    @classmethod
    def returned(cls, field: object, method: str, wanted: object, found: object = None) -> Self:
        """The method of a plugin returned something else than its protocol says."""
        return cls(field, f"{method} must return {wanted}", found)

    @classmethod
    def unreadable(cls, field: object, why: object, works: str, found: object = None) -> Self:
        """A file cannot be read, or is not what it should be. works: what the file should be."""
        return cls(field, f"cannot be read ({why}){_works(works)}", found)


def _works(works: str) -> str:
    return works and f"; works: {works}"


def _why(why: str) -> str:
    return why and f": {why}"


@contextlib.contextmanager
def within(block: str) -> Iterator[None]:
    """Put the name of a block before the field of a ParameterError that a check of it raises."""
    try:
        yield
    except ParameterError as error:
        field = f"{block}.{error.field}".removesuffix(".")
        raise ParameterError(field, error.problem, error.found) from None


class UnreachableError(ParameterError):
    """A start at which the robot cannot stand; a comparison tells it as the outcome of a run."""


@dataclass(frozen=True)
class Mistake:
    """One mistake in a scenario: its position (`FILE:LINE:COL`, or `--set`), the field, and a
    sentence.
    """

    where: str
    field: str
    sentence: str

    def __str__(self) -> str:
        field = f"{self.field}: " if self.field else ""
        return f"{self.where}: {field}{self.sentence}"


class ScenarioError(VstestbedError):
    """A scenario that cannot be run; `mistakes` has all mistakes, and the message one line for
    each.
    """

    def __init__(self, mistakes: Sequence[Mistake]):
        self.mistakes = tuple(mistakes)
        super().__init__("\n".join(map(str, self.mistakes)))

    @staticmethod
    def at(where: str, field: str, sentence: str) -> ScenarioError:
        """The error for one mistake."""
        return ScenarioError([Mistake(where, field, sentence)])


class PluginError(ScenarioError):
    """A plugin that is not there or cannot be imported: its FILE:LINE, or the place and field that
    name it; what was found, a remedy.
    """

    def __init__(
        self,
        where: str,
        found: str,
        remedy: str = "correct the plugin, or leave it out",
        field: str = "",
    ):
        super().__init__([Mistake(where, field, f"{found}; {remedy}")])


class OutputError(VstestbedError):
    """A result folder or file that cannot be written: its path, the reason, a remedy."""

    def __init__(self, path: object, reason: str, advice: str, exit_code: int = 2):
        self.exit_code = exit_code
        super().__init__(f"{path}: {reason}; {advice}")


class RunFolderError(VstestbedError):
    """A folder without a run, or a damaged file in one:
    its path, what was found, what would work.
    """

    def __init__(
        self,
        path: object,
        reason: str,
        works: str = "a run's folder holds scenario.yaml and log.parquet (or log.part)",
    ):
        super().__init__(f"{path}: {reason}; {works}")


NOTHING_RAN = "the run ended before its first picture: run the scenario again, into a new folder"


class SessionError(VstestbedError):
    """A session that cannot do what it is asked in its present state: the state, a remedy; or an
    error alone, as ParameterError.
    """

    def __init__(self, state: object, remedy: str = ""):
        super().__init__(f"{state}; {remedy}" if remedy else str(state))


class EnvironmentLackError(VstestbedError):
    """A lack of this machine (OpenGL, a codec, disk space), and its remedy."""

    exit_code = 4

    def __init__(self, lack: str, remedy: str):
        self.lack = lack
        self.remedy = remedy
        super().__init__(f"{lack}; {remedy}")


def nearest(word: str, valid: Iterable[str]) -> str:
    """A hint for an invalid word: `did you mean 'gain'?`, or the list of all valid words."""
    valid = sorted(valid)
    # 0.6 is difflib's default; a list of all words is better than a wrong guess.
    close = difflib.get_close_matches(word, valid, n=1, cutoff=0.6)
    return f"did you mean {close[0]!r}?" if close else f"valid: {', '.join(valid)}"


def short(found: object) -> str:
    """A value for a message, on one line, cut to 60 characters."""
    text = " ".join(repr(found).split("\n"))  # arrays have several
    return text if len(text) <= 60 else text[:57] + "..."


# Want of memory and of open files: told as a lack of this machine, whichever library met it and in
# whose words.
MEMORY = re.compile(
    r"(?i)cannot allocate memory|could not allocate|insufficient memory|failed to map"
    r" segment|bad_alloc|\bMemoryError\b"
)
"""What libraries say for want of memory: the loader of shared libraries, MuJoCo, OpenCV, C++,
ctypes.
"""
FILES = re.compile(r"(?i)too ?many ?open ?files")
# What a process that is not short can still have: the largest library takes less memory to load
SPARE_BYTES = 1 << 28
SPARE_FILES = 8


def lack_of(error: BaseException) -> EnvironmentLackError | None:
    """The error for want of memory or of open files that an error, or one behind it, comes from;
    None where it comes from neither.
    """
    # the first cause says what was wanted, without what later ones advise
    for one in reversed([*_chain(error)]):
        number = one.errno if isinstance(one, OSError) else None
        if isinstance(one, MemoryError) or number == errno.ENOMEM or MEMORY.search(str(one)):
            return _memory(one)
        if number in (errno.EMFILE, errno.ENFILE) or FILES.search(str(one)):
            return _files(one)
    return None


def shortage() -> EnvironmentLackError | None:
    """The error for what this process cannot have any more, for an error whose words do not tell;
    None where it is short of nothing.
    """
    with contextlib.ExitStack() as spare:
        try:
            for _ in range(SPARE_FILES):
                spare.enter_context(Path(os.devnull).open("rb"))
        except OSError as error:
            return _files(error)
    try:
        mmap.mmap(-1, SPARE_BYTES).close()
    except (OSError, MemoryError) as error:
        return _memory(error)
    return None


def take_early() -> None:
    """Under a limit of memory (`ulimit -v`) load the libraries with an OpenBLAS, and have each take
    its memory, while there is some. What OpenBLAS cannot have it asks for again without end, in C
    code that holds Python's lock: the process hangs, and serves no signal. One thread each: every
    further one would take 32 MiB.
    Raises OSError: there is too little; `lack_of` tells it.
    """
    if sys.platform == "win32":
        return
    import resource

    if resource.getrlimit(resource.RLIMIT_AS)[0] == resource.RLIM_INFINITY:
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # By name: core computes nothing with OpenCV. What each is asked for makes its BLAS take memory.
    for module, use in (("numpy.linalg", "inv"), ("scipy.linalg", "inv"), ("cv2", "SVDecomp")):
        mmap.mmap(-1, SPARE_BYTES).close()
        eye = import_module("numpy").eye(64)
        getattr(import_module(module), use)(eye @ eye)


def _chain(error: BaseException) -> Iterator[BaseException]:
    seen: set[int] = set()
    one: BaseException | None = error
    while one is not None and id(one) not in seen:
        seen.add(id(one))
        yield one
        one = one.__cause__ or one.__context__


def _memory(error: BaseException) -> EnvironmentLackError:
    words = (
        "close other programs, raise the limit (ulimit -v), or make what is asked for smaller:"
        " fewer --jobs, starts or pixels"
    )
    return EnvironmentLackError(f"not enough memory{_said(error)}", words)


def _files(error: BaseException) -> EnvironmentLackError:
    return EnvironmentLackError(
        f"too many open files{_said(error)}",
        "raise the limit (ulimit -n 1024), or use fewer --jobs",
    )


def _said(error: BaseException) -> str:
    words = str(error).strip().split("\n")[0]
    return f" ({words})" if words else ""
