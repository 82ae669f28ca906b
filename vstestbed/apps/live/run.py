"""A run that goes on while it is looked at: a session, its settings, its pace. Nothing here knows
of pages.
"""

from __future__ import annotations

import contextlib
import copy
import functools
import itertools
import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from vstestbed.core.errors import Mistake, ParameterError, ScenarioError, nearest, short
from vstestbed.core.fields import fields
from vstestbed.core.files import file_word, numbered, write_whole
from vstestbed.core.geometry import Array, inverse, transform
from vstestbed.core.named_files import FILE_FIELDS
from vstestbed.core.outcome import Verdict
from vstestbed.core.registry import REGISTRIES, SPECS, to_mapping
from vstestbed.loop.session import Session
from vstestbed.report.video.overlay import FilmFrame
from vstestbed.scenario.dump import given_text
from vstestbed.scenario.load import GIVEN, load
from vstestbed.scenario.plugins import absolute_files
from vstestbed.scenario.scenario import Scenario
from vstestbed.scenario.yaml_marks import from_option
from vstestbed.targets.picture import TEXTURE, textures
from vstestbed.tasks.frame import Frame
from vstestbed.tasks.judged import in_a_frame, in_words_unit

# the setting that draws start and noise as `--seed` does; None for the scenario's own start
SEED = "seed"
DISTORTION = "camera.distortion"
TEXTS = {"name", "description", "plugins"}


class Settings:
    """A scenario, and the settings that replace values of it from the start, by dotted path; seed,
    plugins and errors as of `load`.
    """

    def __init__(
        self,
        name: str | Path,
        overrides: Mapping[str, object] | None = None,
        seed: int | None = None,
        plugins: Sequence[str] = (),
    ):
        self._name = name
        self._plugins = tuple(plugins)
        self._overrides = dict(overrides or {})
        self.seed = seed
        self.scenario = self._loaded(self._overrides, seed)
        given: dict[str, Any] = to_mapping(self.scenario)
        self._given: set[str] = set()
        for block in given.keys() - TEXTS:
            self._given.update(text for _, text in _texts(given[block], block))

    def _loaded(self, overrides: Mapping[str, object], seed: int | None) -> Scenario:
        return load(self._name, overrides, seed, from_option(overrides), self._plugins)

    def change(self, path: str, value: object) -> Scenario:
        """Set a field, and load the scenario again; what is refused changes nothing. value: as YAML
        would read it.
        Raises ScenarioError: all mistakes that the new value makes, as `--set` tells them; a text
        in it that may name a file.
        """
        self._refuse_new_texts(path, value)
        seed = self.seed
        overrides = self._overrides
        if path == SEED:
            seed = _seed(value)
        else:
            overrides = self._overridden(path, value)
        self.scenario = self._loaded(overrides, seed)
        self._overrides = overrides
        self.seed = seed
        return self.scenario

    def _overridden(self, path: str, value: object) -> dict[str, object]:
        """The overrides with a new one. What was set inside the old value, or round it, is gone;
        the last setting is applied last.
        """
        block, _, item = path.rpartition(".")
        # all coefficients at once: a lens without distortion has no list to change
        if block == DISTORTION and item.isdecimal():
            now: Any = getattr(self.scenario.camera, "distortion", None) or (0.0,) * 5
            path = block
            value = [value if i == int(item) else k for i, k in enumerate(now)]
        kept = {
            p: v for p, v in self._overrides.items() if p != path and not p.startswith(f"{path}.")
        }
        return kept | {path: value}

    def _refuse_new_texts(self, path: str, value: object) -> None:
        """Refuse a text that is neither a word of vstestbed or of its plugins, nor in the scenario
        that the command line named: so a page can name no file, and run no code, that the command
        line did not name, whichever field it is in, also of a plugin.
        """
        if path.split(".")[0] == "plugins":
            raise ScenarioError(
                [Mistake("page", path, "can be given on the command line alone (--plugin)")]
            )
        # as the scenario has the names of files
        found = absolute_files({path: value}, Path.cwd())[path]
        block = path.rpartition(".")[2]
        for (key, text), (_, told) in zip(_texts(found, block), _texts(value, block), strict=True):
            # the levels of `realism` are words; its files end as no word does
            if key in FILE_FIELDS and key != "realism":
                known = self._given | {f"{TEXTURE}{name}" for name in textures()}
            else:
                kinds = sum(len(registry.members) for registry in REGISTRIES)
                known = self._given | _words(kinds, len(SPECS))
            if text not in known:
                hint = nearest(text, filter(str.isidentifier, known))
                if block in TEXTS or not hint.startswith("did you mean"):
                    where = f"on the command line alone (--set {path}=...)"
                    hint = f"files and new names are given {where}"
                words = f"{short(told)} is no word of this scenario; {hint}"
                raise ScenarioError([Mistake("page", path, words)])

    def keep(self, note: str = "") -> Path:
        """Write the scenario that repeats these settings from the start,
        `runs/<scenario>/live/<number>/scenario.yaml`. note: joins the description, such as what was
        changed by hand meanwhile. Raises OutputError, EnvironmentLackError.
        """
        scenario = self.scenario
        if note:
            scenario = scenario.but(description=f"{scenario.description} {note}".strip())
        folder = numbered(Path("runs") / file_word(scenario.name) / "live")
        return write_whole(folder / GIVEN, given_text(scenario))


def _seed(value: object) -> int | None:
    """What a page gives as a seed; ScenarioError where it is none."""
    if value is None:
        return None
    if not isinstance(value, int) or isinstance(value, bool) or value < 0:
        words = f"must be a whole number from 0 on, got {value!r}"
        raise ScenarioError([Mistake("page", SEED, words)])
    return value


def _texts(value: object, key: str) -> Iterator[tuple[str, str]]:
    """All texts in plain values, each with its field, and what else is neither a number nor a truth
    value as the text for it.
    """
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _texts(inner, name)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from _texts(inner, key)
    elif value is not None and not isinstance(value, bool | int | float):
        yield key, str(value)


@functools.lru_cache(maxsize=1)
def _words(kinds: int, specs: int) -> frozenset[str]:
    """The kinds, and the words between which a field has the choice, of so many kinds and specs: a
    plugin adds some.
    """
    found: set[str] = set()
    for registry in REGISTRIES:
        found.update(registry.members)
    for cls in SPECS:
        for field in fields(cls).values():
            for leaf in field.node.leaves():
                found.update(word for word in leaf.words if isinstance(word, str))
    return frozenset(found)


# What pages ask for, handed to the thread that runs the simulation; nothing else passes between the
# two.
Order = Callable[[], object]


class Inbox:
    """Orders in the sequence in which they came. Of several with one key, such as those of a slider
    that is drawn, only the last stays.
    """

    def __init__(self) -> None:
        self._orders: dict[object, Order] = {}
        self._come = threading.Condition()
        self._numbers = itertools.count()

    def put(self, order: Order, key: str | None = None) -> None:
        """Add an order, from any thread. key: what it sets; None for one that counts, such as a
        click.
        """
        with self._come:
            name: object = next(self._numbers) if key is None else key
            self._orders.pop(name, None)
            self._orders[name] = order
            self._come.notify()

    def waits(self, key: str) -> bool:
        """Whether an order of this key has not been taken yet."""
        with self._come:
            return key in self._orders

    def take(self, wait_s: float) -> list[Order]:
        """All orders, which are then gone; where there is none, wait for one, but not for long."""
        with self._come:
            if not self._orders and wait_s > 0:
                self._come.wait(wait_s)
            orders, self._orders = list(self._orders.values()), {}
            return orders


class Served:
    """An app whose pages, and other threads, ask for things that the thread that serves does."""

    def __init__(self) -> None:
        self._inbox = Inbox()
        self._stop = threading.Event()

    def ask(self, order: Order) -> None:
        """Let the thread that serves do something, as a page does; from any thread."""
        self._inbox.put(order)

    def stop(self) -> None:
        """Let `serve` return; from any thread."""
        self._stop.set()
        self._inbox.put(lambda: None)


# how far behind its pace a run may be and still catch up; beyond, it goes on from where it is
LATE_S = 0.25
MEASURED_S = 2.0  # time on the wall over which the pace is measured


@dataclass(frozen=True, slots=True)
class Sample:
    """What a page shows of one frame. twist: commanded (6,), NaN where unknown. judged: the error
    by which the task is judged, in `unit`. T_world_goal: the camera's pose (4, 4) at its goal, if
    it has one. verdict: how the run ended with it; None while it goes on.
    """

    number: int
    film: FilmFrame
    twist: Array
    judged: float
    unit: str
    T_world_goal: Array | None
    verdict: Verdict | None = None


class Transport:
    """Whether time goes on (`playing`), and how fast: `speed` in simulated seconds a second, inf
    for as fast as the machine can.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self.playing = True
        self.speed = 1.0
        self._steps = 0
        self._anchor: tuple[float, float] | None = None
        self._passed: deque[tuple[float, float]] = deque()

    def play(self, on: bool) -> None:
        """Go on, or pause; steps that wait are dropped."""
        self.playing = on
        self.begin()

    def step(self) -> None:
        """One frame more, then pause."""
        if self.playing:
            self.play(False)
        self._steps += 1

    def set_speed(self, speed: float) -> None:
        """Simulated seconds a second, from now on."""
        self.speed = speed
        self.restart_pace()

    def begin(self) -> None:
        """Begin anew: steps that wait are dropped."""
        self._steps = 0
        self.restart_pace()

    def restart_pace(self) -> None:
        """The pace counts from the next frame on."""
        self._anchor = None
        self._passed.clear()

    def wait_s(self, t: float) -> float | None:
        """How long the next frame is not due [s], where t is the time of the last one; None where
        none is to come.
        """
        if self._steps:
            return 0.0
        if not self.playing:
            return None
        now = self._clock()
        if self._anchor is None:
            self._anchor = now, t
        due = self._anchor[0] + (t - self._anchor[1]) / self.speed
        if now - due > LATE_S:
            self._anchor = now, t
        return max(0.0, due - now)

    def passed(self, t: float) -> None:
        """A frame of time t [s] was made."""
        self._steps = max(0, self._steps - 1)
        now = self._clock()
        self._passed.append((now, t))
        while now - self._passed[0][0] > MEASURED_S and len(self._passed) > 2:
            self._passed.popleft()

    @property
    def pace(self) -> float:
        """Simulated seconds a second over the last moments; NaN while it is not known."""
        if len(self._passed) < 2:
            return math.nan
        wall, t = self._passed[0]
        wall_now, t_now = self._passed[-1]
        return (t_now - t) / (wall_now - wall) if wall_now > wall else math.nan


PICTURE_S, REST = 1 / 15, 2.5
"""Least time on the wall between two whole pictures [s], and over the time that a frame with one
took.
"""


class LiveRun:
    """A run that can be stopped, stepped, tuned and disturbed. frames: how many there were.
    restarts: counts the episodes.
    """

    def __init__(self, settings: Settings):
        self.settings = settings
        self.transport = Transport()
        self.restarts = self.frames = 0
        self._next_picture = 0.0
        self.session: Session
        self.last: Sample
        self.frame: Frame
        self.restart()

    @property
    def scenario(self) -> Scenario:
        """In force now, as it runs; `settings.scenario` is what was given."""
        return self.settings.scenario.resolved

    @property
    def ended(self) -> bool:
        """Whether the run has an outcome."""
        return self.frame.outcome is not None

    @property
    def by_hand(self) -> tuple[str, ...]:
        """What was changed by hand in this run, which its scenario does not repeat."""
        episode = self.session.episode
        return tuple(episode.by_hand) if episode else ()

    def restart(self) -> None:
        """Begin again, with the settings in force. A run that cannot begin leaves the one before as
        it is.
        """
        # of the plate in reserve [m]: it hides one marker
        edge = max(0.06, 5.0 * self.scenario.target.marker.radius)
        session = Session(self.scenario, pictures=True, plate_m=edge)
        frame = session.reset()
        if self.restarts:
            self.session.close()
        self.session = session
        self.plate_m = edge
        self.restarts += 1
        self.frames = 0
        self.transport.begin()
        self._show(frame)

    def wait_s(self) -> float | None:
        """How long the next frame is not due [s]; None where none is to come: paused, or at the
        end.
        """
        return None if self.ended else self.transport.wait_s(self.frame.t)

    def turn(self) -> None:
        """One frame more; with a whole picture not more often than a page shows it, nor than the
        machine can.
        """
        began = time.monotonic()
        wanted = not self.transport.playing or began >= self._next_picture
        self.session.take_pictures(wanted)
        frame = self.session.step()
        if wanted:
            now = time.monotonic()
            self._next_picture = now + max(PICTURE_S, REST * (now - began))
        self._show(frame)

    def change(self, path: str, value: object) -> bool:
        """Change a setting, at once where the law alone changes and can, else with a new start;
        whether there was one.
        """
        before = copy.copy(self.settings)  # `change` replaces its parts, and writes into none
        was = before.scenario.resolved
        now = self.settings.change(path, value).resolved
        try:
            if now == was:
                return False
            if not self.ended and replace(now, law=was.law) == was:
                # of another kind or feature: its state begins anew
                with contextlib.suppress(ParameterError):
                    self.session.retune(now.law)
                    return False
            self.restart()
            return True
        except BaseException:
            self.settings = before
            raise

    def push(self, force: Array, duration_s: float) -> None:
        """Push the robot; ParameterError where it has no mass."""
        self._goes_on()
        self.session.push(force, duration_s)

    def move_target(self, T_world_target: Array) -> None:
        """Put the target at a pose (4, 4); ParameterError where it is carried."""
        self._goes_on()
        self.session.move_target(T_world_target)

    def check_target_free(self) -> None:
        """ParameterError where the target is carried, so that nobody else can move it."""
        target = self.scenario.target
        if target.on_gripper or target.carrier is not None:
            raise ParameterError.excluded("target", "moved", why="it goes where its carrier goes")

    def hold_plate(self, T_world_plate: Array | None) -> None:
        """Hold the plate at a pose (4, 4), or take it away."""
        self._goes_on()
        self.session.hold_plate(T_world_plate)

    def before_marker(self, i: int) -> Array:
        """The pose (4, 4) of a plate that hides marker i (without markers, the target's middle)
        from the camera where it is now.
        """
        truth = self.frame.truth
        places = self.scenario.target.places
        if not len(places):
            places = np.zeros((1, 3))
        marker = transform(truth.T_world_target, places)[min(i, len(places) - 1)]
        T = truth.T_world_camera.copy()
        T[:3, 3] += 0.75 * (marker - T[:3, 3])  # nearer to the marker than to the camera
        return T

    def _goes_on(self) -> None:
        if self.ended:
            raise ParameterError("run", "has ended; reset it first")

    def _show(self, frame: Frame) -> None:
        s = self.scenario
        values = dict(zip(s.own_columns, frame.row.tolist(), strict=True))
        values |= {"error_px": frame.error.rms_px, "frame": frame.timing.number}
        values["view"] = frame.goal.view
        self.frame = frame
        self.last = sample(s, FilmFrame.of_frame(frame), values, frame.twist, frame.verdict)
        self.frames += 1
        self.transport.passed(frame.t)

    def close(self) -> None:
        """Free the simulation."""
        self.session.close()


def sample(
    scenario: Scenario,
    film: FilmFrame,
    values: Mapping[str, float],
    twist: Array,
    verdict: Verdict | None,
) -> Sample:
    """A frame as pages show it, from a session or a log; values: its columns `frame`, `view` (0
    without), `error_px` and the scenario's own.
    """
    judged = in_a_frame(scenario.goal.judged, scenario.stop, values)
    value, unit = in_words_unit(judged.value, judged.unit)
    T_world_goal = scenario.goal_pose_at(film.t, int(values.get("view", 0)))
    if T_world_goal is not None:
        T_world_goal = film.T_world_target @ inverse(T_world_goal)
    return Sample(int(values["frame"]), film, twist, value, unit, T_world_goal, verdict)
