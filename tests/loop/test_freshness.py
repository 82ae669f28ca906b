"""A robot that must stop: no velocity is ordered by an old picture, whatever stamps say; pictures
that do not change are told.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.core.errors import ParameterError
from vstestbed.core.outcome import Outcome
from vstestbed.loop.controller import FROZEN
from vstestbed.loop.inputs import OwnClock

TIMEOUT_S, LOST_S, PERIOD_S = 0.5, 0.2, 0.04
SETTINGS = {
    "camera.width": 320,
    "camera.height": 240,
    "stop.lost_after_s": LOST_S,
    "target.marker.radius": 0.06,
}


class Message(NamedTuple):
    """What a camera's driver gives. t: stamp [s]. arrived: as the caller tells it. new: whether the
    picture has other bytes.
    """

    t: float
    arrived: float | None = None
    new: bool = True


@dataclass
class Clock:
    """The receiver's own clock."""

    now: float = 5e5

    def __call__(self) -> float:
        return self.now


class Robot:
    """A robot by the loop of the guide: each message is one period after the last one, and a
    picture that is refused is none.
    """

    def __init__(self, shown: tuple[vs.Scenario, np.ndarray, vs.Reading], **changes: Any):
        scenario, self.image, self.reading = shown
        self.controller = vs.Controller(replace(scenario, stop=replace(scenario.stop, **changes)))
        self.clock = self.controller.clock = Clock()
        self.began, self.fresh_at, self.newest = self.clock.now, math.nan, -math.inf
        self.dither: Iterator[int] = itertools.cycle(range(251))
        self.notes: tuple[str, ...] = ()

    @property
    def now(self) -> float:
        """Time since the begin by the receiver's clock [s]."""
        return self.clock.now - self.began

    def picture(self, new: bool) -> np.ndarray:
        """The picture, of other bytes where it is new."""
        image = self.image.copy()
        if new:
            image[0, 0] = next(self.dither)
        return image

    def hears(self, message: Message, after_s: float = PERIOD_S) -> Any:
        """The order after one more message."""
        self.clock.now += after_s
        try:
            cycle = self.controller.step(
                self.picture(message.new), message.t, self.reading, message.arrived
            )
        except ParameterError:
            try:
                return self.controller.without_picture(max(self.now, self.newest), self.reading)
            except ParameterError:  # a time that goes back: the caller's `finally` stops the robot
                return None
        if message.t > self.newest:
            self.newest, self.fresh_at = message.t, self.clock.now
        self.notes = cycle.notes
        assert cycle.order.stopped == (not cycle.twist.any()) and (
            not cycle.stopped or not cycle.setpoint.any()
        )
        return cycle.order

    @property
    def age(self) -> float:
        """Of the last new picture by the receiver's clock [s]."""
        return self.clock.now - self.fresh_at


def moves(order: Any) -> bool:
    """Whether an order is a velocity."""
    return order is not None and bool(order.twist.any() or order.setpoint.any())


@pytest.fixture(scope="module")
def shown() -> tuple[vs.Scenario, np.ndarray, vs.Reading]:
    """An arm's scenario, the picture of its start, and its reading there."""
    scenario = vs.load("arm_ibvs", SETTINGS)
    assert (
        scenario.timing.order_s(scenario.camera) == TIMEOUT_S and scenario.camera.period == PERIOD_S
    )
    with vs.Session(scenario, pictures=True) as session:
        frame = session.reset()
        assert frame.image is not None
        return scenario, frame.image, vs.Reading(frame.truth.q, np.zeros(6))


BEGIN = 0.2
"""When the camera goes wrong, after a few right pictures [s]."""
nan, inf = math.nan, math.inf
PATTERNS: dict[str, Callable[[float], Message]] = {
    "frozen": lambda now: Message(0.2),
    "frozen, new bytes": lambda now: Message(0.2, new=True),
    "frozen, same bytes": lambda now: Message(0.2, new=False),
    "frozen, with the time of arrival": lambda now: Message(0.2, now),
    "frozen, its stamp for the arrival": lambda now: Message(0.2, 0.2),
    "frozen, arrival stands still": lambda now: Message(0.2, 0.25),
    "frozen, arrival goes back": lambda now: Message(0.2, 0.24 - 0.01 * now),
    "frozen, arrival is none": lambda now: Message(0.2, nan),
    "frozen, arrival is infinite": lambda now: Message(0.2, inf),
    "zero": lambda now: Message(0.0),
    "zero, arrival told": lambda now: Message(0.0, now),
    "the last two in turn": lambda now: Message(0.2 if round(now / PERIOD_S) % 2 else 0.16),
    "the last two in turn, arrival told": lambda now: Message(
        0.2 if round(now / PERIOD_S) % 2 else 0.16, now
    ),
    "backwards": lambda now: Message(0.4 - now),
    "backwards, arrival told": lambda now: Message(0.4 - now, now),
    "before the begin": lambda now: Message(-100.0 + now, now),
    "not a number": lambda now: Message(nan),
    "infinite": lambda now: Message(inf, now),
    "minus infinite": lambda now: Message(-inf, now),
    "the largest": lambda now: Message(1e308, now),
    "beyond all floats": lambda now: Message(10**400, now),
    "far future, arrival told": lambda now: Message(1e6, now),
    "far future once, then right, arrival told": lambda now: Message(
        1e6 if now < 0.25 else 0.2, now
    ),
    "far future once, then frozen": lambda now: Message(1e6),
    "creeping, arrival told": lambda now: Message(0.2 + 1e-6 * (now - BEGIN), now),
    "an old queue": lambda now: Message(0.2 + 0.01 * (now - BEGIN), now),
    "an hour old": lambda now: Message(now - 3600.0, now),
}


@pytest.mark.parametrize("pattern", PATTERNS)
def test_whatever_stamps_say_it_stops_and_stays_stopped(shown: Any, pattern: str) -> None:
    """By the receiver's clock: within the timeout of the last new picture, then for good."""
    robot = Robot(shown)
    first = [robot.hears(Message(k * PERIOD_S, k * PERIOD_S + 0.02)) for k in range(1, 6)]
    assert all(moves(order) for order in first)
    order, silent_since = None, robot.clock.now
    while robot.clock.now - silent_since < TIMEOUT_S + LOST_S + 4 * PERIOD_S:
        order = robot.hears(PATTERNS[pattern](robot.now + PERIOD_S))
        # a stamp of the far future is a new picture, once, unless the time of arrival is told
        assert not moves(order) or robot.clock.now - silent_since < TIMEOUT_S + 2 * PERIOD_S, (
            robot.now,
            robot.notes,
        )
    assert order is not None and order.stopped and order.latched, order
    right = robot.hears(Message(max(robot.newest, robot.now) + PERIOD_S))
    assert right.stopped and right.latched
    robot.controller.reset()
    robot.newest = -math.inf
    assert moves(robot.hears(Message(0.0)))


@pytest.mark.parametrize("after_s", [0.001, 0.04, 0.3, 5.0, 3600.0])
def test_a_picture_that_comes_again_at_any_rate(shown: Any, after_s: float) -> None:
    robot = Robot(shown)
    assert moves(robot.hears(Message(0.0)))
    order = None
    while robot.age < 1.0:
        order = robot.hears(Message(0.0), after_s)
        assert moves(order) == (robot.age < TIMEOUT_S - 1e-9), robot.age
    assert order is not None and order.latched == (robot.age >= TIMEOUT_S + LOST_S)


def test_the_example_that_kept_it_moving(shown: Any) -> None:
    """The note said that the robot is told to stop; now it is."""
    scenario, image, reading = shown
    controller = vs.Controller(scenario)
    assert moves(controller.step(image, 0.0, reading).order)
    again = controller.step(image, 0.0, reading, arrived=60.0)
    assert again.stopped and again.latched and not again.twist.any() and not again.setpoint.any()
    assert "the picture is 60 s old: the robot is told to stop" in again.notes


def test_what_the_note_says_is_done(shown: Any) -> None:
    """A picture that came late and comes again is too old earlier than by the time since its
    coming.
    """
    scenario, image, reading = shown
    controller = vs.Controller(scenario)
    assert moves(controller.step(image, 0.0, reading, arrived=0.4).order)
    again = controller.step(image, 0.0, reading, arrived=0.4 + 0.99 * TIMEOUT_S)
    assert "told to stop" in again.notes[1] and again.stopped


def test_a_repetition_in_time_is_answered_as_before(shown: Any) -> None:
    robot = Robot(shown)
    first = robot.hears(Message(0.0, 0.02))
    for _ in range(5):
        again = robot.hears(Message(0.0, robot.now + 0.02))
        assert again.twist.tobytes() == first.twist.tobytes() and not again.stopped


def test_one_question_after_a_long_silence_gives_the_task_up(shown: Any) -> None:
    """Also where nobody asked in time, the silence began when the last order ended."""
    robot = Robot(shown)
    assert moves(robot.hears(Message(0.0, 0.02)))
    assert robot.controller.without_picture(0.02 + TIMEOUT_S + LOST_S, robot.reading).latched


def test_a_stop_ends_with_a_new_picture_before_the_task_is_given_up(shown: Any) -> None:
    robot = Robot(shown)
    robot.hears(Message(0.0))
    stopped = robot.hears(Message(0.0), TIMEOUT_S + 0.5 * LOST_S)
    assert stopped.stopped and not stopped.latched and stopped.reason == "no picture arrived"
    assert moves(robot.hears(Message(0.7)))
    assert not robot.hears(Message(0.7), TIMEOUT_S + 0.5 * LOST_S).latched  # it begins anew


@pytest.mark.parametrize("name", ["car_line", "omni_line", "arm_ibvs"])
@pytest.mark.parametrize("creeps", ["stamps", "arrivals, too"])
def test_a_target_that_is_gone_is_lost_by_the_own_clock(name: str, creeps: str) -> None:
    """Five right pictures, then blank ones whose stamps go on by a microsecond: of another unit, or
    of a failed driver.
    """
    scenario = vs.load(name)
    with vs.Session(scenario, pictures=True) as session:
        image, reading = session.reset().image, session.episode.plant.reading()
    assert image is not None
    controller, clock = vs.Controller(scenario), Clock()
    controller.clock = clock
    last = 4 * PERIOD_S
    for k in range(200):
        clock.now += PERIOD_S
        picture = image.copy() if k < 5 else np.full_like(image, 90)
        picture[0, 0] = k % 251
        t = k * PERIOD_S if k < 5 else last + (k - 4) * 1e-6
        arrived = t + 0.01 if creeps != "stamps" else None
        cycle = controller.step(picture, t, reading, arrived)
        blind_s = (k - 4) * PERIOD_S
        if blind_s > scenario.stop.lost_after[0] + 2 * PERIOD_S:
            # a car keeps its steering
            assert cycle.order.latched and not cycle.order.twist.any(), blind_s


@pytest.mark.parametrize("step_s", [1e-9, 4e-5])
@pytest.mark.parametrize("creeps", ["stamps", "arrivals, too"])
def test_new_pictures_whose_stamps_hardly_advance_stop_the_robot(
    shown: Any, step_s: float, creeps: str
) -> None:
    """Of another unit, or of a failed driver: 1 ns apart, they were all fresh. The target is in
    sight.
    """
    robot = Robot(shown, lost_after_s=10.0)
    told = creeps != "stamps"
    for k in range(60):
        t = k * step_s
        order = robot.hears(Message(t, t + 0.01 if told else None))
        assert moves(order) == (k * PERIOD_S < TIMEOUT_S - 1e-9), k
    assert "of the own clock: the robot is told to stop" in " ".join(robot.notes)
    for k in range(5):  # right stamps
        assert moves(robot.hears(Message(10.0 + k * PERIOD_S)))


@pytest.mark.parametrize("told", [True, False])
def test_a_slow_law_in_lockstep_and_a_burst_of_pictures_are_none(shown: Any, told: bool) -> None:
    robot = Robot(shown)
    for k in range(30):  # time is simulated, and each step takes a minute
        t = k * PERIOD_S
        assert moves(robot.hears(Message(t, t + 0.01 if told else None), 60.0))
    robot = Robot(shown)
    times = [k * PERIOD_S + more for k in range(25) for more in (0.0, 1e-4, 2e-4)]
    for t in times:
        assert moves(robot.hears(Message(t), 0.013))
    robot = Robot(shown)
    robot.controller.simulates(True)
    for k in range(40):  # stamps alone tell the time
        assert moves(robot.hears(Message(1e-9 * k), 60.0))


def test_times_of_other_units_are_refused_by_name(shown: Any) -> None:
    """A float cannot tell one nanosecond since 1970 from the next."""
    robot = Robot(shown)
    for t in (1.8e18, 1.8e12, np.float32(1.8e18), np.datetime64("2026-01-01")):
        with pytest.raises(ParameterError, match=r"^t .*seconds"):
            robot.controller.step(robot.picture(True), t, robot.reading)
    # nothing has changed
    cycle = robot.controller.step(robot.picture(True), np.float32(0.5), robot.reading)
    assert moves(cycle.order)


def test_a_picture_that_comes_again_after_an_error_is_as_old_as_it_was(
    shown: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = Robot(shown)
    for k in range(5):
        robot.hears(Message(k * PERIOD_S))
    detector = type(robot.controller._perception)
    with monkeypatch.context() as broken:
        broken.setattr(detector, "detect", lambda *given: 1 / 0)
        for _ in range(100):
            with pytest.raises(ZeroDivisionError):
                robot.hears(Message(5 * PERIOD_S))
    assert not moves(robot.hears(Message(5 * PERIOD_S)))


@pytest.mark.parametrize("set_to", [-3600.0, nan])
def test_a_clock_that_is_set_counts_forwards_alone(shown: Any, set_to: float) -> None:
    robot = Robot(shown)
    for k in range(5):
        robot.hears(Message(k * PERIOD_S))
    robot.clock.now += set_to
    orders = [robot.hears(Message(4 * PERIOD_S)) for _ in range(40)]
    assert orders[-1].latched and not any(moves(order) for order in orders[13:])


def test_a_clock_that_once_tells_no_time_counts_on_afterwards(shown: Any) -> None:
    robot = Robot(shown)
    right = robot.clock.now
    robot.clock.now = nan
    robot.hears(Message(0.0))
    robot.clock.now = right
    for k in range(1, 5):
        robot.hears(Message(k * PERIOD_S))
    orders = [robot.hears(Message(4 * PERIOD_S)) for _ in range(40)]
    assert orders[-1].latched and not any(moves(order) for order in orders[14:])


@pytest.mark.parametrize("once", [inf, -inf, 1e18, 1e300, -1e300])
def test_a_clock_that_is_wrong_once_counts_on_afterwards(shown: Any, once: float) -> None:
    """Of a sum that such a time had entered, a float would lose all the steps that follow."""
    robot = Robot(shown)
    right = robot.clock.now
    robot.clock.now = once
    robot.hears(Message(0.0), 0.0)
    robot.clock.now = right
    for k in range(1, 5):
        robot.hears(Message(k * PERIOD_S))
    orders = [robot.hears(Message(4 * PERIOD_S)) for _ in range(40)]
    assert (
        moves(orders[0]) and orders[-1].latched and not any(moves(order) for order in orders[14:])
    )


@pytest.mark.parametrize("first", [nan, inf, -inf])
def test_a_clock_that_begins_wrong_counts_from_its_first_time_on(first: float) -> None:
    clock = Clock(first)
    own = OwnClock(clock)
    clock.now = 5e5
    begun = own.s()
    clock.now += 0.25
    assert own.s() - begun == 0.25


def test_silence_is_counted_by_the_own_clock_where_the_time_that_is_told_stands_still(
    shown: Any,
) -> None:
    robot = Robot(shown)
    for k in range(5):
        robot.hears(Message(k * PERIOD_S))
    for _ in range(30):
        robot.clock.now += PERIOD_S
        order = robot.controller.without_picture(5 * PERIOD_S, robot.reading)
    assert order.latched


def test_a_further_camera_that_is_frozen_is_told_and_ends_the_task() -> None:
    """The own camera lives, and sees nothing; the room's tells the same bytes again and again."""
    scenario = vs.load("arm_two_eyes", {"stop.frozen_after_s": 1.0})
    with vs.Session(scenario, pictures=True) as session:
        frame = session.reset()
        reading, own = session.episode.plant.reading(), frame.image
        while "room" not in frame.cameras or frame.cameras["room"].image is None:
            frame = session.step()
        room = frame.cameras["room"].image
    assert own is not None and room is not None
    controller, clock = vs.Controller(scenario), Clock()
    controller.clock = clock
    notes: list[str] = []
    for k in range(50):
        clock.now += PERIOD_S
        picture = own.copy() if k < 5 else np.full_like(own, 90)
        picture[0, 0] = k % 251
        cycle = controller.step(
            {"camera": picture, "room": room}, k * PERIOD_S, reading, k * PERIOD_S + 0.01
        )
        notes += cycle.notes
    assert f"room: {FROZEN}" in notes
    assert cycle.latched and "frozen" in cycle.reason


class Eyes:
    """Two cameras: the own one sees the target in its first five pictures, the room's in one at .15
    s.
    """

    def __init__(self) -> None:
        scenario = vs.load("arm_two_eyes")
        with vs.Session(scenario, pictures=True) as session:
            frame = session.reset()
            self.reading, own = session.episode.plant.reading(), frame.image
            while "room" not in frame.cameras or frame.cameras["room"].image is None:
                frame = session.step()
            room = frame.cameras["room"].image
        assert own is not None and room is not None
        self.own, self.room = own, room
        self.controller, self.clock = vs.Controller(scenario), Clock()
        self.controller.clock = self.clock
        self.shown = 0

    def own_picture(self, t: float, arrived: float | None = None) -> vs.Order:
        """The order by one more picture of the own camera."""
        self.clock.now += PERIOD_S
        picture = self.own.copy() if self.shown < 5 else np.full_like(self.own, 90)
        picture[0, 0] = self.shown % 251
        self.shown += 1
        return self.controller.step(picture, t, self.reading, arrived).order


@pytest.fixture
def eyes() -> Eyes:
    return Eyes()


@pytest.mark.parametrize("creeps", [True, False])
def test_the_last_picture_of_a_further_camera_grows_old_by_the_own_clock(
    eyes: Eyes, creeps: bool
) -> None:
    """The room's was the last to see the target; its stamp is ahead, or the own stamps stand nearly
    still.
    """
    for k in range(5):
        eyes.own_picture(k * PERIOD_S)
    eyes.controller.look("room", eyes.room, 0.15 if creeps else 0.6, eyes.reading)
    orders = [
        eyes.own_picture(0.16 + 1e-6 * k if creeps else 0.16 + PERIOD_S * k) for k in range(1, 60)
    ]
    # as long as an order lasts, two and a half periods of the room's camera, and until the target
    # is lost
    assert (
        moves(orders[0]) and not any(moves(order) for order in orders[25:]) and orders[-1].latched
    )


def test_a_stamp_of_the_future_of_a_further_camera_is_refused_by_name(eyes: Eyes) -> None:
    for k in range(5):
        eyes.own_picture(k * PERIOD_S)
    for t in (0.16 + TIMEOUT_S + 0.01, 100.0, 1e6):
        with pytest.raises(
            ParameterError,
            match=r"^t must be at most 0.66 s, .* from now .* all stamps are of one clock",
        ):
            eyes.controller.look("room", eyes.room, t, eyes.reading)
    eyes.controller.look("room", eyes.room, 0.16, eyes.reading)  # nothing has changed


def test_recorded_pictures_of_a_further_camera_go_on_in_a_gap_of_the_own(eyes: Eyes) -> None:
    """Fed at full speed: by the own clock no time passes."""
    for k in range(5):
        eyes.own_picture(k * PERIOD_S)
    for k in range(30):
        eyes.controller.look("room", eyes.room, 0.2 + k * 0.1, eyes.reading)


def test_a_further_cameras_picture_that_counts_for_nothing_is_told(eyes: Eyes) -> None:
    """By its stamp it is new; the own clock has gone on, such as through a slow law."""
    eyes.own_picture(0.0)
    eyes.controller.look("room", eyes.room, 0.01, eyes.reading)
    eyes.clock.now += 2.0
    cycle = eyes.controller.step(eyes.own, PERIOD_S, eyes.reading)
    assert "room: the last picture came 2 s ago: it counts for nothing" in cycle.notes


@pytest.mark.parametrize("took_s", [0.2, 1.0])
def test_where_time_is_simulated_the_own_clock_stands(shown: Any, took_s: float) -> None:
    """Each picture takes so long; the target is hidden for .4 s by the stamps, of 1 s after which
    it is lost.
    """
    robot = Robot(shown, lost_after_s=1.0)
    robot.controller.simulates(True)
    image, orders = robot.image, []
    for k in range(40):
        robot.image = np.full_like(image, 90) if 10 <= k < 20 else image
        orders.append(robot.hears(Message(k * PERIOD_S), took_s))
    assert (
        not orders[15].latched and orders[15].stopped and all(moves(order) for order in orders[20:])
    )
    robot.controller.simulates(False)  # from now on it counts
    assert moves(robot.hears(Message(40 * PERIOD_S)))
    assert not moves(robot.hears(Message(40 * PERIOD_S), TIMEOUT_S + 0.01))


def test_pictures_of_one_time_are_taken_all_or_none(eyes: Eyes) -> None:
    both = {"camera": eyes.own, "room": eyes.room}
    eyes.controller.step(both, 0.0, eyes.reading, 0.01)
    assert eyes.controller.step(both, 0.0, eyes.reading, 0.02).notes == (
        "the picture of 0 s came again",
    )
    for wrong in (
        {"camera": eyes.own[:10], "room": eyes.room},
        {"camera": eyes.own, "room": eyes.room[:10]},
    ):
        with pytest.raises(ParameterError, match="uint8, RGB"):
            eyes.controller.step(wrong, 0.04, eyes.reading, 0.05)
    right = eyes.controller.step(both, 0.04, eyes.reading, 0.05)
    assert not right.notes and right.timing.number == 1 and eyes.controller.others is not None
    assert eyes.controller.others.perception["room"].before.t == 0.04


def test_a_law_that_takes_longer_than_its_command_lasts(
    shown: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the time of arrival is told. A film, whose caller tells none, has time."""
    robot = Robot(shown)
    step = type(robot.controller.law).step

    def slow(*given: Any) -> Any:
        robot.clock.now += TIMEOUT_S + 0.1
        return step(*given)

    monkeypatch.setattr(type(robot.controller.law), "step", slow)
    for k in range(3):
        order = robot.hears(Message(k, k + 0.02))
        assert (
            order.stopped
            and not order.latched
            and order.reason == "the picture was answered after 0.6 s"
        )
        assert moves(robot.hears(Message(k + 0.5)))
        assert (
            robot.notes[-1]
            == "the picture was answered after 0.6 s; with `arrived` the robot is told to stop then"
        )


def sequences(rng: np.random.Generator) -> Iterator[tuple[Message, float]]:
    """Messages of a driver that does anything, each with the time since the last one [s]."""
    t, now = 0.0, 0.0
    for _ in range(60):
        after_s = float(rng.choice([0.001, 0.02, 0.04, 0.04, 0.04, 0.1, 0.3, 0.6, 2.0]))
        now += after_s
        right = float(rng.choice([now, now, now - 0.01, now - 0.3]))
        wrong = float(
            rng.choice([0.0, t, t, t - 0.04, t - 10.0, t + 1e-9, now + 5.0, 1e9, nan, inf, -inf])
        )
        stamp = right if rng.random() < 0.4 else wrong
        arrived = [None, now, now, stamp, 0.0, now - 1.0, nan][rng.integers(7)]
        yield Message(stamp, arrived, bool(rng.integers(2))), after_s
        if stamp > t and stamp < 1e6:
            t = stamp


def invariant(shown: Any, seeds: range) -> tuple[int, int]:
    """How many orders moved the robot, and how many stopped it;
    none may move it by an old picture.
    """
    counts = [0, 0]
    robot = Robot(shown, lost_after_s=None)
    for seed in seeds:
        robot.controller.reset()
        robot.began, robot.newest, robot.fresh_at = robot.clock.now, -inf, nan
        for message, after_s in sequences(np.random.default_rng(seed)):
            order = robot.hears(message, after_s)
            counts[not moves(order)] += 1
            assert not moves(order) or robot.age < TIMEOUT_S, (seed, message, robot.age)
    return counts[0], counts[1]


def test_no_velocity_by_an_old_picture_in_random_sequences(shown: Any) -> None:
    moved, stopped = invariant(shown, range(8))
    assert moved > 20 and stopped > 20


@pytest.mark.study
def test_no_velocity_by_an_old_picture_in_many_random_sequences(shown: Any) -> None:
    moved, stopped = invariant(shown, range(1000, 1500))
    assert moved > 1000 and stopped > 1000


def test_late_stamps_that_creep_are_counted_by_their_arrival(shown: Any) -> None:
    """By their stamps the target was never out of sight for long."""
    robot = Robot(shown)
    robot.hears(Message(0.0, 0.0))
    orders = [robot.hears(Message(1e-6 * k, robot.now + PERIOD_S)) for k in range(1, 40)]
    assert moves(orders[0]) and orders[-1].latched


class TestAFrozenCamera:
    """Fresh stamps, and the same bytes."""

    def test_is_told_while_a_velocity_is_ordered(self, shown: Any) -> None:
        robot = Robot(shown)
        told = []
        for k in range(40):
            order = robot.hears(Message(k * PERIOD_S, k * PERIOD_S + 0.01, new=False))
            assert moves(order)  # told, not ended
            told.append(FROZEN in robot.notes)
        # the first picture is compared with none, the second was taken before the robot moved
        assert 0.5 <= told.index(True) * PERIOD_S <= 0.62 and all(told[told.index(True) :])
        robot.hears(Message(40 * PERIOD_S, new=True))
        assert robot.notes == ()

    @pytest.mark.parametrize("buffers", one_quick(2, 3, 8))
    def test_that_repeats_its_buffers_in_turn_is_told_and_ends_the_task(
        self, shown: Any, buffers: int
    ) -> None:
        """A, B, A, B with fresh stamps was new for ever."""
        for more in ({}, {"frozen_after_s": 0.4}):
            robot = Robot(shown, **more)
            robot.dither = itertools.cycle(range(buffers))
            orders, told = [], []
            for k in range(40):
                orders.append(robot.hears(Message(k * PERIOD_S, new=True)))
                told.append(FROZEN in robot.notes)
            assert all(moves(order) for order in orders[:10])
            if more:
                assert orders[-1].latched and "the camera is frozen" in orders[-1].reason
            else:
                # the first of each buffer is new
                assert told.index(True) in range(12 + buffers, 15 + buffers)
                assert all(told[told.index(True) :])

    def test_that_repeats_more_pictures_than_buffers_or_each_twice_is_none(
        self, shown: Any
    ) -> None:
        robot = Robot(shown, frozen_after_s=0.4)
        robot.dither = itertools.chain(*([k, k] for k in range(40)))
        assert all(moves(robot.hears(Message(k * PERIOD_S))) for k in range(40))
        robot = Robot(shown, frozen_after_s=0.4)
        robot.dither = itertools.cycle(range(9))
        assert all(moves(robot.hears(Message(k * PERIOD_S))) for k in range(40))

    def test_is_counted_by_the_own_clock_where_stamps_creep(self, shown: Any) -> None:
        robot = Robot(shown, frozen_after_s=0.3)
        orders = [robot.hears(Message(1e-6 * k, new=False)) for k in range(12)]
        assert orders[-1].latched and "the camera is frozen" in orders[-1].reason

    @pytest.mark.parametrize("begin", [-1000.0, -5.0, 1.8e9])
    def test_is_told_whatever_the_stamps_begin_with(self, shown: Any, begin: float) -> None:
        robot = Robot(shown)
        notes = [
            FROZEN in (robot.hears(Message(begin + k * PERIOD_S, new=False)) and robot.notes)
            for k in range(20)
        ]
        assert notes.index(True) in (13, 14)  # as from 0 s on

    @pytest.mark.parametrize("told", [60.0, 1.8e9])
    def test_is_told_after_a_silence_of_another_time(self, shown: Any, told: float) -> None:
        """Who watches asked before the first picture had come, by another clock."""
        robot = Robot(shown)
        robot.controller.without_picture(told, robot.reading)
        notes = [
            FROZEN in (robot.hears(Message(k * PERIOD_S, new=False)) and robot.notes)
            for k in range(20)
        ]
        assert notes.index(True) in (13, 14)

    def test_is_told_after_a_pause_in_which_stamps_stood_still(self, shown: Any) -> None:
        """The silence was counted by the own clock, and stopped the robot at a time that the stamps
        reach much later.
        """
        robot = Robot(shown, lost_after_s=None)
        for k in range(5):
            robot.hears(Message(k * PERIOD_S))
        robot.clock.now += 10.0
        assert robot.controller.without_picture(4 * PERIOD_S, robot.reading).stopped
        notes = [
            FROZEN in (robot.hears(Message(k * PERIOD_S, new=False)) and robot.notes)
            for k in range(5, 25)
        ]
        assert notes.index(True) <= 14

    @pytest.mark.parametrize("latency_s", [0.02, 0.05])
    def test_is_counted_where_stamps_creep_and_commands_are_late(self, latency_s: float) -> None:
        """By its stamps no picture is of a time at which the robot moved."""
        scenario = vs.load(
            "arm_ibvs",
            SETTINGS | {"camera.latency_s": latency_s, "timing.command_latency_s": latency_s},
        )
        with vs.Session(scenario, pictures=True) as session:
            image = session.reset().image
            shown = scenario, np.array(image), session.episode.plant.reading()
        robot = Robot(shown, frozen_after_s=0.2)
        ended = [robot.hears(Message(1e-6 * k, new=False)).latched for k in range(12)]
        assert 0.2 <= ended.index(True) * PERIOD_S <= 0.2 + 2 * latency_s + 3 * PERIOD_S

    def test_that_writes_into_one_array_and_changes_is_none(self, shown: Any) -> None:
        """The picture before is not at hand any more: it must not be compared with itself."""
        scenario, image, reading = shown
        controller, buffer = vs.Controller(scenario), image.copy()
        for k in range(25):
            buffer[0, 0] = k
            assert controller.step(buffer, k * PERIOD_S, reading).notes == ()

    def test_of_a_robot_at_rest_is_none(self, shown: Any) -> None:
        """Nothing moves: pictures without noise are the same."""
        robot = Robot(shown)
        robot.image = np.zeros_like(robot.image)
        for k in range(30):
            assert (
                not moves(robot.hears(Message(k * PERIOD_S, new=False)))
                and FROZEN not in robot.notes
            )

    def test_ends_the_task_where_the_scenario_says_so(self, shown: Any) -> None:
        robot = Robot(shown, frozen_after_s=0.3)
        orders = [robot.hears(Message(k * PERIOD_S, new=False)) for k in range(20)]
        ended = next(k for k, order in enumerate(orders) if order.latched)
        assert 0.3 <= ended * PERIOD_S <= 0.42 and all(moves(order) for order in orders[:ended])
        words = (
            "the pictures were the same to the byte for 0.3 s, although a velocity was ordered:"
            " the camera is frozen"
        )
        assert orders[ended].stopped and orders[ended].reason == words
        assert robot.controller.supervisor.aborted == (Outcome.target_lost, words)
        assert robot.hears(Message(21 * PERIOD_S, new=True)).latched
        robot.controller.reset()
        assert moves(robot.hears(Message(0.0, new=False)))


@pytest.mark.parametrize("begin", [-1000.0, -0.3])
@pytest.mark.parametrize("silence", [None, 60.0])
def test_what_a_law_knows_of_its_own_motion_depends_on_no_begin_of_the_stamps(
    begin: float, silence: float | None
) -> None:
    """A law with feedforward is told how far the camera has gone since the exposure, which is by
    its commands here.
    """
    flies = {
        "robot": {
            "kind": "free",
            "start": {"nominal": {"xyz": [0.55, 0.05, 0.7], "rpy_deg": [0, 90, 0]}},
        }
    }
    scenario = vs.load("arm_track_circle", flies | {"camera.latency_s": 0.1, "detector": "blobs"})
    with vs.Session(scenario, pictures=True) as session:
        image, reading = session.reset().image, session.episode.plant.reading()
    assert image is not None

    def told(start: float, asked: float | None) -> list[np.ndarray]:
        controller, seen = vs.Controller(scenario), []
        observe = controller._perception.observe
        controller._perception.observe = lambda *given: seen.append(given[3]) or observe(*given)
        if asked is not None:
            controller.without_picture(asked, reading)
        for k in range(8):
            controller.step(image, start + k * PERIOD_S, reading)
        return [np.concatenate([own.twist, own.moved]) for own in seen if own is not None]

    right = told(0.0, None)
    assert len(right) == 8 and np.abs(right[-1]).max() > 1e-3
    # times of a thousand seconds end at 1e-13
    np.testing.assert_allclose(told(begin, silence), right, atol=1e-9)


@pytest.fixture
def stuck(own_kinds: None) -> None:
    """A camera that delivers the picture of .2 s for ever."""

    @vs.PERTURBATIONS.add
    @vs.spec
    class Stuck(vs.PerturbationBase):
        kind: Literal["stuck"] = "stuck"

        def begin(self, rng: np.random.Generator) -> list[np.ndarray]:
            return []

        def picture(
            self, state: list[np.ndarray], image: np.ndarray, t: float, rng: np.random.Generator
        ) -> np.ndarray:
            if t >= 0.2 and not state:
                state.append(image.copy())
            return state[0].copy() if state else image


STUCK = {"noise.perturb": [{"kind": "stuck"}], "stop.duration_s": 1.6}


@pytest.mark.usefixtures("stuck")
@pytest.mark.parametrize("name", one_quick("arm_ibvs", "omni_ibvs"))
def test_a_frozen_camera_ends_a_simulated_run_where_the_scenario_says_so(name: str) -> None:
    more = {"stop.frozen_after_s": 0.4, "camera.latency_s": 0.05, "timing.command_latency_s": 0.05}
    with_it = vs.run(vs.load(name, STUCK | more))
    assert (
        with_it.outcome is Outcome.target_lost
        and "the same to the byte for 0.4 s" in with_it.reason
    )
    stops = with_it["t"][with_it["supervisor"] == 2][0]
    # the camera stops at .2 s; the first picture that is the same comes a period later, a last one
    # half a period after the limit
    assert 0.6 <= stops <= 0.2 + 0.4 + 2 * 0.04 + 1e-9
    assert not with_it["applied_vx"][-1] and "frozen" in str(with_it.summary()["reason"])


def test_a_run_in_which_nothing_is_frozen_keeps_its_numbers() -> None:
    short = {"stop.duration_s": 0.8}
    without, with_it = (
        vs.run(vs.load("arm_ibvs", short | more)) for more in ({}, {"stop.frozen_after_s": 0.1})
    )
    np.testing.assert_array_equal(without.table, with_it.table)


@pytest.mark.study
@pytest.mark.usefixtures("stuck")
def test_a_craft_whose_camera_is_frozen_does_not_take_the_picture_for_its_target_seen_again() -> (
    None
):
    r = vs.run(
        vs.load("quadrotor_hover", STUCK | {"stop.frozen_after_s": 0.3, "stop.duration_s": 3.0})
    )
    assert r.outcome is Outcome.target_lost and "the same to the byte" in r.reason
    modes = r["supervisor"].tolist()
    assert 2 in modes and all(mode >= 2 for mode in modes[modes.index(2) :])
