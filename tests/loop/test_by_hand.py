"""What a person does to a session under way: tune its law, push its robot, move its target, hold a
plate.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.core.errors import ParameterError, SessionError
from vstestbed.laws.base import ConstantGain

PLATE_M = 0.1


def started(name: str, steps: int = 3, **overrides: object) -> vs.Session:
    session = vs.Session(
        vs.load(name, {k.replace("__", "."): v for k, v in overrides.items()}), plate_m=PLATE_M
    )
    session.reset()
    for _ in range(steps):
        session.step()
    return session


@pytest.mark.parametrize("name", one_quick("arm_ibvs", "ibvs_book", "quadrotor_hover"))
def test_a_plate_in_reserve_changes_no_number(name: str):
    short = {"stop.duration_s": 0.3}
    plain = vs.run(vs.load(name, short))
    with vs.Session(vs.load(name, short), pictures=True, plate_m=PLATE_M) as session:
        frame = session.reset()
        while frame.outcome is None:
            frame = session.step()
    np.testing.assert_array_equal(session.recording().table, plain.table)


@pytest.mark.parametrize("name", one_quick("arm_ibvs", "quadrotor_hover"))
def test_pictures_now_and_then_change_no_number(name: str):
    short = {"stop.duration_s": 0.24, "timing.exposure_s": 0.01, "timing.exposure_pictures": 3}
    plain, seen = vs.run(vs.load(name, short)), []
    with vs.Session(vs.load(name, short), pictures=True) as session:
        frame = session.reset()
        while frame.outcome is None:
            session.take_pictures(frame.timing.number % 3 == 0)
            frame = session.step()
            seen.append(frame.image is not None)
    np.testing.assert_array_equal(session.recording().table, plain.table)
    assert any(seen) and not all(seen)


class TestTheLaw:
    def test_keeps_its_memory(self):
        smooth = {"law__smooth_start_s": 1.0}
        with started("arm_ibvs", **smooth) as session, started("arm_ibvs", **smooth) as twin:
            law = session.episode.scenario.law
            state = session.episode.controller.law_state
            session.retune(replace(law, gain=ConstantGain(value=0.9)))
            assert session.episode.controller.law_state is state
            # u - u(0) exp(-t / tau): the first command in memory stays that of the old gain
            frame, other = session.step(), twin.step()
            fade = state.u0 * np.exp(-(frame.t - state.t0))
            np.testing.assert_allclose(
                frame.command.u, 1.8 * (other.command.u + fade) - fade, rtol=1e-9
            )

    def test_of_another_kind_feature_or_depth_is_refused(self):
        for setting, field in (
            ({"law": "pbvs"}, "kind"),
            ({"law.feature": "polar"}, "feature"),
            ({"law.depth": "goal"}, "depth"),
        ):
            with started("arm_ibvs", 0) as session:
                with pytest.raises(
                    ParameterError, match=rf"law\.{field} cannot be changed during a run"
                ):
                    session.retune(vs.load("arm_ibvs", setting).law)
                assert session.recording().scenario == vs.load("arm_ibvs")


class TestAPush:
    def test_moves_a_craft_by_its_impulse(self):
        still = {"law__gain": 1e-6}
        with (
            started("quadrotor_hover", 2, **still) as pushed,
            started("quadrotor_hover", 2, **still) as twin,
        ):
            mass = pushed.weight_n / 9.81
            pushed.push(np.array([0.0, 0.5 * pushed.weight_n, 0.0]), 0.08)
            for _ in range(2):
                frame, other = pushed.step(), twin.step()
            v, v_other = (
                f.truth.T_world_camera[:3, :3] @ f.truth.twist[:3] for f in (frame, other)
            )
            gained = 0.5 * pushed.weight_n * 0.08 / mass
            # its controller acts against it meanwhile
            assert (v - v_other)[1] == pytest.approx(gained, rel=0.35)
            for _ in range(3):
                frame, other = pushed.step(), twin.step()
            later = (frame.truth.T_world_camera[:3, :3] @ frame.truth.twist[:3])[1]
            assert abs(later) < 2 * gained  # the force has ended

    def test_of_no_mass_or_no_numbers_is_refused(self):
        with (
            started("ibvs_book", 0) as session,
            pytest.raises(ParameterError, match="needs a robot with a mass"),
        ):
            session.push(np.ones(3))
        with started("arm_ibvs", 0) as session:
            for force, seconds in (
                ([1, 2], 0.1),
                ([np.nan, 0, 0], 0.1),
                ([1, 0, 0], 0.0),
                ([1, 0, 0], np.inf),
            ):
                with pytest.raises(ParameterError):
                    session.push(np.array(force), seconds)
            assert session.recording().scenario == vs.load("arm_ibvs")


class TestTheTarget:
    @pytest.mark.parametrize("name", ["arm_ibvs", "ibvs_book"])
    def test_is_where_it_was_put(self, name: str):
        with started(name) as session:
            frame = session.step()
            T = frame.truth.T_world_target.copy()
            T[:3, 3] += [0.0, 0.03, 0.02]
            session.move_target(T)
            frame = session.step()
            np.testing.assert_allclose(frame.truth.T_world_target, T, atol=1e-12)
            assert frame.error.rms_px > 1.0
            assert "target moved from" in session.recording().scenario.description

    def test_goes_on_from_there_where_it_moves(self):
        with started("arm_track_circle") as session, started("arm_track_circle") as twin:
            T = session.step().truth.T_world_target.copy()
            twin.step()
            T[2, 3] += 0.05
            for _ in range(30):  # as a mouse does: every displacement is of the path itself
                session.move_target(T)
            # pictures in transit show it where it was
            moved = [session.step().truth.T_world_target for _ in range(9)][4:]
            own = [twin.step().truth.T_world_target for _ in range(9)][4:]
            shift = moved[0] @ np.linalg.inv(own[0])
            for T_moved, T_own in zip(moved, own, strict=True):
                np.testing.assert_allclose(T_moved, shift @ T_own, atol=1e-9)
            assert np.linalg.norm(own[-1][:3, 3] - own[0][:3, 3]) > 1e-3

    @pytest.mark.parametrize("name", ["arm_eye_to_hand", "car_pursuit"])
    def test_is_not_moved_where_it_is_carried(self, name: str):
        with (
            started(name, 0) as session,
            pytest.raises(ParameterError, match="it goes where its carrier goes"),
        ):
            session.move_target(np.eye(4))


class TestAPlate:
    def test_hides_the_markers_behind_it_from_oracles_too(self):
        with started("ibvs_book") as session:
            frame = session.step()
            T = frame.truth.T_world_camera.copy()
            T[:3, 3] += 0.8 * T[:3, :3] @ frame.truth.p_camera[1]
            session.hold_plate(T)
            assert np.flatnonzero(~session.step().observation.seen).tolist() == [1]
            session.hold_plate(None)
            assert session.step().observation.seen.all()

    def test_must_be_in_reserve(self):
        with vs.Session(vs.load("ibvs_book")) as session:
            session.reset()
            with pytest.raises(ParameterError, match=r"plate_m=0\.1"):
                session.hold_plate(np.eye(4))


def test_nothing_can_be_done_to_what_does_not_run():
    session = vs.Session(vs.load("ibvs_book", {"stop.duration_s": 0.2}))
    law = vs.load("ibvs_book").law
    for act in (
        lambda: session.push(np.ones(3)),
        lambda: session.retune(law),
        lambda: session.move_target(np.eye(4)),
    ):
        with pytest.raises(SessionError, match="nothing to step"):
            act()


def test_an_arm_that_holds_the_target_is_pushed_at_its_gripper():
    with (
        started("arm_eye_to_hand", 2, robot__actuation="raw") as pushed,
        started("arm_eye_to_hand", 2, robot__actuation="raw") as twin,
    ):
        pushed.push(np.array([0.0, 300.0, 0.0]), 0.2)
        for _ in range(6):
            frame, other = pushed.step(), twin.step()
        assert np.abs(frame.truth.q - other.truth.q).max() > 1e-3 and pushed.weight_n > 100


def test_poses_and_twists_of_spatialmath_do_what_the_numbers_do():
    from spatialmath import SE3, Twist3

    fast = {"detector": "oracle", "stop.duration_s": 1.0}
    T, twist = SE3(0.1, 0, 3) * SE3.Rz(0.2), Twist3([0.1, 0, 0.2], [0, 0, 0.3])
    tables = []
    for pose, command in ((T, twist), (T.A, [0.1, 0, 0.2, 0, 0, 0.3])):
        with vs.Session(vs.load("ibvs_book", fast), pictures=True, plate_m=PLATE_M) as session:
            session.reset()
            session.move_target(pose)
            session.hold_plate(pose)
            session.step(command)
            session.step(command)
            recording = session.recording()
        tables.append(recording.table)
    np.testing.assert_array_equal(*tables)
    assert np.abs(recording.target_poses()[-1].A - T.A).max() < 1e-12
    assert np.abs(recording.camera_twists()[-1].S - twist.S).max() < 1e-12


def test_what_is_no_pose_and_no_twist_is_refused():
    from spatialmath import SE2, SE3

    session = started("ibvs_book", detector="oracle")
    with pytest.raises(ParameterError, match=r"T_world_target is a place in the plane \(SE2\)"):
        session.move_target(SE2(1, 2, 3))
    with pytest.raises(ParameterError, match=r"T_world_plate must be one pose: .*, got 2"):
        session.hold_plate(SE3.Rx([0.1, 0.2]))
    with pytest.raises(
        ParameterError, match=r"command must be a twist \(Twist3\) or numbers, got an SE3"
    ):
        session.step(SE3())
    session.close()
