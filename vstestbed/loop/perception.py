"""What is seen: detector and observer of each camera with their states, and the views of several
cameras together.
"""

from __future__ import annotations

import zlib
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vstestbed.camera import DepthImage, Image, Regions
from vstestbed.core.geometry import Array, adjoint, exp, inverse
from vstestbed.features.depth import Depth
from vstestbed.features.observation import CameraView, EgoMotion, Goal, Observation
from vstestbed.laws.base import inputs_of
from vstestbed.loop.ego_motion import CommandHistory, Exposure
from vstestbed.robots import Mount, Reading, Robot
from vstestbed.scenario.cameras import OtherCamera
from vstestbed.scenario.distributions import NOISE_STREAM
from vstestbed.scenario.scenario import Scenario
from vstestbed.vision import Observer
from vstestbed.vision.base import Detection
from vstestbed.vision.derotate import Derotation, level_from_tilt
from vstestbed.vision.observe import CameraPixels, SensorData

# an observation older than so many periods of its camera, and its latency, tells nothing of now
FRESH_PERIODS = 2.5
# the twist of a camera whose motion nothing reads; read-only, since all frames share it
STILL = np.zeros(6)
STILL.flags.writeable = False


def observer_of(scenario: Scenario) -> Observer:
    """The observer of a scenario's own camera."""
    required = inputs_of(scenario.law)
    if scenario.fusion == "pose":
        required += ("T_camera_target",)
    observer = _observer(
        scenario, scenario.goal_view, scenario.law.depth, required, scenario.derotation
    )
    return replace(
        observer,
        grounded=scenario.robot.base == "planar",
        trim_s=scenario.level_trim_s,
        rows=scenario.detector.rows,
    )


def _observer_of(eye: OtherCamera) -> Observer:
    """The observer of a further camera: of the markers and the pose, and of nothing that the robot
    alone knows.
    """
    scenario = eye.scenario
    mount = scenario.believed_camera.mount.T
    goal = eye.goal(scenario.goal_view, eye.T_camera_eye(eye.robot.start_joints(), mount))
    return _observer(eye, goal, eye.depth, eye.required_fields, scenario.derotation)


def _observer(
    of: Scenario | OtherCamera,
    goal: Goal,
    depth: Depth,
    required: tuple[str, ...],
    derotation: Derotation,
) -> Observer:
    """What both have."""
    perturbed = of.perturbed()
    return Observer(
        camera=of.believed_camera,
        target=of.target,
        goal=goal,
        depth=depth,
        pixel_sigma_px=of.noise.pixel_sigma_px,
        dropout=of.noise.dropout,
        required_fields=required,
        derotation=derotation,
        depth_scale=of.depth_scale,
        perturbed=perturbed if perturbed and perturbed.on_pixels else None,
    )


REPEATED = 8  # buffers of a driver, at most


class Stillness:
    """For how long a camera's pictures have been the same to the byte while a velocity was in force
    [s], `for_s`: it may be frozen. Pictures of a robot at rest may be the same in simulation, where
    nothing is noisy. The same as one of the last REPEATED: a driver that hangs may repeat its
    buffers in turn.

    until_seen: how many pictures may be taken from an order on until it acts; stamps that creep do
    not tell.
    """

    def __init__(self, until_seen: float) -> None:
        self.for_s = 0.0
        self._until_seen = until_seen
        self._moving = 0
        self._checksums = deque[int](maxlen=REPEATED)
        self._last: tuple[float, float] | None = None

    def add(
        self,
        images: Sequence[Image | DepthImage | None],
        t: float,
        own_s: float,
        ordered: CommandHistory,
        moves: bool,
    ) -> None:
        """One more picture, of one image or several, by its stamp and by the own clock [s];
        ordered: the velocities in force so far. moves: whether the last order is one.
        """
        checksum = 0
        self._moving = self._moving + 1 if moves else 0
        for image in images:
            if image is not None:
                checksum = zlib.crc32(np.ascontiguousarray(image).data, checksum)
        if checksum not in self._checksums:
            self.for_s = 0.0
        elif self._last is not None:
            self._checksums.remove(checksum)
            before, own_before = self._last
            way = ordered.displacement(t) - ordered.displacement(before)
            if self._moving > self._until_seen or way.any():
                self.for_s += max(t - before, own_s - own_before)
        self._checksums.append(checksum)
        self._last = t, own_s


class Perception:
    """Detector and observer of one camera, with their states between its pictures.

    of: the scenario, or the further camera of one. goal: the first goal view, with its picture
    where the detector needs one.

    Attributes:
        found: whether it has found a marker so far. why: why the detector found none in the last
            picture. goal: the goal by a detector's own points, which are others in every picture;
            None else. before: the last exposure.
    """

    def __init__(self, of: Scenario | OtherCamera, observer: Observer, goal: Goal):
        self.observer = observer
        self._target = of.target
        self._detector = of.detector
        self._rng = of.rng(NOISE_STREAM)
        # an oracle looks with the true lens; a real detector knows only the calibrated one
        self._camera = of.camera if of.detector.needs_truth else of.believed_camera
        self._state = of.detector.begin(goal, self._camera, of.target)
        self._observed = observer.init()
        self.found = False
        self.why = ""
        self.goal: Goal | None = None
        self.before: Exposure | None = None

    def regions_of_interest(self) -> Regions | None:
        """The detector's regions of interest in the next picture; None for all of it."""
        return self._detector.regions_of_interest(self._state, self._camera, self._target)

    def detect(self, shot: Exposure) -> Detection:
        """What the detector finds in a picture."""
        given = shot.picture if self._detector.needs_image else None
        self._state, detection = self._detector.detect(
            self._state, given, shot.view, self._camera, self._target, self._rng
        )
        self.found = self.found or bool(detection.seen.any())
        self.goal = detection.goal
        self.why = detection.why
        return detection

    def observe(
        self,
        shot: Exposure,
        detection: Detection,
        twist: Array,
        own: EgoMotion | None = None,
        partner: CameraView | None = None,
        others: Sequence[CameraPixels] = (),
    ) -> Observation:
        """What a law may know of a picture. twist: of the camera (6,) since the last one. partner:
        the second camera of a pair. others: what further cameras see, for a fused pose.
        """
        depth = shot.picture.depth if shot.picture else None
        pair = None
        if partner is not None and partner.seen.ray is not None:
            pair = partner.seen.ray, partner.T_camera_this
        sensors = SensorData(shot.reading.heading, shot.reading.tilt, own, depth, pair, others)
        self._observed, seen = self.observer.observe(
            self._observed, shot.t, detection, twist, self._rng, sensors
        )
        self.before = shot
        return seen

    def own(self, seen: Observation) -> Observation:
        """An observation with the markers that the picture itself shows, and none that a fused pose
        has put beside them.
        """
        return seen if self._observed.uv is None else replace(seen, uv=self._observed.uv)


def moved_between(
    robot: Robot, ordered: CommandHistory, before: Exposure, now: Exposure, mount: Mount
) -> Array:
    """Displacement (6,) of the law's camera from one exposure to another [m, rad], which may be the
    earlier one, by the robot's own sensors, or by the commands where it has none.
    """
    since = now.t - before.t
    if since == 0:
        return STILL
    if since < 0:
        return -moved_between(robot, ordered, now, before, mount)
    commanded = (ordered.displacement(now.t) - ordered.displacement(before.t)) / since
    return robot.measured_twist(before.reading, now.reading, since, commanded, mount) * since


@dataclass
class _Latest:
    """The last exposure of a further camera, what was observed in it, and when it came by the own
    clock [s].
    """

    shot: Exposure
    seen: Observation
    came_s: float


class OtherCameras:
    """The further cameras of a controller: their last observations, and what these tell together
    with the law's camera.

    scenario: of the controller. mount: of the law's camera as calibrated. own_s: the own clock [s],
    which stands where time is simulated.
    """

    def __init__(self, scenario: Scenario, mount: Array, goal: Goal, own_s: Callable[[], float]):
        self._own_s = own_s
        self._order_s = scenario.timing.order_s(scenario.camera)
        self._scenario = scenario
        self._mount = mount
        self._start = scenario.robot.start_joints()
        self.eyes = scenario.eyes
        self.perception: dict[str, Perception] = {}
        for name, eye in self.eyes.items():
            at_start = eye.goal(goal, eye.T_camera_eye(self._start, mount))
            observer = _observer_of(eye)
            observer.prepare(True)
            self.perception[name] = Perception(eye, observer, at_start)
        self._latest: dict[str, _Latest] = {}
        self._goals: dict[str, tuple[Goal, Goal]] = {}

    def see(self, name: str, shot: Exposure, ordered: CommandHistory, mount: Mount) -> None:
        """A picture of a further camera has arrived. ordered: the twists ordered of the law's
        camera, whose mount is `mount`.
        """
        perception = self.perception[name]
        eye = self.eyes[name]
        before = perception.before
        came_s = self._own_s()
        detection = perception.detect(shot)
        twist = STILL
        if (
            before is not None
            and shot.t > before.t
            and eye.rigid
            and perception.observer.uses_motion(detection)
        ):
            moved = moved_between(eye.robot, ordered, before, shot, mount)
            T_camera_eye = eye.T_camera_eye(shot.reading.q, self._mount)
            twist = adjoint(inverse(T_camera_eye)) @ moved / (shot.t - before.t)
        self._latest[name] = _Latest(shot, perception.observe(shot, detection, twist), came_s)

    def seen(self) -> dict[str, Observation]:
        """The last observation of each camera."""
        return {name: latest.seen for name, latest in self._latest.items()}

    def forgotten(self, t: float) -> tuple[str, ...]:
        """What to say of cameras whose last picture is not too old at a time [s] by its stamp, but
        by the own clock.
        """
        fresh = {name for name, _, _ in self._fresh(t)}
        own_s = self._own_s()
        notes: list[str] = []
        for name, latest in self._latest.items():
            if t - latest.shot.t <= self._fresh_s(name) and name not in fresh:
                notes.append(
                    f"{name}: the last picture came {own_s - latest.came_s:.2g} s ago:"
                    " it counts for nothing"
                )
        return tuple(notes)

    def _fresh_s(self, name: str) -> float:
        camera = self.eyes[name].camera
        return FRESH_PERIODS * camera.period + camera.latency_s

    def _fresh(self, t: float) -> Iterator[tuple[str, OtherCamera, _Latest]]:
        """The cameras whose last picture is not too old to tell of a time [s]; by the own clock it
        may be older by as long as an order lasts, which no stamp prolongs.
        """
        own_s = self._own_s()
        for name, latest in self._latest.items():
            fresh_s = self._fresh_s(name)
            if t - latest.shot.t <= fresh_s and own_s - latest.came_s <= fresh_s + self._order_s:
                yield name, self.eyes[name], latest

    def views(self, shot: Exposure, t: float, goal: Goal | None) -> dict[str, CameraView]:
        """The views of the further cameras beside a picture `shot` of the law's camera that has
        arrived at t [s]. goal: in force; None before it is known.
        """
        views: dict[str, CameraView] = {}
        for name, eye, latest in self._fresh(t):
            at = self._goal(name, goal) if goal is not None and eye.rigid else None
            seen = latest.seen if goal is None else latest.seen.only(goal.counted)
            views[name] = CameraView(seen, at, self._pose(eye, shot.reading), eye.rigid)
        return views

    def pixels(
        self, shot: Exposure, t: float, ordered: CommandHistory, mount: Mount
    ) -> list[CameraPixels]:
        """What the further cameras see beside a picture `shot` of the law's camera that has arrived
        at t [s], for a fused pose.

        A camera that moves with the law's own is where it was at its own exposure: the way between
        both is the robot's own measurement.
        """
        found: list[CameraPixels] = []
        for _, eye, latest in self._fresh(t):
            if not latest.seen.seen.any():
                continue
            T_this_reference = inverse(eye.T_camera_eye(shot.reading.q, self._mount))
            if eye.rigid:
                T_this_reference = T_this_reference @ exp(
                    moved_between(eye.robot, ordered, latest.shot, shot, mount)
                )
            seen = latest.seen
            weight = eye.block.weight
            found.append(
                CameraPixels(
                    eye.believed_camera, seen.uv, T_this_reference, weight, seen.T_camera_target
                )
            )
        return found

    def _pose(self, eye: OtherCamera, reading: Reading) -> Array:
        """T_camera_eye (4, 4) as the robot knows it; of a derotated pair between their level
        frames.
        """
        T = eye.T_camera_eye(reading.q, self._mount)
        if self._scenario.derotation != "none" and reading.tilt is not None:
            T = T.copy()
            T[:3, 3] = level_from_tilt(reading.tilt, self._mount[:3, :3]) @ T[:3, 3]
        return T

    def _goal(self, name: str, goal: Goal) -> Goal:
        """The goal as a camera that moves with the law's sees it, computed anew only where the goal
        is another one.
        """
        known = self._goals.get(name)
        if known is None or known[0] is not goal:
            eye = self.eyes[name]
            made = eye.goal(goal, eye.T_camera_eye(self._start, self._mount))
            known = self._goals[name] = goal, replace(made, twist=None)
        return known[1]
