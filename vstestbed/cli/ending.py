"""How a command ends: its exit code, and one sentence for every error that is foreseen or that a
plugin brings.
"""

from __future__ import annotations

import _thread
import contextlib
import errno
import gc
import io
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr
from typing import Any, TextIO, cast

import typer

from vstestbed.core.errors import (
    EnvironmentLackError,
    VstestbedError,
    lack_of,
    shortage,
    take_early,
)
from vstestbed.core.shares import STOPS

__all__ = ["GOAL_REACHED", "INTERRUPTED", "NOT_REACHED", "REGRESSED", "exit_code"]


class Stream:
    """A standard stream that drops its text from the first error on; None: the process has none."""

    def __init__(self, stream: TextIO | None):
        self._stream: Any = open(os.devnull, "w", encoding="utf-8") if stream is None else stream  # noqa: SIM115, PTH123 - open to the end
        if hasattr(self._stream, "reconfigure"):
            # in a locale without the degree sign it is \xb0
            self._stream.reconfigure(errors="backslashreplace")
        self.lack: OSError | None = None

    def __getattr__(self, name: str) -> Any:
        if name == "buffer":  # else click writes past this class where the encoding is ASCII
            raise AttributeError(name)
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write text, or drop it."""
        self._tried(lambda: self._stream.write(text))
        return len(text)

    def flush(self) -> None:
        """Flush what was written, or drop it."""
        self._tried(self._stream.flush)

    def _tried(self, action: Callable[[], object]) -> None:
        try:
            action()
        except OSError as error:
            # EPIPE: the reader has gone; ENOSPC: `> /dev/full`; EIO: the terminal has gone
            self.lack = self.lack or error
            with contextlib.suppress(OSError), open(os.devnull, "w", encoding="utf-8") as nowhere:  # noqa: PTH123 - os.devnull is no path on Windows
                # for the rest of the buffer, which Python flushes at its end
                os.dup2(nowhere.fileno(), self._stream.fileno())

    @property
    def failed(self) -> str:
        """Why text was lost; empty where nothing was, or where the reader chose to read no further
        (`| head`).
        """
        self.flush()
        return (
            ""
            if self.lack is None or self.lack.errno == errno.EPIPE
            else self.lack.strerror or str(self.lack)
        )


@contextmanager
def standard_streams() -> Iterator[Stream]:
    """Make both streams safe to write to while a command runs; yields standard output."""
    before = sys.stdout, sys.stderr
    out, err = Stream(sys.stdout), Stream(sys.stderr)
    sys.stdout, sys.stderr = cast(TextIO, out), cast(TextIO, err)
    try:
        yield out
    finally:
        out.flush()
        err.flush()
        sys.stdout, sys.stderr = before


class Said(int):
    """An exit code of a command that has said why it ends;
    an equal number need not come from one.
    """


# 128 + SIGINT, as shells have it
GOAL_REACHED, BUG, BAD_INPUT, NOT_REACHED, REGRESSED, INTERRUPTED = 0, 1, 2, 3, 5, Said(130)
LACK = EnvironmentLackError.exit_code
# click.ClickException, also where typer brings a copy of click
UsageMistake: type[Exception] = typer.BadParameter.__mro__[2]


def exit_code(command: Callable[[], object], debug: bool = False) -> int:
    """Do a command; its exit code, also where the reader of its output goes away. A command that
    reached its goal, but could not write all its text because standard output is full or closed,
    ends with LACK.
    """
    with standard_streams() as out, _stopped_by_signals(), _after_all() as ignored:
        code = _guarded(command, debug)
        if code == LACK and not debug:
            gc.collect()  # what the command has left half made
            ignored.clear()
        if out.failed:
            typer.echo(
                f"standard output: {out.failed}, so that text was lost; give it another place",
                err=True,
            )
            return code or LACK
    return code


@contextmanager
def _after_all() -> Iterator[list[str]]:
    """What finalisers raise, and Python ignores, is said after the command: for want of something,
    objects are left half made, whose finalisers fail for reasons that are no news beside the want
    itself, which is known only at the end.
    """
    said: list[str] = []

    def keep(unraisable: sys.UnraisableHookArgs) -> None:
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            hook(unraisable)
            return
        # as text: to keep the object itself would bring it back to life
        with redirect_stderr(io.StringIO()) as text:
            hook(unraisable)
        said.append(text.getvalue())

    hook, sys.unraisablehook = sys.unraisablehook, keep
    try:
        yield said
    finally:
        sys.unraisablehook = hook
        if said and sys.stderr is not None:
            sys.stderr.write("".join(said))


@contextmanager
def _stopped_by_signals() -> Iterator[None]:
    """SIGTERM and SIGHUP interrupt as Ctrl-C does; a signal that is ignored (`nohup`, `&` in a
    script) stays so.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    def again(unraisable: sys.UnraisableHookArgs) -> None:
        # Raised in a finaliser or a callback of a weak reference, the interrupt is ignored by
        # Python: it is sent once more, from another thread and a little later, since here it would
        # be ignored again.
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            threading.Timer(0.05, _thread.interrupt_main).start()
        else:
            hook(unraisable)

    hook, sys.unraisablehook = sys.unraisablehook, again
    before = {number: signal.getsignal(number) for number in STOPS}
    for number, handler in before.items():
        if handler == signal.SIG_DFL:
            signal.signal(number, interrupt)
    try:
        yield
    finally:
        sys.unraisablehook = hook
        for number, handler in before.items():
            signal.signal(number, handler)


def _guarded(command: Callable[[], object], debug: bool) -> int:
    try:
        take_early()
        code = command()
        if code == INTERRUPTED and not isinstance(code, Said):
            # typer turned an interrupt into its 130, without a word: while modules are imported,
            # for example
            raise KeyboardInterrupt
        return code if isinstance(code, int) else GOAL_REACHED
    except VstestbedError as error:
        # a file that cannot be read or written for want of descriptors: another place would not
        # help
        told = lack_of(error) or error
        return _failed(error, str(told), told.exit_code, debug)
    except UsageMistake as error:
        error.show()  # type: ignore[attr-defined] - a ClickException, which typer hands on untyped
        return BAD_INPUT
    except (typer.Abort, KeyboardInterrupt):
        typer.echo("interrupted", err=True)
        return INTERRUPTED
    except BaseException as error:
        return _unforeseen(error, debug)


def _unforeseen(error: BaseException, debug: bool) -> int:
    # the OpenGL bindings look for their driver when they are imported
    if isinstance(error, ImportError):
        from vstestbed.sim import gl_probe as gl

        if (lack := gl.explain(error)) is not None:
            return _failed(error, str(lack), lack.exit_code, debug)
    if (lack := lack_of(error) or shortage()) is not None:
        return _failed(error, str(lack), lack.exit_code, debug)
    what = (
        f"called sys.exit({error.code!r})"
        if isinstance(error, SystemExit)
        else f"raised {type(error).__name__}: {error}"
    )
    place = _place_in_plugin(error)
    if place is None and not isinstance(error, SystemExit):
        return _failed(error, "this is a bug of vstestbed", BUG, debug=True)
    return _failed(
        error, f"{place or 'a plugin'} {what}; mend it (--debug shows the traceback)", BUG, debug
    )


def _place_in_plugin(error: BaseException) -> str | None:
    """The innermost line of a plugin in a traceback, with the plugin's module: of a package that
    has registered a kind.
    """
    from vstestbed.core.registry import REGISTRIES

    packages = {
        member.__module__.partition(".")[0]
        for kinds in REGISTRIES
        for member in kinds.members.values()
    } - {"vstestbed"}
    place = None
    for frame, line in traceback.walk_tb(error.__traceback__):
        module = str(frame.f_globals.get("__name__"))
        if module.partition(".")[0] in packages:
            code = frame.f_code
            name = module.partition("@")[0]  # what follows tells files of one name apart
            place = f"{code.co_filename}:{line}: {code.co_qualname} of plugin {name}"
    return place


def _failed(error: BaseException, words: str, code: int, debug: bool) -> int:
    if debug:
        traceback.print_exception(error)  # it ends with the words of an error of this package
    if not debug or words != str(error):
        typer.echo(words, err=True)
    return code
