"""Nodes that must stop: the law by the age of its last new picture, whatever stamps say; the robot
by the age of its commands.
"""

import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest

import vstestbed as vs
from tests.apps.ros.test_nodes import Wire, spun
from tests.loop.test_freshness import LOST_S, PERIOD_S, SETTINGS, TIMEOUT_S
from vstestbed.apps.ros import law, robot
from vstestbed.apps.ros import messages as m
from vstestbed.apps.ros.law import LawNode
from vstestbed.apps.ros.robot import RobotNode
from vstestbed.core.errors import ParameterError
from vstestbed.loop.controller import FROZEN

EPOCH = 1.8e9
"""The wall clock's time at the begin [s]."""


class Clocks:
    """What a node takes for the module `time`: both clocks of its machine, which go on where a test
    says so.
    """

    perf_counter, sleep = time.perf_counter, time.sleep

    def __init__(self):
        self.now, self.set_by = 5e5, 0.0

    def monotonic(self):
        return self.now

    def time(self):
        """By NTP it may be set."""
        return EPOCH + self.now - 5e5 + self.set_by


@pytest.fixture
def clocks(monkeypatch):
    made = Clocks()
    monkeypatch.setattr(law, "time", made)
    monkeypatch.setattr(robot, "time", made)
    monkeypatch.setattr(law, "WAIT_S", 0.0)  # readings come before their pictures, or not at all
    return made


@pytest.fixture(scope="module")
def shown():
    """A scenario, the picture of its start, and the reading there."""
    scenario = vs.load("arm_ibvs", SETTINGS)
    with vs.Session(scenario, pictures=True) as session:
        frame = session.reset()
        return scenario, frame.image.copy(), vs.Reading(frame.truth.q, np.zeros(6))


class Law:
    """A law's node whose turns a test takes, a picture at a time. joints: whether readings are told
    with the pictures' stamps.
    """

    def __init__(self, shown, clocks, **given):
        self.scenario, self.image, self.reading = shown
        self.clocks, self.wire, self.count = clocks, Wire("vstestbed_robot"), 0
        self.node = LawNode(self.scenario, Wire("vstestbed_law", self.wire), started=True, **given)
        self.node.servo.controller.clock = clocks.monotonic
        self.node._fresh = clocks.monotonic()

    def hears(self, stamp, after_s=PERIOD_S, new=True, joints=None):
        """Whether the robot is ordered to move after one more picture."""
        self.clocks.now += after_s
        self.tells(stamp if joints is None else joints)
        image = self.image.copy()
        self.count += new
        image[0, 0] = self.count % 251
        self.wire.publish("~/image_raw", m.image(stamp, image))
        self.node._turn()
        return self.moves

    def tells(self, stamp):
        """The joints."""
        for topic, message in m.readings(stamp, self.scenario.robot, self.reading).items():
            self.wire.publish(topic, message)

    @property
    def moves(self):
        sent = self.wire.twists()
        return bool(sent) and bool(sent[-1].any())

    @property
    def said(self):
        return [
            message.data
            for topic, message in self.wire.shared["said"]
            if topic == "/vstestbed_law/status"
        ]


WALL = {  # stamps of this machine's clock; now: since the begin, when five right pictures have come
    "frozen": lambda now: EPOCH + 0.2,
    "zero": lambda now: 0.0,
    "the last two in turn": lambda now: EPOCH + (0.2 if round(now / PERIOD_S) % 2 else 0.16),
    "backwards": lambda now: EPOCH + 0.4 - now,
    "far future": lambda now: EPOCH + 3000.0,
    "far future once, then right": lambda now: EPOCH + (3000.0 if now < 0.25 else 0.2),
    "the future, going on": lambda now: EPOCH + 60.0 + now,
    "the end of time": lambda now: 2.0**31 - 1,
    "an old queue": lambda now: EPOCH + 0.2 + 0.01 * (now - 0.2),
    "an old queue at once": lambda now: EPOCH + now - 60.0,
    "creeping": lambda now: EPOCH + 0.2 + 1e-6 * (now - 0.2),
}
OTHER = {  # of another clock, such as one since the camera was switched on
    "zero from the begin": lambda now: 0.0,
    "frozen": lambda now: 100.2,
    "the last two in turn": lambda now: 100.0 + (0.2 if round(now / PERIOD_S) % 2 else 0.16),
    "backwards": lambda now: 100.4 - now,
    "far future once, then frozen": lambda now: 1e6,
    "far future once, then right": lambda now: 1e6 if now < 0.25 else 100.0 + now,
    "creeping": lambda now: 100.2 + 1e-6 * (now - 0.2),
}
RUNS = [(EPOCH, name, pattern) for name, pattern in WALL.items()] + [
    (100.0, name, pattern) for name, pattern in OTHER.items()
]


@pytest.mark.parametrize(
    ("begin", "name", "pattern"), RUNS, ids=[f"{begin:g} {name}" for begin, name, _ in RUNS]
)
@pytest.mark.parametrize("after_s", [0.04, 0.011])
def test_whatever_stamps_say_the_law_stops_the_robot_and_stays_stopped(
    shown, clocks, begin, name, pattern, after_s
):
    law, begun = Law(shown, clocks), clocks.now
    first = [
        law.hears(0.0 if "from the begin" in name else begin + k * PERIOD_S) for k in range(1, 6)
    ]
    assert all(first)
    right_until = begun + PERIOD_S if "from the begin" in name else clocks.now
    # one stamp of the future is a new picture, where stamps are of another clock
    last = right_until + (PERIOD_S if "once" in name and begin == 100.0 else 0.0)
    while clocks.now < last + TIMEOUT_S + LOST_S + 3 * PERIOD_S:
        moves = law.hears(pattern(clocks.now - begun + after_s), after_s)
        assert not moves or clocks.now < last + TIMEOUT_S, (clocks.now - last, law.said)
    assert law.node._stopped, law.said
    for k in range(3):
        assert not law.hears(EPOCH + clocks.now - begun + 1e7 + k)  # nothing but `~/start` ends it
    assert law.node.start() == (True, "servoing")
    stamp = clocks.time() + PERIOD_S
    assert law.hears(stamp) and law.hears(stamp + PERIOD_S)


def test_lag_that_grows_stops_it_by_a_clock_of_whatever_begin(shown, clocks):
    """New pictures from a queue that fills: each is of a quarter of a period after the last."""
    law = Law(shown, clocks)
    moved = [law.hears(100.0 + k * PERIOD_S / 4) for k in range(1, 100)]
    lag_s = [0.75 * k * PERIOD_S for k in range(99)]
    latest_s = law.scenario.timing.latest_s(law.scenario.camera)
    assert all(m for m, s in zip(moved, lag_s, strict=True) if s < 0.9 * latest_s)
    assert not any(m for m, s in zip(moved, lag_s, strict=True) if s > latest_s + 1e-6)
    assert law.node._stopped and "late" in law.said[-1]


def test_a_first_picture_without_a_stamp_does_not_decide_which_clock_it_is(shown, clocks):
    law = Law(shown, clocks)
    law.hears(0.0)
    assert not any(law.hears(clocks.time() + PERIOD_S - 60.0) for _ in range(50))


def test_a_clock_of_somebody_else_does_not_let_a_slow_law_go_on(shown, clocks):
    law = Law(shown, clocks)
    law.wire.publish("/clock", m.clock(3.0))
    assert law.hears(EPOCH + PERIOD_S)
    assert not law.node._simulated


def test_a_driver_that_sends_each_picture_several_times_is_followed(shown, clocks):
    law = Law(shown, clocks)
    assert all(law.hears(EPOCH + k // 4 * PERIOD_S, PERIOD_S / 4) for k in range(4, 120))
    assert law.said[-1] == "servoing"


def test_the_status_says_why(shown, clocks):
    law = Law(shown, clocks)
    for stamp in (EPOCH + 0.04, *[EPOCH + 0.08] * 40):
        law.hears(stamp)
    again = "the picture of 0.04 s came again"
    assert law.said[:2] == ["servoing", f"stopped: no new picture for over 0.5 s: {again}"]
    assert (
        law.said[2].startswith(
            f"stopped: no picture arrived for 0.2 s; {again}; the picture is 0.7"
        )
        and len(law.said) == 3
    )
    law = Law(shown, clocks)
    law.hears(clocks.time() + 100.0)
    assert (
        law.said[-1] == "stopped: the picture's stamp is 100 s ahead of this machine's clock;"
        " set the clocks of both machines by NTP"
    )


@pytest.mark.parametrize("jump_s", [-100.0, -1.0, 1.0, 100.0, 1e6])
def test_a_clock_that_is_set_moves_nothing_for_longer(shown, clocks, jump_s):
    """The law's machine alone is set: stamps are far ahead or far behind.
    Then the camera stands.
    """
    law = Law(shown, clocks)
    for k in range(1, 6):
        assert law.hears(EPOCH + k * PERIOD_S)
    clocks.set_by = jump_s
    for k in range(6, 18):
        law.hears(EPOCH + k * PERIOD_S)
    since = clocks.now
    while clocks.now < since + TIMEOUT_S + LOST_S + PERIOD_S:
        assert not law.hears(EPOCH + 18 * PERIOD_S) or clocks.now < since + TIMEOUT_S
    assert law.node._stopped


def test_readings_that_stand_still_stop_it(shown, clocks):
    law = Law(shown, clocks)
    for k in range(1, 6):
        assert law.hears(EPOCH + k * PERIOD_S)
    since = clocks.now
    moved = [
        law.hears(EPOCH + k * PERIOD_S, joints=EPOCH + 0.2) and clocks.now - since
        for k in range(6, 40)
    ]
    # a reading may be so far from a picture
    assert max(moved) <= 1.5 * PERIOD_S and law.node._stopped
    assert any("are both stamped by one clock?" in words for words in law.said)


def test_no_turn_after_a_law_that_took_too_long_moves_it(shown, clocks, monkeypatch):
    law = Law(shown, clocks)
    step = law.node.servo.controller.law.step

    def slow(*given):
        clocks.now += TIMEOUT_S + 0.1
        return step(*given)

    monkeypatch.setattr(
        type(law.node.servo.controller.law), "step", lambda self, *given: slow(*given)
    )
    assert not any(law.hears(clocks.time() + PERIOD_S) for _ in range(5))
    assert any("the last one was answered after 0.6 s" in words for words in law.said)
    law.node._ticked(m.clock(3.0))  # time is simulated: it stands while the law is at work
    assert law.hears(EPOCH + 1000.0) or "ahead" in law.said[-1]


def test_a_picture_that_has_waited_is_old(shown, clocks):
    """It was heard while the law was at work, and then no other."""
    law = Law(shown, clocks)
    assert law.hears(100.0)
    law.tells(100.04)
    law.wire.publish("~/image_raw", m.image(100.04, law.image))
    clocks.now += TIMEOUT_S + 0.01
    law.node._turn()
    assert not law.moves


def test_pictures_that_do_not_change_are_told_in_the_status(shown, clocks):
    law = Law(shown, clocks)
    assert all(law.hears(EPOCH + k * PERIOD_S, new=False) for k in range(1, 30))
    assert law.said == ["servoing", f"servoing: {FROZEN}"]


def test_a_depth_picture_of_another_time_is_none(shown, clocks):
    scenario, *others = shown
    scenario = vs.load(
        "arm_ibvs", SETTINGS | {"camera.depth_sensor": "ideal", "law.depth": "sensor"}
    )
    law = Law((scenario, *others), clocks)
    deep = np.full(law.image.shape[:2], 0.5, np.float32)
    for k in range(1, 4):
        law.wire.publish("~/depth", m.depth_image(EPOCH + k * PERIOD_S, deep))
        assert law.hears(EPOCH + k * PERIOD_S)
    moved = [law.hears(EPOCH + k * PERIOD_S) for k in range(4, 30)]
    assert moved.index(False) * PERIOD_S <= TIMEOUT_S and not any(moved[moved.index(False) :])
    assert "depth is of" in law.said[-2]


def test_no_velocity_by_an_old_picture_in_random_sequences(shown, clocks):
    """Stamps, times between pictures, joints, starts and resets drawn by chance."""
    moved = 0
    for seed in range(6):
        rng, law = np.random.default_rng(seed), Law(shown, clocks)
        right = float(rng.choice([EPOCH, 100.0]))
        begun, newest, fresh_at = clocks.now, -np.inf, clocks.now
        for _ in range(60):
            after_s = float(rng.choice([0.001, 0.04, 0.04, 0.04, 0.3, 0.7]))
            now = clocks.now + after_s
            here = right + now - begun
            stamp = abs(
                float(
                    rng.choice(
                        [
                            here,
                            here,
                            here,
                            newest,
                            newest,
                            newest - 0.04,
                            0.0,
                            here - 9.0,
                            here + 9.0,
                            2e9,
                        ]
                    )
                )
            )
            stamp = stamp if np.isfinite(stamp) else 0.0
            if rng.random() < 0.1:
                newest = -np.inf if law.node._stopped else newest  # a new begin: any picture is new
                law.node.start()
            moves = law.hears(stamp, after_s)
            # one of the future is none
            if newest < stamp < (now - begun + right + TIMEOUT_S if right == EPOCH else np.inf):
                newest, fresh_at = stamp, now
            moved += moves
            assert not moves or clocks.now - fresh_at < TIMEOUT_S, (seed, stamp, law.said[-3:])
    assert moved > 20


def test_a_driver_whose_stamps_never_advance_stops_the_robot_in_real_time(shown):
    """As it was found: pictures at 25 Hz with zero stamps for two seconds gave 45 of 45 twists."""
    scenario, image, reading = shown
    wire = Wire("vstestbed_robot")
    node = LawNode(scenario, Wire("vstestbed_law", wire), watchdog_s=0.3, started=True)
    ended, thread = spun(node)

    def drives(seconds, until):
        end = time.monotonic() + seconds
        while time.monotonic() < end and not until():
            for topic, message in m.readings(0.0, scenario.robot, reading).items():
                wire.publish(topic, message)
            wire.publish("~/image_raw", m.image(0.0, image))
            time.sleep(0.02)

    began = time.monotonic()
    # it ends as soon as the node has stopped; a busy machine is slow
    drives(20.0, lambda: node._stopped)
    stopped_s, moved = time.monotonic() - began, len(wire.twists())
    drives(0.2, lambda: False)
    ended.set()
    thread.join(5)
    assert any(v.any() for v in wire.twists()[:moved]) and not np.any(wire.twists()[moved - 1 :])
    assert node._stopped.startswith("no picture arrived for 0.2 s") and 0.5 <= stopped_s < 15.0


def test_a_law_that_hangs_is_watched(shown, monkeypatch):
    """Its last twist was for a picture that is old by now: zero is sent from another thread."""
    scenario, image, reading = shown
    wire, go_on = Wire("vstestbed_robot"), threading.Event()
    node = LawNode(scenario, Wire("vstestbed_law", wire), watchdog_s=0.2, started=True)
    ended, thread = spun(node)
    step, calls = type(node.servo.controller.law).step, []

    def hangs(self, *given):
        calls.append(1)
        if len(calls) > 1:
            go_on.wait(5)
        return step(self, *given)

    monkeypatch.setattr(type(node.servo.controller.law), "step", hangs)
    for k in range(1, 3):
        stamp = time.time()
        for topic, message in m.readings(stamp, scenario.robot, reading).items():
            wire.publish(topic, message)
        wire.publish("~/image_raw", m.image(stamp, image))
        while len(calls) < k:
            time.sleep(0.005)
        time.sleep(0.05)
    assert wire.twists()[-1].any()
    time.sleep(0.4)
    assert not wire.twists()[-1].any()
    go_on.set()
    time.sleep(0.1)
    assert not wire.twists()[-1].any()
    ended.set()
    thread.join(5)
    assert "stopped: no new order for over 0.2 s" in [
        x.data for topic, x in wire.shared["said"] if topic == "/vstestbed_law/status"
    ]


@pytest.mark.parametrize("watchdog_s", [np.nan, np.inf, -1.0, 10.1, 1e6])
def test_a_watchdog_that_never_bites_is_refused(watchdog_s):
    scenario = vs.load("arm_ibvs")
    for made in (
        lambda: LawNode(scenario, Wire("a"), watchdog_s),
        lambda: RobotNode(scenario, Wire("b"), watchdog_s=watchdog_s),
    ):
        with pytest.raises(
            ParameterError,
            match="--watchdog must be between 0 and 10 s: for so long the last twist may stand",
        ):
            made()


@pytest.mark.parametrize("queue_s", [0.0, 3.0, 3600.0])
@pytest.mark.parametrize("again", ["start", "reset and start"])
def test_no_new_start_forgets_how_late_pictures_come(shown, clocks, queue_s, again):
    """Stamps are of another clock: what came soonest before the stop still tells. 0 s: the camera
    is as it was.
    """
    law, begun = Law(shown, clocks), clocks.now
    for k in range(1, 6):
        assert law.hears(100.0 + k * PERIOD_S)
    law.node.stop()
    law.hears(100.24)
    clocks.now += queue_s
    moved = []
    for _ in range(3):
        if again != "start":
            law.node.reset()
        law.node.start()
        moved += [law.hears(100.0 + clocks.now + PERIOD_S - begun - queue_s) for _ in range(30)]
    assert not any(moved) if queue_s else all(moved)


def test_a_frozen_picture_moves_nothing_at_a_new_start(shown, clocks):
    law = Law(shown, clocks)
    for k in range(1, 6):
        assert law.hears(100.0 + k * PERIOD_S)
    clocks.now += 3600.0
    for _ in range(5):
        law.node.start()
        assert not any(law.hears(100.2) for _ in range(30))


def test_a_camera_that_was_switched_on_again_is_followed_after_a_new_start(shown, clocks):
    law = Law(shown, clocks)
    for k in range(1, 6):
        assert law.hears(100.0 + k * PERIOD_S)
    moved = [law.hears(3.0 + k * PERIOD_S) for k in range(30)]
    assert not any(moved[14:]) and law.node._stopped
    law.node.start()
    assert all(law.hears(3.0 + k * PERIOD_S) for k in range(30, 60))


def test_a_camera_whose_clock_is_slower_is_followed_for_hours(shown, clocks):
    """Of quartz that is slow by 100 millionths, a picture a minute for 5 h; without a leak it ends
    after 1.4 h.
    """
    law, begun = Law(shown, clocks, watchdog_s=10.0), clocks.now
    latest_s, feed = law.scenario.timing.latest_s(law.scenario.camera), law.node.servo
    feed.began = 0.0
    ages = []
    for _ in range(300):
        clocks.now += 60.0
        stamp = (clocks.now - begun) * (1 - 1e-4)
        ages.append(feed._arrived_by(stamp, clocks.now) - stamp)
    assert max(ages) < 0.02 * latest_s
    clocks.now += 60.0
    stamp = (clocks.now - begun) * (1 - 1e-4) - 3.0  # a queue is told all the same
    assert feed._arrived_by(stamp, clocks.now) - stamp > 2.98


class TestAClockThatIsPublished:
    """`/clock` near to the camera's stamps, which says that time is simulated."""

    def ticks(self, law, t):
        law.wire.publish("/clock", m.clock(t))

    def test_and_stands_still_takes_no_check_away(self, shown, clocks):
        law = Law(shown, clocks)
        self.ticks(law, 100.1)
        for k in range(1, 6):
            law.hears(100.0 + k * PERIOD_S)
        moved = [law.hears(100.2 + 1e-3 * k) for k in range(1, 100)]
        latest_s = law.scenario.timing.latest_s(law.scenario.camera)
        assert not any(moved[int((TIMEOUT_S + latest_s) / PERIOD_S) + 1 :]) and law.node._stopped

    def test_and_stands_still_lets_no_slow_law_go_on(self, shown, clocks, monkeypatch):
        law = Law(shown, clocks)
        self.ticks(law, 100.1)
        for k in range(1, 20):
            law.hears(100.0 + k * PERIOD_S)
        step = type(law.node.servo.controller.law).step

        def slow(self, *given):
            clocks.now += 10.0
            return step(self, *given)

        monkeypatch.setattr(type(law.node.servo.controller.law), "step", slow)
        assert not any(law.hears(101.0 + k * PERIOD_S) for k in range(5))

    def test_and_runs_tells_how_old_pictures_are(self, shown, clocks):
        """A queue that grows."""
        law, moved = Law(shown, clocks), []
        for k in range(1, 200):
            now, lag_s = 100.0 + k * PERIOD_S, 0.03 * k
            self.ticks(law, now)
            moved.append((law.hears(now - lag_s), lag_s))
        latest_s = law.scenario.timing.latest_s(law.scenario.camera)
        assert all(moves == (lag_s <= latest_s) for moves, lag_s in moved) and law.node._simulated

    def test_and_stands_still_until_the_first_twist_is_of_a_robot_that_waits(
        self, shown, clocks, monkeypatch
    ):
        """In lockstep, long before `~/start`: the law may take its time for the first
        picture, too.
        """
        law = Law(shown, clocks)
        self.ticks(law, 0.04)
        clocks.now += 100.0
        step = type(law.node.servo.controller.law).step

        def slow(self, *given):
            clocks.now += 10.0
            return step(self, *given)

        monkeypatch.setattr(type(law.node.servo.controller.law), "step", slow)
        assert law.hears(0.04)

    @pytest.mark.parametrize("took_s", [0.02, 0.2, 1.0])
    def test_and_waits_for_the_law_counts_how_long_the_target_is_out_of_sight(
        self, shown, clocks, monkeypatch, took_s
    ):
        """In lockstep, for .4 s of 1 s; by the own clock the target would be lost."""
        scenario = vs.load("arm_ibvs", SETTINGS | {"stop.lost_after_s": 1.0})
        law, good = Law((scenario, *shown[1:]), clocks), shown[1]
        self.works_for(law, monkeypatch, lambda: took_s)
        moved = []
        for k in range(1, 50):
            self.ticks(law, 50.0 + k * PERIOD_S)
            law.image = np.full_like(good, 90) if 20 <= k < 30 else good
            moved.append(law.hears(50.0 + k * PERIOD_S, 0.01))
        assert sum(moved) == 39 and moved[-1] and not law.node._stopped

    def works_for(self, law, monkeypatch, took_s, meanwhile=lambda: None):
        """A law that takes so long for a picture [s]."""
        step = type(law.node.servo.controller.law).step

        def slow(self, *given):
            law.clocks.now += took_s()
            meanwhile()
            return step(self, *given)

        monkeypatch.setattr(type(law.node.servo.controller.law), "step", slow)

    @pytest.mark.parametrize("took_s", [0.6, 3.0])
    def test_and_waits_is_answered_at_once_where_a_slow_first_picture_was_told_again(
        self, shown, clocks, monkeypatch, took_s
    ):
        """The robot tells it again while the law is at work; the copy is answered by the order in
        force.
        """
        law, took = Law(shown, clocks), iter([took_s])
        self.works_for(law, monkeypatch, lambda: next(took, 0.01))
        self.ticks(law, 50.04)
        assert law.hears(50.04)
        first = law.wire.twists()[-1]
        self.ticks(law, 50.04)
        assert law.hears(50.04, 0.001, new=False)
        np.testing.assert_array_equal(law.wire.twists()[-1], first)
        for k in range(2, 10):
            self.ticks(law, 50.0 + k * PERIOD_S)
            assert law.hears(50.0 + k * PERIOD_S)

    @pytest.mark.parametrize("late_s", [3.0, 11.0, 60.0])
    @pytest.mark.parametrize("again", ["nothing", "start", "reset and start"])
    def test_and_has_run_tells_of_a_queue_of_whatever_age(self, shown, clocks, late_s, again):
        """After a break; so late, stamps might be taken for those of another clock."""
        law, begun = Law(shown, clocks), clocks.now

        def hears(late_s):
            now = 100.0 + clocks.now + PERIOD_S - begun
            self.ticks(law, now)
            return law.hears(now - late_s)

        assert all(hears(0.0) for _ in range(10))
        clocks.now += late_s
        if again != "nothing":
            law.node.stop()
            law.node._turn()
        if again == "reset and start":
            law.node.reset()
        law.node.start()
        assert not any(hears(late_s) for _ in range(20)) and "late" in law.said[-1]

    def test_and_ends_hands_over_to_the_own_clock(self, shown, clocks):
        """What comes with it is followed, and a queue is late."""
        law, begun = Law(shown, clocks), clocks.now
        for k in range(1, 60):
            if k < 10:
                self.ticks(law, 100.0 + k * PERIOD_S)
            assert law.hears(100.0 + k * PERIOD_S)
        clocks.now += 3.0
        assert not any(law.hears(100.0 + clocks.now + PERIOD_S - begun - 3.0) for _ in range(20))

    def test_and_is_far_behind_a_stamp_refuses_it(self, shown, clocks):
        law = Law(shown, clocks)
        for k in range(1, 6):
            self.ticks(law, 100.0 + k * PERIOD_S)
            assert law.hears(100.0 + k * PERIOD_S)
        self.ticks(law, 100.24)
        assert (
            not law.hears(160.24)
            and law.said[-1] == "stopped: the picture's stamp is 60 s ahead of /clock"
        )

    def test_and_runs_on_stops_a_law_that_takes_too_long(self, shown, clocks, monkeypatch):
        law = Law(shown, clocks)
        for k in range(1, 6):
            self.ticks(law, 100.0 + k * PERIOD_S)
            assert law.hears(100.0 + k * PERIOD_S)
        begun = clocks.now - 0.2
        self.works_for(
            law,
            monkeypatch,
            lambda: TIMEOUT_S + 0.1,
            lambda: self.ticks(law, 100.0 + clocks.now - begun),
        )
        for _ in range(5):
            self.ticks(law, 100.0 + clocks.now + PERIOD_S - begun)
            assert not law.hears(100.0 + clocks.now + PERIOD_S - begun)
        assert any("the last one was answered after 0.6 s" in words for words in law.said)

    def test_and_runs_on_while_the_law_hangs_is_watched(self, shown, clocks):
        """As the second thread asks it."""
        law = Law(shown, clocks)
        for k in range(1, 6):
            self.ticks(law, 100.0 + k * PERIOD_S)
            assert law.hears(100.0 + k * PERIOD_S)
        clocks.now += 10.0
        # it stands: in lockstep the law has time
        assert law.node._since(*law.node._order_of) == 0.0
        self.ticks(law, 100.2 + TIMEOUT_S)
        assert law.node._since(*law.node._order_of) == pytest.approx(TIMEOUT_S)

    def test_and_goes_to_and_fro_stands_still(self, shown, clocks):
        """Two values in turn are no time that goes on."""
        law = Law(shown, clocks)
        for k in range(1, 6):
            self.ticks(law, 100.0 + k * PERIOD_S)
            assert law.hears(100.0 + k * PERIOD_S)
        moved = []
        for k in range(1, 100):
            self.ticks(law, 100.2 + 0.001 * (k % 2))
            moved.append(law.hears(100.2 + 1e-3 * k))
        latest_s = law.scenario.timing.latest_s(law.scenario.camera)
        assert not any(moved[int((TIMEOUT_S + latest_s) / PERIOD_S) + 1 :]) and law.node._stopped

    def test_and_begins_anew_is_followed_after_a_new_start(self, shown, clocks):
        law = Law(shown, clocks)
        for _ in range(3):
            for k in range(1, 20):
                self.ticks(law, k * PERIOD_S)
                assert law.hears(k * PERIOD_S, 0.2)
            law.node.reset()
            law.node.start()


@pytest.mark.parametrize("ahead_s", [1.0, 3.0, 6.0])
def test_one_stamp_ahead_is_forgotten_with_its_task(shown, clocks, ahead_s):
    law, begun = Law(shown, clocks), clocks.now
    for k in range(1, 20):
        assert law.hears(100.0 + k * PERIOD_S)
    law.hears(100.0 + clocks.now + PERIOD_S - begun + ahead_s)
    for _ in range(40):
        law.hears(100.0 + clocks.now + PERIOD_S - begun)
    assert law.node._stopped
    law.node.start()
    assert all(law.hears(100.0 + clocks.now + PERIOD_S - begun) for _ in range(30))


def test_what_the_status_says_of_a_camera_whose_clock_was_set(shown, clocks):
    law, begun = Law(shown, clocks), clocks.now
    for k in range(1, 6):
        law.hears(100.0 + k * PERIOD_S)
    for _ in range(20):
        law.hears(97.0 + clocks.now - begun)
    law.node.start()
    law.hears(97.0 + clocks.now - begun)
    assert law.said[-1].endswith(
        "by the node's own clock; if the camera's was set or started anew, start this node anew"
    )


def test_a_zero_stamp_begins_nothing(shown, clocks):
    """First after a new start, before pictures that have waited for 3 s."""
    law, begun = Law(shown, clocks), clocks.now
    for k in range(1, 20):
        assert law.hears(100.0 + k * PERIOD_S)
    law.node.stop()
    clocks.now += 3.0
    law.node.start()
    moved = [law.hears(0.0)] + [
        law.hears(100.0 + clocks.now + PERIOD_S - begun - 3.0) for _ in range(30)
    ]
    assert not any(moved)


def test_stamps_of_this_machine_stay_so_over_a_new_start(shown, clocks):
    law, begun = Law(shown, clocks), clocks.now
    for k in range(1, 20):
        assert law.hears(EPOCH + k * PERIOD_S)
    law.node.stop()
    clocks.now += 3700.0
    law.node.start()
    assert not any(law.hears(EPOCH + clocks.now + PERIOD_S - begun - 3650.0) for _ in range(20))


def test_no_reading_of_the_former_run_is_one_of_this(shown, clocks):
    """The robot begins anew with other joints, at the same times of its simulation; what was heard
    while it was stopped is past, too.
    """
    law = Law(shown, clocks)
    former = law.reading.q.copy()

    def runs(pictures):
        for k in range(1, pictures):
            law.wire.publish("/clock", m.clock(k * PERIOD_S))
            yield law.hears(k * PERIOD_S)

    assert all(runs(26))
    law.node.reset()
    law.tells(0.5)
    law.node._turn()
    law.node.start()
    law.reading = vs.Reading(former + 0.2, np.zeros(6))
    for k, moves in enumerate(runs(10), 1):
        np.testing.assert_array_equal(law.node.servo.senses.at(k * PERIOD_S).q, law.reading.q)
        np.testing.assert_array_equal(law.node.servo.senses.at().q, law.reading.q)
        assert moves
    law.reading = vs.Reading(former + 0.3, np.zeros(6))
    law.tells(9 * PERIOD_S)  # told again: the newer message counts
    np.testing.assert_array_equal(law.node.servo.senses.at().q, law.reading.q)


class TestACraft:
    """It cannot stop in the air: where others stop, it holds, and then sinks."""

    @pytest.fixture
    def craft(self, clocks):
        scenario = vs.load("quadrotor_perspective", {"detector": "blobs"})
        with vs.Session(scenario, pictures=True) as session:
            frame = session.reset()
            law = Law((scenario, frame.image.copy(), session.episode.plant.reading()), clocks)
        for k in range(1, 6):
            assert law.hears(EPOCH + k * PERIOD_S)
        return law

    def sinks(self, law):
        """Whether the last twist is downwards, in the body's frame."""
        v = law.wire.twists()[-1]
        return bool(v[2] < -0.1) and not v[3:].any()

    def test_sinks_without_pictures_until_it_sees_its_target_again(self, craft, clocks):
        lost_s = craft.scenario.stop.lost_after[0]
        held = [craft.hears(EPOCH + 0.2) for _ in range(int((TIMEOUT_S + lost_s) / PERIOD_S) - 2)]
        assert not any(held[14:])
        for _ in range(40):
            craft.hears(EPOCH + 0.2)
        assert (
            all(craft.hears(EPOCH + 0.2) and self.sinks(craft) for _ in range(20))
            and not craft.node._stopped
        )
        assert "the craft sinks; no new picture for over 0.5 s" in craft.said[-1]
        assert craft.hears(clocks.time() + PERIOD_S) and craft.said[-1] == "servoing"
        craft.node.stop()
        assert not craft.moves  # a person's stop holds it

    def test_sinks_where_its_law_has_failed(self, craft, clocks, monkeypatch):
        monkeypatch.setattr(type(craft.node.servo.controller.law), "step", lambda *given: 1 / 0)
        for _ in range(100):
            craft.hears(clocks.time() + PERIOD_S)
        assert (
            self.sinks(craft)
            and "ZeroDivisionError" in craft.said[-1]
            and "sinks" in craft.said[-1]
        )


# The robot's side.


class Commanded:
    """A robot's node at the pace of the clock, which is not flown: what it would obey when the next
    picture is due.
    """

    def __init__(self, clocks, pace="wall"):
        self.clocks, self.wire = clocks, Wire("vstestbed_robot")
        self.node = RobotNode(vs.load("arm_ibvs", {"detector": "oracle"}), self.wire, pace)

    def obeys(self, stamp, v=0.1, after_s=PERIOD_S, frame="camera_optical_frame"):
        """The twist that it obeys after one more command;
        v: a twist, or what all its numbers are.
        """
        self.clocks.now += after_s
        self.wire.publish(
            "/servo_node/delta_twist_cmds",
            m.twist(stamp, np.broadcast_to(np.asarray(v, float), 6), frame),
        )
        return self.now

    @property
    def now(self):
        v = self.node._by_the_clock(0.0)
        return None if v is None else v.tolist()

    @property
    def said(self):
        return [
            message.data
            for topic, message in self.wire.shared["said"]
            if topic == "/vstestbed_robot/status"
        ]


@pytest.mark.parametrize("skew_s", [-3600.0, -60.0, -0.51, 0.51, 60.0, 3600.0, 3e8])
def test_commands_of_another_time_are_dropped_and_the_clocks_named(clocks, skew_s):
    one = Commanded(clocks)
    assert [one.obeys(clocks.time() + PERIOD_S + skew_s) for _ in range(5)] == [None] * 5
    side = "behind" if skew_s < 0 else "ahead of"
    words = (
        f"the commands' stamps are {abs(skew_s):.3g} s {side} this clock: they are dropped;"
        " set the clocks of both machines by NTP"
    )
    assert one.node.dropped == 5 and one.said == [words] and one.node.refused == words


def test_commands_in_time_and_those_without_a_stamp_are_obeyed(clocks):
    for stamp in (
        lambda: clocks.time() + PERIOD_S,
        lambda: clocks.time() - 0.3,
        lambda: clocks.time() + 0.4,
        lambda: 0.0,
    ):
        one = Commanded(clocks)
        assert (
            all(one.obeys(stamp()) == [0.1] * 6 for _ in range(10))
            and not one.node.dropped
            and not one.said
        )


def test_without_a_further_command_it_rests_by_its_own_clock(clocks):
    """As long as a command lasts, from when it was given; whatever the wall clock is set to."""
    for late_s, jump_s in ((0.0, 0.0), (0.3, 0.0), (0.0, -1e4), (0.0, 1e4), (-0.4, 0.0)):
        one, clocks.set_by = Commanded(clocks), 0.0
        assert one.obeys(clocks.time() + PERIOD_S - late_s)
        clocks.set_by = jump_s
        clocks.now += TIMEOUT_S - max(late_s, 0.0) - 0.01
        assert one.now
        clocks.now += 0.02
        assert one.now is None


def test_one_command_sent_again_and_again_ends(clocks):
    one, stamp = Commanded(clocks), clocks.time()
    obeyed = [one.obeys(stamp, after_s=0.001) is not None for _ in range(2000)]
    assert sum(obeyed) == pytest.approx(500, abs=2) and not any(obeyed[502:])


def test_a_rest_is_obeyed_whenever_it_was_ordered(clocks):
    for skew_s in (-60.0, 60.0):
        one = Commanded(clocks)
        assert one.obeys(clocks.time() + PERIOD_S)
        assert not any(one.obeys(clocks.time() + skew_s, 0.0) or [])


@pytest.mark.parametrize(
    "v", [np.nan, np.inf, -np.inf, 1e308, -1e308, 1.1e6, [1e308, -1e308, 0, 0, 0, 0]]
)
@pytest.mark.parametrize("frame", ["camera_optical_frame", "flange", ""])
def test_numbers_that_are_none_never_reach_the_robot(clocks, v, frame):
    for pace in ("wall", "lockstep"):
        one = Commanded(clocks, pace)
        assert one.obeys(clocks.time() + PERIOD_S, v, frame=frame) is None
        assert one.node._command is None and one.said[0].startswith("twist must be")


def test_in_lockstep_stamps_are_simulated(clocks):
    one = Commanded(clocks, "lockstep")
    one.obeys(3.0)
    assert one.node._in_step().tolist() == [0.1] * 6 and not one.node.dropped


def test_a_picture_is_told_again_before_the_law_takes_it_for_silence():
    """In lockstep the first command may be lost; the same picture again must be answered by the
    same twist.
    """
    scenario = vs.load("arm_ibvs", {"detector": "oracle", "stop.duration_s": 0.2})
    wire, told = Wire("vstestbed_robot"), []
    node = RobotNode(scenario, wire)

    def heard(message):
        told.append(time.monotonic())
        if len(told) > 1:
            node.ended.set()

    wire.subscribe("~/image_raw", m.IMAGE, heard)
    node.fly(scenario.resolved)
    assert told[1] - told[0] < 0.9 * scenario.timing.order_s(scenario.camera)


def test_in_lockstep_a_lost_first_command_changes_no_number():
    """Nobody has heard the first answer; the picture is told again,
    and answered by the same twist.
    """
    # a busy machine is slow
    scenario = vs.load("arm_ibvs", {"stop.duration_s": 0.2, "timing.command_timeout_s": 4.0})
    wire, lost = Wire("vstestbed_robot"), []
    law_wire = Wire("vstestbed_law", wire)
    publish = law_wire.publish

    def loses_the_first(topic, message, now=0.0):
        if message.__msgtype__ == m.TWIST and not lost:
            lost.append(message)
        else:
            publish(topic, message, now)

    law_wire.publish = loses_the_first
    ended, thread = spun(LawNode(scenario, law_wire, started=True))
    node = RobotNode(scenario, wire)
    node.watchdog_s = 1.0  # it is told again after half of it
    mine = node.fly(scenario.resolved).rows.frame()
    ended.set()
    thread.join(5)
    theirs = vs.run(scenario, pictures=True).rows.frame()
    assert lost and len(mine) == len(theirs)
    for column in ("applied_vx", "applied_wz", "cam_x"):
        np.testing.assert_allclose(
            mine[column].to_numpy()[:-1], theirs[column].to_numpy()[:-1], atol=1e-9, err_msg=column
        )


def test_a_real_clock_and_a_robot_that_moves_by_it():
    """Old twists leave it at rest, right ones move it, and it rests when they end."""
    given = {
        "detector": "oracle",
        "stop.duration_s": 1.2,
        "stop.rest_after_s": None,
        "timing.command_timeout_s": 0.2,
    }
    scenario = vs.load("arm_ibvs", given)
    wire, speeds = Wire("vstestbed_robot"), []
    node = RobotNode(scenario, wire, "wall")

    def commands(message):
        t = len(speeds) * PERIOD_S
        if t < 0.8:
            wire.publish(
                "/servo_node/delta_twist_cmds",
                m.twist(time.time() - (60.0 if t < 0.4 else 0.0), np.full(6, 0.05), "flange"),
            )

    wire.subscribe("~/image_raw", m.IMAGE, commands)
    watch = SimpleNamespace(frame=lambda frame: speeds.append(float(np.abs(frame.truth.qd).max())))
    node.fly(scenario.resolved, [watch])
    assert (
        max(speeds[:10]) < 1e-3 < 0.02 < max(speeds[12:20])
        and speeds[-1] < 2e-3
        and node.dropped >= 8
    )


# a twist, a rest, and a twist that was sent before the rest and comes after it: stamps, each by the
# clock at its coming
RESTS = {
    "without a stamp": (0.0, None, -0.02),
    "of long ago": (0.0, -60.0, -0.02),
    "somewhat late": (0.0, -0.3, -0.02),
    "of the future": (0.0, 60.0, -0.02),
    "after one that was ahead": (0.4, 0.0, 0.1),
}


@pytest.mark.parametrize("rest", RESTS)
def test_whatever_the_stamp_of_a_rest_no_twist_of_before_it_is_obeyed_and_later_ones_are(
    clocks, rest
):
    one = Commanded(clocks)
    moved = []
    for v, ahead_s, after_s in zip(
        (0.1, 0.0, 0.1), RESTS[rest], (PERIOD_S, PERIOD_S, 0.0), strict=True
    ):
        stamp = 0.0 if ahead_s is None else clocks.time() + after_s + ahead_s
        moved.append(any(one.obeys(stamp, v, after_s) or []))
    assert moved == [True, False, False] and one.node.dropped == 1
    clocks.now += max(RESTS[rest][0] - PERIOD_S, 0.0)  # of one that was ahead, the next is later
    assert all(any(one.obeys(clocks.time() + PERIOD_S)) for _ in range(5))


@pytest.mark.parametrize("skew_s", [-0.45, -0.1, 0.0, 0.3])
def test_after_a_rest_right_commands_are_obeyed_whatever_the_skew(clocks, skew_s):
    one = Commanded(clocks)
    for k in range(40):
        obeyed = one.obeys(clocks.time() + PERIOD_S + skew_s, 0.0 if k % 5 == 4 else 0.1)
        assert any(obeyed) == (k % 5 != 4), k
    one.node.stop()
    one.node.start()
    assert any(one.obeys(clocks.time() + PERIOD_S + skew_s)) and not one.node.dropped


def test_a_skew_that_drops_commands_is_named(clocks):
    """It is not known yet: the robot was started before the first command."""
    one = Commanded(clocks)
    one.node.start()
    assert one.obeys(clocks.time() + PERIOD_S - 0.3) is None
    words = (
        "all stamps were 0.3 s or more behind this clock; set the clocks of both machines by NTP"
    )
    assert one.said[-1].endswith(words)


def test_what_is_heard_while_it_is_stopped_moves_nothing_afterwards(clocks):
    one = Commanded(clocks)
    before = clocks.time()
    assert one.obeys(before + PERIOD_S)
    one.node.stop()
    assert one.obeys(clocks.time() + PERIOD_S) is None
    late = clocks.time()
    one.node.start()
    assert one.now is None
    clocks.now += PERIOD_S
    assert one.obeys(late - 0.01, after_s=0.0) is None  # sent before the start
    assert any(one.obeys(clocks.time() + PERIOD_S))


def test_one_command_again_and_again_renews_nothing_whatever_the_clock_is_set_to(clocks):
    """The machine's clock stands still, so that the stamp never grows old."""
    one, stamp, began = Commanded(clocks), clocks.time(), clocks.now
    obeyed = []
    for _ in range(100):
        clocks.set_by = began - clocks.now - PERIOD_S
        obeyed.append(one.obeys(stamp) is not None)
    assert obeyed[0] and not any(obeyed[14:])


def test_a_clock_that_is_set_back_does_not_end_the_commands(clocks):
    one = Commanded(clocks)
    assert one.obeys(clocks.time() + PERIOD_S) and not any(one.obeys(clocks.time() + PERIOD_S, 0.0))
    clocks.set_by = -100.0
    assert all(any(one.obeys(clocks.time() + PERIOD_S)) for _ in range(5)) and not one.node.dropped


def test_a_command_that_was_sent_before_a_stop_and_comes_after_it_is_dropped(shown, clocks):
    scenario, _, _ = shown
    node = RobotNode(scenario, Wire("vstestbed_robot"), pace="wall")
    frame = law.command_frame(scenario)
    for stamp, v, moves in (
        (0.10, 0.1, True),
        (0.20, 0.0, False),
        (0.15, 0.1, False),
        (0.25, 0.1, True),
    ):
        clocks.now = 5e5 + max(0.2, stamp)
        node._hear(m.twist(EPOCH + stamp, v * np.ones(6), frame))
        assert bool(node._command[1].any()) == moves, stamp
    assert node.dropped == 1 and "older than the one in force" in node.refused
