"""One order a cycle: in every way to be stopped, twist, setpoint and order agree, and a latched
stop ends by `reset` alone.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError, SessionError
from vstestbed.core.geometry import inverse
from vstestbed.core.outcome import Outcome
from vstestbed.loop.ego_motion import Exposure
from vstestbed.robots import Allocation, Mount
from vstestbed.robots.allocation import Order
from vstestbed.robots.arm import Arm
from vstestbed.robots.flight import HOLD_S, FlightEstimate, FlightReading
from vstestbed.vision.base import TruthView

ROBOTS = ("arm_ibvs", "arm_panda", "omni_ibvs", "car_pbvs", "quadrotor_hover", "ibvs_book")
"""A Puma, an arm by its MJCF file, the vehicles, the craft, the camera without mass."""
STOPPED = tuple(name for name in ROBOTS if not name.startswith("quadrotor"))
"""Robots that are safe at rest."""
STILL = np.zeros(3)
Shown = tuple[vs.Scenario, np.ndarray, vs.Reading]


class Rig:
    """A controller whose robot stands at its start, with markers that are shown to it or hidden."""

    def __init__(self, name: str, changes: dict[str, object] | None = None):
        self.scenario = s = vs.load(
            name, {"detector": {"kind": "oracle"}, "stop.lost_after_s": 0.5} | (changes or {})
        )
        self.controller = vs.Controller(s)
        self.q = s.robot.start_joints()
        T = s.robot.flange_pose(s.robot.configuration()) @ s.camera.mount.T
        self.p = s.target.seen_from(inverse(s.target.pose.T) @ T)
        self.frame = -1

    @property
    def period(self) -> float:
        """Time between pictures [s]."""
        return self.scenario.camera.period

    def reading(self, **craft: Any) -> vs.Reading:
        """At rest at its start; craft: what its flight loops estimate."""
        if self.scenario.robot.base != "floating":
            return vs.Reading(self.q, np.zeros(len(self.q)))
        estimate = {"rotor_limit_s": 0.0, "overturned": False, "stands": False} | craft
        made = FlightEstimate(
            velocity=STILL, rates=STILL, ref_tilt=np.zeros(2), ref_rates=STILL, **estimate
        )
        return FlightReading(np.zeros(0), np.zeros(0), tilt=np.zeros(2), range_m=2.0, estimate=made)

    def sees(self, there: bool = True, late_s: float = 0.0, **craft: Any) -> vs.Cycle:
        """The cycle of the next picture."""
        self.frame += 1
        t, reading = self.frame * self.period, self.reading(**craft)
        view = TruthView(self.p, np.full(len(self.p), not there))
        arrived = t + self.scenario.camera.latency_s + late_s
        cycle = self.controller.arrive(
            Exposure(self.frame, t, None, reading, view), arrived, arrived, reading
        )
        self.agrees(cycle.order)
        assert (cycle.twist is cycle.order.twist, cycle.setpoint is cycle.order.setpoint) == (
            True,
            True,
        )
        return cycle

    def silent(self, seconds: float) -> Order:
        """The order after no picture has come for so long."""
        self.frame += round(seconds / self.period)
        order = self.controller.without_picture(self.frame * self.period, self.reading())
        self.agrees(order)
        return order

    def agrees(self, order: Order) -> None:
        """Twist and setpoint are those of one motion, and those of a stop are rest."""
        assert np.isfinite(order.setpoint).all() and np.isfinite(order.twist).all()
        if order.stopped:
            # its steering stays as it was
            moving = order.setpoint[:1] if self.scenario.robot.kind == "car" else order.setpoint
            assert not moving.any() and not order.twist.any() and order.reason
            return
        mount = Mount.of(self.scenario.believed_camera.mount.T)
        if isinstance(self.scenario.robot, Arm):
            made = mount.to_camera @ self.scenario.robot.kinematics(self.q)[1] @ order.setpoint
            np.testing.assert_allclose(made, order.twist, atol=1e-9)
            return
        again = self.scenario.robot.allocate(order.twist, self.reading(), mount, self.period)
        np.testing.assert_allclose(again.setpoint, order.setpoint, atol=1e-9)


@pytest.fixture(params=ROBOTS)
def rig(request: pytest.FixtureRequest) -> Rig:
    return Rig(request.param)


@pytest.fixture(params=STOPPED)
def grounded(request: pytest.FixtureRequest) -> Rig:
    return Rig(request.param)


def moves(cycle: vs.Cycle) -> bool:
    """Whether it orders a velocity of the law's, within limits that alone are its reason."""
    limited_alone = bool(cycle.reason) == bool(cycle.allocation.limit)
    return not cycle.stopped and not cycle.latched and limited_alone and bool(cycle.twist.any())


def test_what_is_seen_moves_it(rig: Rig) -> None:
    assert all(moves(rig.sees()) for _ in range(3))


def test_out_of_sight_for_a_moment(grounded: Rig) -> None:
    rig = grounded
    assert moves(rig.sees())
    blind = rig.sees(False)
    if blind.command.twist.any():  # a law that drives on by what it knew
        assert not blind.stopped
        return
    assert blind.stopped and not blind.latched and "in sight" in blind.reason
    assert moves(rig.sees())  # such a stop ends with its cause


def test_out_of_sight_for_too_long(grounded: Rig) -> None:
    rig = grounded
    rig.sees()
    while not (lost := rig.sees(False)).latched:
        assert rig.frame * rig.period < 5.0
    assert lost.stopped and rig.controller.supervisor.aborted is not None
    assert lost.reason == rig.controller.supervisor.aborted[1]
    for _ in range(50):  # back in sight: the law would move, and the robot must not
        back = rig.sees()
        assert (
            back.command.twist.any()
            and back.stopped
            and back.latched
            and back.reason == lost.reason
        )
    rig.controller.reset()
    assert moves(rig.sees())


def test_a_craft_that_lost_its_target_sinks_and_says_so() -> None:
    rig = Rig("quadrotor_hover")
    rig.sees()
    orders = [rig.sees(False) for _ in range(40)]
    held, sinks = orders[0], orders[-1]
    assert held.stopped and not held.latched and "in sight" in held.reason
    assert (
        not sinks.stopped and not sinks.latched and sinks.setpoint.tolist() == [0.0, 0.0, -0.4, 0.0]
    )
    assert sinks.twist.any() and sinks.reason.endswith(": the craft sinks")
    assert moves(rig.sees())  # seen again, while it is high enough


def test_a_law_that_fails(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig.sees()
    with monkeypatch.context() as patch:
        patch.setattr(type(rig.scenario.law), "step", lambda *given: 1 / 0)
        failed = rig.sees()
    assert failed.stopped and failed.latched and "raised ZeroDivisionError" in failed.reason
    assert rig.sees().latched  # although it would work again
    rig.controller.reset()
    assert moves(rig.sees()) and rig.controller.failure == ""


def test_a_robot_whose_allocation_is_not_finite(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    rig.sees()
    n = len(rig.sees().setpoint)
    with monkeypatch.context() as patch:
        for method in ("allocate", "allocate_rates"):  # only an arm has the latter
            patch.setattr(
                type(rig.scenario.robot),
                method,
                raising=False,
                value=lambda *given: Allocation(np.full(n, np.nan), np.zeros(6)),
            )
        failed = rig.controller.arrive(*shot(rig))
    assert (
        failed.stopped and failed.latched and "made a setpoint that is not finite" in failed.reason
    )
    rig.agrees(failed.order)


def shot(rig: Rig) -> tuple[Exposure, float, float, vs.Reading]:
    """The next picture, which shows the markers."""
    rig.frame += 1
    t = rig.frame * rig.period
    view = TruthView(rig.p, np.zeros(len(rig.p), dtype=bool))
    return Exposure(rig.frame, t, None, rig.reading(), view), t, t, rig.reading()


def test_a_late_picture(rig: Rig) -> None:
    rig.sees()
    late = rig.sees(late_s=5.0)
    assert (
        late.stopped and not late.latched and late.command.twist.any() and "s late" in late.reason
    )


def test_no_picture(grounded: Rig) -> None:
    rig = grounded
    rig.sees()
    order = rig.silent(0.2)
    assert order.stopped and not order.latched and order.reason == "no picture arrived"
    for _ in range(100):
        if (order := rig.silent(0.2)).latched:
            break
    assert order.stopped and order.latched and "no picture arrived for" in order.reason
    assert rig.sees().latched
    rig.controller.reset()
    assert rig.controller.without_picture(0.0, rig.reading()).stopped  # the clock begins again, too
    assert moves(rig.sees())


def test_a_craft_without_pictures_holds_and_sinks() -> None:
    rig = Rig("quadrotor_hover")
    rig.sees()
    held = rig.silent(0.2)
    assert held.stopped and held.reason == "no picture arrived"
    rig.silent(1.0)
    sinks = rig.silent(1.0)
    assert not sinks.stopped and sinks.reason.endswith("the craft sinks")


@pytest.mark.parametrize(
    ("craft", "words"),
    [({"overturned": True}, "60 degrees"), ({"rotor_limit_s": 1.5}, "a rotor stood at its limit")],
)
def test_a_craft_in_trouble_holds_sinks_and_switches_off(craft: dict[str, Any], words: str) -> None:
    rig = Rig("quadrotor_hover")
    rig.sees()
    held = rig.sees(**craft)
    assert (
        held.stopped
        and held.latched
        and words in held.reason
        and held.reason.endswith("the craft holds")
    )
    sinks = [rig.sees() for _ in range(round(HOLD_S / rig.period) + 2)][-1]
    assert not sinks.stopped and sinks.latched and words in sinks.reason and sinks.twist.any()
    off = rig.sees(stands=True)
    assert (
        off.order.stop == "off"
        and off.stopped
        and off.latched
        and off.reason.endswith("rotors off")
    )
    assert rig.sees().order.stop == "off"
    rig.controller.reset()
    assert moves(rig.sees())


def test_a_joint_at_its_limit_leaves_a_velocity_that_agrees() -> None:
    for name in ("arm_ibvs", "arm_panda"):
        rig = Rig(name)
        free = rig.sees()
        assert free.command.twist.any()
        joint = int(np.abs(free.setpoint).argmax())
        low, high = rig.scenario.robot.body.limits[joint]
        rig.q = rig.q.copy()
        rig.q[joint] = high if free.setpoint[joint] > 0 else low
        found = [rig.sees() for _ in range(3)][-1]
        # in another configuration the joint may turn the other way
        if found.allocation.limit != "joint_limit":
            rig.q[joint] = low if rig.q[joint] == high else high
            found = rig.sees()
        assert found.allocation.limit == "joint_limit" and not found.stopped
        assert np.abs(found.setpoint).max() < 1e-9 and np.abs(found.twist).max() < 1e-9


@pytest.fixture(scope="module")
def shown() -> Shown:
    """An arm's scenario, the picture of its start, and its reading there."""
    scenario = vs.load("arm_ibvs", {"stop.lost_after_s": 0.2})
    with vs.Session(scenario, pictures=True) as session:
        frame = session.reset()
        assert frame.image is not None
        return scenario, frame.image, vs.Reading(frame.truth.q, np.zeros(6))


class TestWithPictures:
    """`step` itself, on pictures of the start."""

    def lost(self, shown: Shown) -> tuple[vs.Controller, list[vs.Cycle]]:
        """A controller whose target was lost, and is back in sight; and its cycles."""
        scenario, image, reading = shown
        controller, black = vs.Controller(scenario), np.zeros_like(image)
        pictures = [image] * 3 + [black] * 8 + [image] * 3
        return controller, [
            controller.step(picture, 0.04 * k, reading) for k, picture in enumerate(pictures)
        ]

    def test_the_twist_does_not_drive_on(self, shown: Shown) -> None:
        _, cycles = self.lost(shown)
        assert moves(cycles[2]) and cycles[3].stopped
        assert all(
            cycle.latched and cycle.stopped and not cycle.twist.any() and not cycle.setpoint.any()
            for cycle in cycles[-3:]
        )
        assert cycles[-1].command.twist.any() and "for 0.2 s" in cycles[-1].reason

    def test_after_a_reset_it_is_a_new_controller(self, shown: Shown) -> None:
        controller, first = self.lost(shown)
        controller.reset()
        _, image, reading = shown
        for k in range(3):
            again = controller.step(image, 0.04 * k, reading)
            assert (
                again.twist.tobytes() == first[k].twist.tobytes()
                and again.timing == first[k].timing
                and again.notes == ()
            )

    def test_a_picture_that_comes_twice_does_not_bring_an_old_velocity_back(
        self, shown: Shown
    ) -> None:
        scenario, image, reading = shown
        controller = vs.Controller(scenario)
        assert moves(controller.step(image, 0.0, reading))
        assert controller.without_picture(0.3, reading).stopped
        again = controller.step(image, 0.0, reading)
        assert (
            again.stopped
            and not again.latched
            and not again.twist.any()
            and again.notes == ("the picture of 0 s came again",)
        )
        assert controller.without_picture(0.6, reading).latched
        assert controller.step(image, 0.0, reading).latched
        assert controller.step(image, 0.64, reading).latched

    def test_a_mistake_changes_no_order(self, shown: Shown) -> None:
        scenario, image, reading = shown
        controller, other = vs.Controller(scenario), vs.Controller(scenario)
        for one in (controller, other):
            one.step(image, 0.0, reading)
        with pytest.raises(ParameterError, match=r"readings\.q has joint_\d outside of its range"):
            controller.step(image, 0.04, vs.Reading(np.degrees(reading.q), reading.qd))
        a, b = (one.step(image, 0.04, reading) for one in (controller, other))
        assert a.twist.tobytes() == b.twist.tobytes() and a.notes == b.notes == ()


class TestThreads:
    def test_a_second_thread_is_refused(self, monkeypatch: pytest.MonkeyPatch) -> None:
        controller, reading = (
            vs.Controller(vs.load("arm_ibvs")),
            vs.Reading(np.array([0, 0.7, -3, 0, 0.7, 0]), np.zeros(6)),
        )
        inside, go_on, found = threading.Event(), threading.Event(), []

        def slow(*given: Any) -> Any:
            inside.set()
            assert go_on.wait(10)
            raise RuntimeError("never mind")

        monkeypatch.setattr(type(controller.law), "step", slow)
        thread = threading.Thread(
            target=lambda: found.append(
                controller.step(np.zeros((480, 640, 3), np.uint8), 0.0, reading)
            )
        )
        thread.start()
        assert inside.wait(10)
        calls: tuple[Callable[[], object], ...] = (
            lambda: controller.step(np.zeros((480, 640, 3), np.uint8), 0.04, reading),
            lambda: controller.without_picture(0.5, reading),
            lambda: controller.retune(controller.law),
            controller.reset,
        )
        for call in calls:
            with pytest.raises(
                SessionError,
                match=(
                    "another thread is in a call of this controller,"
                    " which serves one thread at a time; hold"
                ),
            ):
                call()
        go_on.set()
        thread.join(10)
        assert found[0].latched and "never mind" in found[0].reason
        # one after the other, any thread may call it
        assert controller.without_picture(0.5, reading).stopped

    def test_of_a_session_too(self, monkeypatch: pytest.MonkeyPatch) -> None:
        with vs.Session(vs.load("ibvs_book", {"detector": "oracle"})) as session:
            session.reset()
            inside, go_on, found = threading.Event(), threading.Event(), []
            step = type(session.episode.controller.law).step  # pyright: ignore[reportOptionalMemberAccess] - it was reset

            def slow(*given: Any) -> Any:
                inside.set()
                assert go_on.wait(10)
                return step(*given)

            monkeypatch.setattr(type(session.episode.controller.law), "step", slow)  # pyright: ignore[reportOptionalMemberAccess]
            thread = threading.Thread(target=lambda: found.append(session.step()))
            thread.start()
            assert inside.wait(10)
            with pytest.raises(SessionError, match="another thread steps this session"):
                session.step()
            go_on.set()
            thread.join(10)
            assert (
                found[0].outcome is None
                and session.step().timing.number == found[0].timing.number + 1
            )


def test_the_log_of_a_run_whose_target_was_lost_tells_what_was_ordered() -> None:
    """By hand: the supervisor is obeyed first, in twist and setpoint alike."""
    with vs.Session(
        vs.load(
            "arm_ibvs", {"detector": "oracle", "robot.actuation": "ideal", "stop.lost_after_s": 0.0}
        )
    ) as session:
        frame = session.reset()
        assert session.episode is not None
        session.episode.controller.supervisor.abort(0.0, Outcome.target_lost, "given up")
        frame = session.step()
        command, allocation, order = session.episode.controller.override(frame, np.full(6, 0.1))
        assert (
            order.stopped
            and order.latched
            and not order.twist.any()
            and command.twist.any()
            and allocation.twist.any()
        )


def test_a_stop_of_a_car_keeps_its_steering() -> None:
    rig = Rig("car_pbvs")
    moving = next(
        cycle for cycle in (rig.sees() for _ in range(50)) if abs(cycle.setpoint[1]) > 1e-3
    )
    stop = rig.silent(1.0)
    assert stop.setpoint.tolist() == [0.0, moving.setpoint[1]] and not stop.twist.any()


def test_replacing_the_law_keeps_the_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig("ibvs_book")
    rig.sees()
    with monkeypatch.context() as patch:
        patch.setattr(type(rig.scenario.law), "step", lambda *given: None)
        assert rig.sees().latched
    rig.controller.retune(replace(rig.scenario.law, gain=1.0))
    assert rig.sees().latched
