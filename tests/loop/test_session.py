"""A session: the same bytes as `run`, in any thread, several at once; orders by hand reach the
robot; mistakes are told.
"""

from __future__ import annotations

import copy
import gc
import pickle
import threading
import weakref
from itertools import pairwise, product

import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.core.errors import ParameterError, SessionError

SHORT = {"stop.duration_s": 0.4}
TWELVE = (
    *(
        "arm_ibvs",
        "arm_pbvs",
        "arm_fisheye",
        "arm_track_circle",
        "omni_ibvs",
        "omni_line",
        "car_pbvs",
        "car_line",
    ),
    *("quadrotor_hover", "quadrotor_path", "ibvs_book", "spherical_behind"),
)


def turned(session: vs.Session, seed: int | None = None) -> vs.Recording:
    """The session's episode, stepped to its end by the scenario's law."""
    frame = session.reset(seed)
    while frame.outcome is None:
        frame = session.step()
    return session.recording()


def same(a: vs.Recording, b: vs.Recording) -> bool:
    ended = a.outcome is b.outcome and a.reason == b.reason and a.ended_s == b.ended_s
    return ended and a.columns == b.columns and a.table.tobytes() == b.table.tobytes()


@pytest.mark.parametrize("name", one_quick(*TWELVE, every=3))
def test_its_bytes_are_those_of_a_run_with_and_without_whole_pictures(name: str) -> None:
    scenario = vs.load(name, {"stop.duration_s": 0.3})
    run = vs.run(scenario)
    with vs.Session(scenario, pictures=True) as session:
        frame = session.reset()
        images = [frame.image]
        while frame.outcome is None:
            frame = session.step()
            images.append(frame.image)
        assert same(session.recording(), run)
    camera = scenario.camera
    assert all(
        image is not None and image.shape == (camera.height, camera.width, 3) and image.any()
        for image in images
    )
    assert len({id(image) for image in images}) == len(images) > 3


TAKEN = {
    "sharp": {},
    "blurred": {"timing.exposure_s": 0.01},
    "noisy": {"noise.image_sigma": 2.0},
    "row by row": {"camera.readout_s": 0.02},
}


@pytest.mark.parametrize(
    ("name", "taken"),
    one_quick(*product(("arm_ibvs", "arm_fisheye", "arm_pbvs", "arm_tags", "car_line"), TAKEN)),
)
def test_whole_pictures_beside_those_of_the_detector_change_no_byte_of_a_whole_run(
    name: str, taken: str
) -> None:
    """Were the detector shown them, a pixel at an edge would fall otherwise some frames later."""
    scenario = vs.load(name, {"stop.duration_s": 4.0, **TAKEN[taken]})
    assert same(vs.run(scenario, pictures=True), vs.run(scenario))


def test_several_are_independent_in_threads_and_interleaved() -> None:
    names = "arm_ibvs", "omni_ibvs"
    runs = [vs.run(vs.load(name, SHORT).randomised(3)) for name in names]
    threads, turned_there = [], {}
    for name in names:
        session = vs.Session(vs.load(name, SHORT))
        threads.append(
            threading.Thread(
                target=lambda n=name, s=session: turned_there.update({n: turned(s, seed=3)})
            )
        )
        threads[-1].start()
    sessions = [vs.Session(vs.load(name, SHORT)) for name in names]
    frames = [session.reset(seed=3) for session in sessions]
    while any(frame.outcome is None for frame in frames):
        frames = [
            s.step() if frame.outcome is None else frame
            for s, frame in zip(sessions, frames, strict=True)
        ]
    for thread in threads:
        thread.join()
    for name, session, run in zip(names, sessions, runs, strict=True):
        assert same(session.recording(), run) and same(turned_there[name], run)
        session.close()


@pytest.mark.parametrize("latency_s", [0.0, 0.06])
def test_a_command_by_hand_moves_the_robot_after_the_scenarios_latency(latency_s: float) -> None:
    settings = {
        "timing.command_latency_s": latency_s,
        "robot.actuation": "ideal",
        "stop.duration_s": 0.4,
        "camera.rate_hz": 100,
    }
    twist = np.array([0.05, 0.0, 0.0, 0.0, 0.0, 0.0])
    with vs.Session(vs.load("arm_ibvs", settings)) as session:
        frame = session.reset()
        for _ in range(5):
            frame = session.step(np.zeros(6))
        given, speeds = frame.t, []
        while frame.outcome is None:
            frame = session.step(twist)
            speeds.append((frame.t, np.linalg.norm(frame.truth.twist[:3])))
        log = session.recording()
    moving = next(t for t, v in speeds if v > 0.04)
    assert moving - given == pytest.approx(latency_s + 0.01, abs=0.0101)
    sent = log["t"] >= given
    np.testing.assert_allclose(log["cmd_vx"][sent][:-1], 0.05)
    np.testing.assert_allclose(log["applied_vx"][sent][:-1], 0.05, atol=1e-9)
    assert (log["cmd_vx"][~sent] == 0).all()
    before, after = (int(np.argmax(log["cmd_vx"] > 0)), int(np.argmax(log["act_vx"] > 0.04)))
    assert log["t"][after] - log["t"][before] >= latency_s


@pytest.mark.parametrize(
    ("name", "motion"),
    [
        ("omni_ibvs", [0.1, 0.0, 0.0]),
        ("car_pbvs", [0.3, 0.0]),
        ("quadrotor_hover", [0.2, 0.0, 0.0, 0.0]),
    ],
)
def test_a_robots_own_motions_are_camera_twists_by_its_mount(
    name: str, motion: list[float]
) -> None:
    scenario = vs.load(name, {"detector": "oracle", "stop.duration_s": 1.5})
    basis = scenario.robot.motion_basis(
        vs.Mount.of(scenario.camera.mount.T), scenario.robot.start_joints()
    )
    twist = basis @ motion
    with vs.Session(scenario) as by_motion, vs.Session(scenario) as by_twist:
        frame = by_motion.reset()
        by_twist.reset()
        while frame.outcome is None:
            frame = by_motion.step(np.array(motion))
            other = by_twist.step(twist)
        np.testing.assert_allclose(
            frame.truth.T_world_camera, other.truth.T_world_camera, atol=1e-9
        )
    log = by_motion.recording()
    assert 0.5 * motion[0] < np.linalg.norm(np.ptp(log.camera_poses().t, axis=0)) < 1.6 * motion[0]
    np.testing.assert_allclose(
        [log[f"cmd_{name}"][-1] for name in ("vx", "vy", "vz", "wx", "wy", "wz")], twist
    )


def test_the_law_still_says_what_it_would_do() -> None:
    with vs.Session(vs.load("arm_ibvs", SHORT)) as session:
        frames = [session.reset()]
        while frames[-1].outcome is None:
            frames.append(session.step(np.zeros(6)))
    # The robot rests: the law sees the same picture, and wants the same each time.
    twists = np.array([frame.command.twist for frame in frames[:-1]])
    assert np.linalg.norm(twists[0]) > 0.05 and np.abs(np.diff(twists, axis=0)).max() < 0.02
    assert not session.recording()["applied_vx"][:-1].any()
    assert all(a.t < b.t for a, b in pairwise(frames))


def test_a_law_that_took_over_again_drives_to_the_goal() -> None:
    with vs.Session(vs.load("ibvs_book", {"detector": "oracle"})) as session:
        frame = session.reset()
        for _ in range(5):
            frame = session.step([0.1, 0, 0, 0, 0, 0])
        while frame.outcome is None:
            frame = session.step()
    assert frame.outcome is vs.Outcome.converged
    assert frame.verdict == (
        session.recording().outcome,
        session.recording().reason,
    )


def test_a_seed_draws_the_start_and_none_is_the_scenarios_own() -> None:
    scenario = vs.load("ibvs_book", {"stop.duration_s": 0.5})
    alone = vs.run(scenario)
    with vs.Session(scenario) as session:
        assert same(turned(session), alone)
        assert same(turned(session), alone)
    arm = vs.load("arm_ibvs", {"stop.duration_s": 0.2})
    with vs.Session(arm) as session:
        for seed in (3, 4, 3):
            assert same(turned(session, seed), vs.run(arm.randomised(seed)))


def test_a_seed_is_that_of_the_noise_where_no_start_is_random() -> None:
    overrides = {"detector": "oracle", "noise.pixel_sigma_px": 0.5, "stop.duration_s": 0.5}
    with vs.Session(vs.load("ibvs_retreat", overrides)) as session:
        assert same(turned(session, 5), vs.run(vs.load("ibvs_retreat", overrides, seed=5)))
        assert not same(turned(session, 6), vs.run(vs.load("ibvs_retreat", overrides, seed=5)))


class TestMistakes:
    @pytest.fixture
    def session(self) -> vs.Session:
        return vs.Session(vs.load("omni_ibvs", SHORT))

    def test_before_reset(self, session: vs.Session) -> None:
        with pytest.raises(SessionError, match="nothing to step; call reset"):
            session.step()
        with pytest.raises(SessionError, match="nothing has run"):
            session.recording()

    @pytest.mark.parametrize("command", [[1.0, 2.0], np.zeros((6, 1)), "fast", [1, 2, 3, 4], 0.1])
    def test_of_the_commands_shape(self, session: vs.Session, command: object) -> None:
        with session:
            session.reset()
            with pytest.raises(
                ParameterError,
                match=r"must be a camera twist \(6,\), or 3 velocities along the robot's motions",
            ):
                session.step(command)  # type: ignore[arg-type] - the mistake
            assert session.step([0.1, 0, 0]).t > 0  # nothing was lost

    def test_of_numbers_that_are_none(self, session: vs.Session) -> None:
        with session:
            session.reset()
            with pytest.raises(ParameterError, match="must be finite"):
                session.step([np.nan, 0, 0])

    def test_after_the_end_and_after_close(self, session: vs.Session) -> None:
        recording = turned(session)
        with pytest.raises(
            SessionError, match=r"the run has ended: 0\.4 s were not enough; call reset"
        ):
            session.step()
        session.reset()
        session.close()
        with pytest.raises(SessionError, match="is closed"):
            session.step()
        assert session.recording().outcome is vs.Outcome.interrupted
        assert recording.outcome is vs.Outcome.timed_out

    def test_no_scenario(self) -> None:
        with pytest.raises(ParameterError, match="must be a Scenario"):
            vs.Session("arm_ibvs")  # type: ignore[arg-type] - the mistake

    def test_a_law_that_raises_frees_the_simulation(self, monkeypatch: pytest.MonkeyPatch) -> None:
        session = vs.Session(vs.load("ibvs_book"))
        session.reset()
        assert session.episode is not None
        monkeypatch.setattr(session.episode.controller, "arrive", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            session.step()
        assert session.episode.closed and len(session.recording().table) == 1


@pytest.mark.parametrize("name", ["ibvs_book", "quadrotor_hover"])
def test_a_session_that_is_closed_leaves_its_simulation_to_no_garbage_collector(name: str) -> None:
    # Memory of a model (100 MB with an arm's meshes) is outside Python, whose collector sees no
    # reason to run for it.
    gc.collect()
    gc.disable()
    try:
        with vs.Session(vs.load(name, SHORT)) as session:
            turned(session)
            assert session.episode is not None
            plant = weakref.ref(session.episode.plant)
        del session
        assert plant() is None
    finally:
        gc.enable()


def test_a_run_that_ends_without_another_picture_gives_the_last_frame_with_its_outcome() -> None:
    # A target that is lost while the camera is dead: pictures stop after the first second.
    scenario = vs.load(
        "arm_ibvs", {"timing.drop_probability": 0.97, "stop.duration_s": 4.0, "seed": 1}
    )
    run = vs.run(scenario)
    with vs.Session(scenario) as session:
        recording = turned(session)
        assert session.episode is not None and session.episode.frame is not None
        if recording.ended_s > session.episode.frame.t:
            assert session.episode.ended().outcome is recording.outcome
    assert same(recording, run) and recording.ended_s > recording["t"][-1]


@pytest.mark.parametrize("what", ["uv", "xy", "T_camera_target"])
def test_who_writes_to_a_frames_goal_is_told_and_later_runs_stay_the_same(what: str) -> None:
    scenario = vs.load("ibvs_book", SHORT)
    before = vs.run(scenario)
    with vs.Session(scenario) as session:
        frame = session.reset()
        frame = session.step()
        logged = (
            frame.observation.uv,
            frame.command.twist,
            frame.allocation.setpoint,
            frame.truth.q,
            frame.row,
        )
        for array in (getattr(frame.goal, what), frame.truth.T_world_target, *logged):
            with pytest.raises(ValueError, match="read-only"):
                array -= 0.3
    assert same(vs.run(scenario), before)


def test_a_session_is_not_pickled_and_says_what_is() -> None:
    session = vs.Session(vs.load("ibvs_book", SHORT))
    for take in (pickle.dumps, copy.copy, copy.deepcopy):
        with pytest.raises(
            SessionError,
            match=(
                r"a running simulation and cannot be pickled or copied;"
                r" take its scenario, or its recording"
            ),
        ):
            take(session)


def test_a_twist_beyond_all_bounds_ends_as_crashed() -> None:
    with vs.Session(vs.load("ibvs_book", SHORT)) as session:
        session.reset()
        frame = session.step([1e300] * 6)
        assert frame.outcome is vs.Outcome.crashed


def test_a_later_frame_is_not_in_an_earlier_recording() -> None:
    with vs.Session(vs.load("ibvs_book", SHORT)) as session:
        session.reset()
        session.step()
        early = session.recording()
        session.step()
        session.step()
        later = session.recording()
        assert (len(early.rows), len(later.rows)) == (1, 3)
        assert early.table.tobytes() == later.table[:1].tobytes()


def test_tags_in_whole_pictures_differ_by_a_thousandth_of_a_pixel() -> None:
    """A texture drawn whole and one drawn in a window differ by a grey level."""
    scenario = vs.load("arm_tags", SHORT)
    run = vs.run(scenario)
    with vs.Session(scenario, pictures=True) as session:
        whole = turned(session)
    assert len(run.rows) == len(whole.rows)
    for name in ("u_0", "v_0", "u_3", "v_3"):
        np.testing.assert_allclose(whole[name], run[name], atol=2e-3)
