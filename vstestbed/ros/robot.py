"""The simulated robot as a node: what its camera and its sensors tell goes out, twists come in, with its latency, limits and supervisor."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Literal

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array
from vstestbed.loop.ego_motion import mount_at
from vstestbed.loop.episode import Episode
from vstestbed.loop.recording import Recording, Watcher
from vstestbed.robots import Mount, Reading
from vstestbed.ros.law import command_frame, command_topic
from vstestbed.ros.link import Link
from vstestbed.ros.messages import (
    OPTICAL,
    TWIST,
    WORLD,
    Message,
    body_frame,
    camera_info,
    clock,
    depth_image,
    image,
    pose,
    readings,
    time_of,
    transforms,
    twist_of,
)
from vstestbed.scenario.scenario import Scenario, check_scenario
from vstestbed.tasks.frame import Frame

Pace = Literal["lockstep", "wall"]
AGAIN_S = 0.01  # after so long without an answer readings are told again [s]


class RobotNode:
    """A session whose commands come from outside. Services: `~/stop` (latched: no twist moves it until `~/start`), `~/start`.

    Args:
        scenario: the experiment; its law computes too, for the log, and moves nothing.
        link: to the others.
        pace: `lockstep`: simulated time waits for a command to each picture; `wall`: it goes with the clock of this machine, and stamps are
            of it.
        truth: whether the poses of camera and target are told, under `/truth`.
        watchdog_s: wall time without a command after which the robot is told to rest [s]; by default for as long as an order lasts.
    """

    def __init__(
        self,
        scenario: Scenario,
        link: Link,
        pace: Pace = "lockstep",
        truth: bool = False,
        watchdog_s: float | None = None,
        ended: threading.Event | None = None,
    ):
        check_scenario(scenario)
        if scenario.detector.needs_truth and not scenario.needs_image:
            words = f"sends no pictures with detector {scenario.detector.kind}, for none are drawn; works: --set detector=blobs"
            raise ParameterError("robot", words)
        self.scenario, self.link, self._pace, self._truth = scenario.resolved, link, pace, truth
        self.watchdog_s = watchdog_s or self.scenario.timing.order_s(self.scenario.camera)
        self._news = threading.Condition()
        self._command: tuple[float, Array, float] | None = None  # stamp, twist of the camera, when it came
        self._stopped = False
        self._silent = True  # nobody has commanded yet, or not for too long
        self._mount = Mount.of(self.scenario.believed_camera.mount.T)
        self.answered_s: list[float] = []  # from a picture's sending to its command
        self.behind_s = 0.0  # at most, of simulated behind wall time
        self.refused = ""
        self._readings: list[tuple[float, Reading]] = []
        self._q, self._offset = self.scenario.robot.start_joints(), 0.0
        self.ended = ended or threading.Event()
        link.subscribe(command_topic(scenario), TWIST, self._hear)
        link.serve("~/stop", self.stop)
        link.serve("~/start", self.start)

    def stop(self) -> tuple[bool, str]:
        """Rest, whatever is commanded, until `start`."""
        with self._news:
            self._stopped, self._command = True, None
            self._news.notify()
        return True, "the robot rests until ~/start"

    def start(self) -> tuple[bool, str]:
        """Follow commands again."""
        with self._news:
            self._stopped = False
        return True, "the robot follows commands"

    def _hear(self, message: Message) -> None:
        try:
            v = twist_of(message)
            frame = message.header.frame_id
            if frame not in (OPTICAL, body_frame(self.scenario.robot), ""):
                words = f"is in the frame {frame}; works: {OPTICAL} or {body_frame(self.scenario.robot)}"
                raise ParameterError("twist", words)
        except ParameterError as error:
            if self.refused != str(error):
                self.refused = str(error)
                logging.getLogger("vstestbed").warning("%s", error)
            return
        with self._news:
            in_camera = frame == OPTICAL or (not frame and command_frame(self.scenario) == OPTICAL)
            self._command = time_of(message), v if in_camera else self._of_body(v), time.monotonic()
            self._news.notify()

    def _of_body(self, v: Array) -> Array:
        """The camera's twist of one of the flange or the base."""
        q = self._q if self.scenario.target.on_gripper else np.zeros(0)
        return mount_at(self.scenario, self._mount, q).to_camera @ v

    def fly(self, scenario: Scenario, watch: Iterable[Watcher] = (), folder: Path | None = None, *, pictures: bool = True) -> Recording:
        """Run it until an outcome, or `ended`; as `loop.run`."""
        episode = Episode(scenario, True, tuple(watch), folder)
        with contextlib.closing(episode):
            frame = episode.advance()
            began, simulated = time.monotonic(), 0.0 if frame is None else frame.t
            self._offset = time.time() - simulated if self._pace == "wall" else 0.0
            while frame is not None and episode.outcome is None and not self.ended.is_set():
                self._publish(episode, frame)
                sent = time.monotonic()
                v = self._wait(frame, began + frame.t - simulated + scenario.camera.period)
                if v is not None:
                    self.answered_s.append(time.monotonic() - sent)
                episode.changed_by_hand("commanded from outside")
                frame = episode.advance(np.zeros(6) if v is None else v)
                if frame is not None:
                    self.behind_s = max(self.behind_s, time.monotonic() - began - (frame.t - simulated))
        return episode.recording()

    def _wait(self, frame: Frame, due: float) -> Array | None:
        """The twist for a frame; None for rest. due: when the next picture is due [s]."""
        with self._news:
            if self._pace == "wall":
                while not self.ended.is_set() and (left := due - time.monotonic()) > 0:
                    self._news.wait(min(left, 0.1))
                fresh = self._command is not None and time.monotonic() - self._command[2] <= self.watchdog_s
                self._silent = not fresh
                return self._command[1] if self._command is not None and fresh and not self._stopped else None
            # After a silence simulated time goes on with the wall's: a robot whose law is dead comes to rest, and its pictures go on.
            end = time.monotonic() + (self.scenario.camera.period if self._silent else self.watchdog_s)
            stamp = frame.t + self._offset
            answered = False
            while not (answered or self._stopped or self.ended.is_set()) and (left := end - time.monotonic()) > 0:
                if not self._news.wait(min(left, AGAIN_S)):
                    self._tell_readings()
                answered = self._command is not None and self._command[0] >= stamp - 1e-6
            if self._stopped:
                self._news.wait_for(self.ended.is_set, timeout=max(0.0, min(self.scenario.camera.period, end - time.monotonic())))
            self._silent = not answered
            return self._command[1] if self._command is not None and answered and not self._stopped else None

    def _tell_readings(self) -> None:
        """Those of the last exposure and of now, as often as a robot's driver would: single ones may be lost beside a picture."""
        for stamp, reading in self._readings:
            for topic, message in readings(stamp, self.scenario.robot, reading).items():
                self.link.publish(topic, message)

    def _publish(self, episode: Episode, frame: Frame) -> None:
        """What camera and sensors tell at a frame: readings at the exposure and now, then the picture."""
        robot, t, shot = self.scenario.robot, frame.t + self._offset, episode.controller.before
        assert shot is not None and frame.image is not None
        now = t + self.scenario.camera.latency_s
        publish = self.link.publish
        publish("/clock", clock(now))
        self._readings = [(t, shot.reading)] if now <= t else [(t, shot.reading), (now, episode.plant.reading())]
        self._tell_readings()
        if robot.base == "fixed":
            self._q = shot.reading.q
            known = {(WORLD, "flange"): robot.flange_pose(self._q)} if robot.joints else {}
            parent = WORLD if self.scenario.target.on_gripper else "flange"
            publish("/tf", transforms(t, {**known, (parent, OPTICAL): self._mount.T_flange_camera}))
        else:
            publish("/tf", transforms(t, {("base_link", OPTICAL): self._mount.T_flange_camera}))
        if self._truth:
            publish("/truth/camera_pose", pose(t, frame.truth.T_world_camera))
            publish("/truth/target_pose", pose(t, frame.truth.T_world_target))
        if (info := camera_info(t, self.scenario.believed_camera)) is not None:
            publish("~/camera_info", info)
        if frame.depth_image is not None:
            publish("~/depth", depth_image(t, frame.depth_image))
        publish("~/image_raw", image(t, frame.image))
