"""Checks between two parts of a scenario that do not know one another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from vstestbed.camera import DEPTH_SENSORS, Camera
from vstestbed.core.errors import ParameterError, within
from vstestbed.core.geometry import Array, exp, lengths
from vstestbed.core.registry import kind_of
from vstestbed.features.depth import OnFloor, PnP
from vstestbed.features.observation import Goal
from vstestbed.laws import Law
from vstestbed.laws.base import inputs_of
from vstestbed.laws.points import at_goal
from vstestbed.robots import VEHICLES, Mount, Robot
from vstestbed.robots.base import needed_step
from vstestbed.sim.scene.world import World
from vstestbed.targets import Target
from vstestbed.tasks.base import Task
from vstestbed.tasks.stop import Stop
from vstestbed.timing.plan import Timing
from vstestbed.vision import DETECTORS, Detector
from vstestbed.vision.blobs import Blobs

MOST_FRAMES = 10_000_000
MOST_BYTES = 4 << 30
"""Most frames of a run: a day at 115 Hz, whose log is a table of some 10 GB. Most bytes of pictures
in transit.
"""

MOST_MOUNT_M = 10.0
MOST_VIEW_M = 100.0
MOST_PLACE_M = 100.0
"""Farthest that a camera is from its flange, a goal view from the target, and the target and the
ideal camera from the origin: several times what any experiment here needs [m]. What lies beyond was
meant in millimetres.
"""


def check_metres(robot: Robot, camera: Camera, target: Target) -> None:
    """Refuse a mount and a place of the target that are in millimetres, far beyond an experiment,
    and a camera under a vehicle.
    """
    if robot.base == "planar" and camera.mount.xyz[2] <= 0:
        words = (
            "must have z > 0: the vehicle's frame lies on the floor,"
            " and the camera would be under it"
        )
        raise ParameterError("camera.mount.xyz", words, camera.mount.xyz)
    check_length("camera.mount", camera.mount.T, MOST_MOUNT_M)
    check_length("target.pose", target.pose.T, MOST_PLACE_M)
    # the ideal camera; a vehicle may be further, and its field has bounds of its own
    if robot.body is None:
        check_length("robot.start", robot.flange_pose(robot.configuration()), MOST_PLACE_M)


def check_length(field: str, T: Array, most_m: float) -> None:
    """Refuse a pose (4, 4) that is further away than any experiment needs [m]."""
    length = float(np.linalg.norm(T[:3, 3]))
    if length > most_m:
        words = (
            f"is {length:.4g} m away, and may be at most {most_m:g} m;"
            f" lengths are in metres: did you mean {length / 1000:.4g} m?"
        )
        raise ParameterError(field, words)


def check_times(
    robot: Robot, camera: Camera, timing: Timing, stop: Stop, step_s: float, pictures: bool
) -> None:
    """Refuse stamps of readings for a robot that has none, a physics step [s] at which a robot's
    vibrations would be those of the arithmetic, and runs whose log, or pictures in transit to the
    law, would not fit into memory. pictures: whether any are taken.
    """
    if timing.robot_clock is not None and robot.body is None:
        words = (
            f"stamps a robot's sensor readings, and robot {robot.kind} has none;"
            " errors of the pictures' stamps: timing.camera_clock"
        )
        raise ParameterError("timing.robot_clock", words)
    most_s = needed_step(robot)
    if step_s > (1 + 1e-9) * most_s:
        words = (
            f"{most_s:.4g} s with these gears and drives;"
            " without step_s the longest that works is taken"
        )
        raise ParameterError.bound("physics.step_s", "at most", words, step_s)
    if stop.duration_s * camera.rate_hz > MOST_FRAMES:
        most = (
            f"{MOST_FRAMES / camera.rate_hz:g} s, {MOST_FRAMES} pictures at {camera.rate_hz:g} Hz"
        )
        why = "a longer log is a table of more than 10 GB"
        raise ParameterError.bound("stop.duration_s", "at most", most, stop.duration_s, why=why)
    if not pictures:
        return
    each = 3 if camera.depth_sensor is None else 7  # bytes of a pixel
    size = sum(each * panel.lens.width * panel.lens.height for panel in camera.panels)
    transit_s = MOST_BYTES / size / camera.rate_hz
    if camera.latency_s + timing.latency_jitter_s > transit_s:
        words = (
            f"may be at most {transit_s:.4g} s with its jitter:"
            " more of these pictures in transit do not fit into memory"
        )
        raise ParameterError("camera.latency_s", words, camera.latency_s)


def check_robot(robot: Robot) -> None:
    """Refuse effects that do not fit the robot's joints, and joints without a body."""
    for i, effect in enumerate(getattr(robot, "effects", ())):
        with within(f"robot.effects.{i}"):
            effect.check(robot.joints)
    if robot.body is None and robot.joints:
        words = f"{robot.kind} has joints and no body; let its `body` name an MJCF file"
        raise ParameterError("robot.kind", words)


def check_flight(
    robot: Robot, target: Target, world: World, derotation: str, level_trim_s: float
) -> None:
    """Refuse derotation and wind for robots that do not fly, and a correction of the tilt by a
    target from which it cannot be seen.
    """
    flies = robot.base == "floating"
    if not flies and derotation != "none":
        able = "a craft that tilts (robot quadrotor); here it must be none"
        raise ParameterError.only_for("derotation", able, derotation)
    if not (flies or world.wind.still):
        able = "a craft that flies (robot quadrotor)"
        raise ParameterError.only_for("world.wind", able, robot.kind)
    # the target's own motion would be taken for a tilt
    if level_trim_s and (derotation == "none" or target.moves):
        words = (
            "corrects the tilt for a derotation by a target that stands still; here it must be 0"
        )
        raise ParameterError("level_trim_s", words, level_trim_s)


def check_contact(robot: Robot, target: Target, world: World) -> None:
    """Refuse friction for wheels that never slip, and a target in a hand that is not there."""
    if world.floor_friction is not None and robot.body is not None and not robot.body.slips:
        words = "is not felt by wheels: planar, which never slip; use wheels: rollers"
        raise ParameterError("world.floor_friction", words, world.floor_friction)
    if target.on_gripper and not (robot.body and robot.body.gripper):
        what = f"held with robot {robot.kind}"
        raise ParameterError.excluded("target.motion", what, why="it has no hand; use puma560")


def check_depth(robot: Robot, camera: Camera, detector: Detector[Any], law: Law[Any]) -> None:
    """Refuse a source of depth that this scenario has not got: the truth, a depth camera, or a
    vehicle's place on the floor.
    """
    if law.depth.true and not detector.needs_truth:
        words = (
            "may be oracle only with detector: {kind: oracle};"
            " with pixels use pnp, constant, goal, estimate or sensor"
        )
        raise ParameterError("law.depth", words)
    if law.depth.measured and camera.depth_sensor is None:
        others = "goal or constant" if "image" in law.inputs else "pnp, constant, goal or estimate"
        words = (
            "may be sensor only with a depth camera: add camera.depth_sensor"
            f" ({', '.join(DEPTH_SENSORS.members)}), or use {others}"
        )
        raise ParameterError("law.depth", words)
    if "wrench" in law.inputs and getattr(robot, "wrist", None) is None:
        what = "robot.wrist, a sensor of the wrench that it reads"
        raise ParameterError.needs("law", what, law.kind)
    if law.depth.on_floor and robot.base != "planar":
        words = (
            f"may be floor only for a vehicle, and robot {robot.kind} is none;"
            " use pnp, goal or estimate"
        )
        raise ParameterError("law.depth", words)


def check_carrier(target: Target) -> None:
    """Refuse a route that the vehicle which carries the target cannot drive: a bend too tight, or a
    speed too high.
    """
    carrier = target.carrier
    if carrier is None:
        return
    leader = VEHICLES[carrier.by]()
    radius = carrier.route.least_radius_m
    if radius < leader.turning_radius_m:
        words = (
            f"has a bend of {radius:.3g} m, and the car that carries the target turns no tighter"
            f" than {leader.turning_radius_m:.3g} m; make it wider, or use by: omni"
        )
        raise ParameterError("target.motion.route", words)
    speed = carrier.speed_mps
    if speed > leader.top_speed_mps:
        most = f"{leader.top_speed_mps:g} m/s"
        words = f"{most}, the top speed of the {carrier.by} that carries the target"
        raise ParameterError.bound("target.motion.speed_mps", "at most", words, speed)


def check_goal_pictures(
    goal: Task, camera: Camera, needed: bool, law: Law[Any], detector: Detector[Any]
) -> None:
    """Refuse pictures of the goal that nobody looks at, that cannot be read, and that lack the
    depth that the law needs.
    """
    for i, said in enumerate(goal.pictures):
        field = "goal.picture" if len(goal.pictures) == 1 else f"goal.views.{i}.picture"
        if not needed and (said.file is not None or said.other_light):
            words = (
                f"is looked at by neither law {law.kind} nor detector {detector.kind};"
                " it is for law photometric, or detector keypoints"
            )
            raise ParameterError(field, words)
        if said.file is None:
            continue
        if law.depth.measured and "image" in law.inputs:
            words = "sensor with goal.picture, a file without depth"
            raise ParameterError.excluded("law.depth", words, "sensor", works="goal or constant")
        try:
            said.read(camera)
        except ParameterError as error:
            raise ParameterError(field, error.problem, error.found) from None


# Outlines that run along a body as the camera moves, those of a ball and of a disc: what they tell.

# motions to both sides by which an outline's directions are differentiated [distances, rad]
STEP = 1e-4
# share of the largest singular value from which a motion counts as told: the differences are exact
# to some 1e-8
LEAST_TOLD = 1e-6


def runs_along(target: Target) -> bool:
    """Whether the points are on an outline that lies elsewhere on the target for each place of the
    camera: they tell no pose.
    """
    return target.outlined and not len(target.places)


def is_sized(target: Target) -> bool:
    """Whether the size of the target's outline tells its place: of a ball, not of a disc."""
    return target.by_size(np.zeros((len(target.points), 3))) is not None


def called(target: Target) -> str:
    """A target whose outline runs along it, in words."""
    return "a ball" if is_sized(target) else "a disc"


def motions_told(target: Target, T_camera_target: Array, basis: Array) -> int:
    """How many of a camera's motions the picture of the target's points tells at most, at a pose
    (4, 4): the rank of d directions / d u. A feature is a function of that picture, whatever its
    own interaction matrix says: that of points takes each for fixed to the target. All motions
    where the points have places of their own, as far as their features tell them.
    basis: the robot's motions as twists of the camera in its own frame, (6, n).
    """
    if not runs_along(target):
        return basis.shape[1]
    steps = STEP * basis.T * np.repeat([float(np.linalg.norm(T_camera_target[:3, 3])), 1.0], 3)
    # the camera moves the other way
    before, after = (target.points_at(exp(way * steps) @ T_camera_target) for way in (1, -1))
    rates = (after / lengths(after) - before / lengths(before)) / (2 * STEP)
    if not np.isfinite(rates).all():  # from inside a ball; the goal view is refused elsewhere
        return basis.shape[1]
    return int(np.linalg.matrix_rank(rates.reshape(len(rates), -1), rtol=LEAST_TOLD))


# Checks of what is measured against what the law and the task need: markers, a detector's own
# points, depths.

# conditions of convergence by the robot's own estimate
BY_ESTIMATE = ("position_m", "rotation_deg")
FIRST_POSE = 4  # fewest points that tell a pose by themselves
# a pixel of a target of 100 px, far more than blobs scatter, and less than `assign_blobs` allows
ALIKE = 0.01
# ratio of the second to the first singular value of marker positions under which they count as
# collinear
ON_ONE_LINE = 1e-6


def check_markers(
    robot: Robot,
    camera: Camera,
    target: Target,
    detector: Detector[Any],
    law: Law[Any],
    needs_pose: bool,
) -> None:
    """Refuse markers that the detector cannot detect, too few markers, and arrangements that do not
    determine the pose. needs_pose: the task needs the target's pose, which not every depth source
    estimates.
    """
    check_detected(target, detector, law)
    _check_marker_count(robot, camera, target, detector, law)
    depth = law.depth
    if depth.needs_size and not is_sized(target):
        raise ParameterError.excluded(
            "law.depth",
            "size without target ball",
            why="its outline tells its distance",
            works="pnp, goal or estimate",
        )
    if runs_along(target) and (depth.needs_pose or needs_pose):
        words = (
            f"may not be {depth.kind}:"
            f" the outline of {called(target)} does not tell how it is turned, and so has no pose"
        )
        if not _has_depth(law):
            words += f", which law {law.kind} needs"
        elif is_sized(target):
            words += "; use size or goal"
        else:
            words += "; use goal"
        raise ParameterError("law.depth", words)
    if depth.needs_pose and not depth.on_floor:
        _check_spread(robot, target, law, needs_pose)


def _check_spread(robot: Robot, target: Target, law: Law[Any], needs_pose: bool) -> None:
    """Refuse markers on one line: a rotation about it is not observable, since their scatter round
    the centroid has rank one.
    """
    points = target.points
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if len(points) >= 3 and spread[1] >= ON_ONE_LINE * spread[0]:
        return
    if not _has_depth(law):
        words = (
            f"has all markers on one line, which leaves the pose open that law {law.kind} works"
            " with; use other places"
        )
        raise ParameterError("target", words)
    # Only what this robot and task would accept: `floor` needs a vehicle, a task with a pose needs
    # a source that estimates one.
    depths = "goal or estimate"
    if needs_pose:
        depths = "floor"
    elif robot.base == "planar":
        depths = "floor, goal or estimate"
    which = "all markers lie on one line" if len(points) > 1 else "there is a single marker"
    why = f"{which}, which leaves the pose open; use {depths}"
    raise ParameterError.excluded("law.depth", "pnp", why=why)


def check_own_points(
    robot: Robot, camera: Camera, detector: Detector[Any], law: Law[Any], views: Sequence[Goal]
) -> None:
    """Refuse what a detector of other points than the target's markers cannot serve; nothing for a
    detector of markers.
    """
    if not detector.needs_goal:
        return
    if len(camera.panels) > 1:
        what = f"{detector.kind} with a camera that sees all round"
        why = "it compares single pictures; use perspective or fisheye"
        raise ParameterError.excluded("detector", what, why=why)
    if len(views) > 1:
        what = f"{detector.kind} with {len(views)} goal views in turn"
        why = "it compares with the picture of one; use goal: view"
        raise ParameterError.excluded("detector", what, why=why)
    if detector.fleeting and law.depth.estimator is not None:
        words = (
            "estimates each point's depth from its motion,"
            f" and detector {detector.kind} shows other points in every picture;"
            " use pnp or goal, or let it follow its points (track: klt)"
        )
        raise ParameterError("law.depth", words)
    # one of the up to four poses from three points has the base upright on the floor
    if robot.base != "planar" and detector.rows is not None and detector.rows < FIRST_POSE:
        _check_poseless(detector, law)
    if detector.changing:
        _check_same_markers(law, detector.kind)
        _check_kept_points(law, detector.kind)


def _check_poseless(detector: Detector[Any], law: Law[Any]) -> None:
    """Refuse a law that needs the target's pose, for a detector of too few points."""
    reads_pose = "T_camera_target" in law.inputs
    if not (reads_pose or law.depth.needs_pose):
        return
    words = (
        f"must be at least {FIRST_POSE} where the target's pose is needed,"
        f" since three points have up to four poses; works: {FIRST_POSE}"
    )
    if _has_depth(law) and not reads_pose:
        words += ", or law.depth goal or sensor"
    field = "detector.best" if hasattr(detector, "best") else "detector"
    raise ParameterError(field, words, detector.rows)


def _check_same_markers(law: Any, detector: str) -> None:
    """Refuse a law, or the feature in it, that needs the same markers in every picture."""
    if not law.needs_same_markers:
        return
    wanted = f"the same markers in every picture, and detector {detector} shows other points"
    for place, part in (("law.law", getattr(law, "law", None)), ("law", law)):
        feature = getattr(part, "feature", None)
        if part is not None and feature is not None and part.needs_same_markers:
            why = (
                f"it is made of several markers together, which takes {wanted};"
                " use point, polar or spherical"
            )
            raise ParameterError.excluded(f"{place}.feature", feature.kind, why=why)
    why = f"it needs {wanted}; use ibvs, pbvs or hybrid"
    raise ParameterError.excluded("law", law.kind, why=why)


def _check_kept_points(law: Any, detector: str) -> None:
    """Refuse a law that keeps points from the border or a plane, where they are all over the
    picture.
    """
    if "radius_px" not in inputs_of(law):
        return
    given = {}
    for name in ("margin_px", "plane_m"):
        if getattr(law, name, None) is not None:
            given[f"law.{name}"] = "null"
    if getattr(getattr(law, "visibility", None), "margin_px", 0) > 0:
        given["law.visibility.margin_px"] = "0"
    remedy = " and ".join(f"{name}: {off}" for name, off in given.items())
    words = (
        "keeps points from the border or a plane,"
        f" and those of detector {detector} are all over the picture;"
        f" works: {remedy or 'a law, or a condition, that does not'}"
    )
    raise ParameterError(next(iter(given), "law"), words)


def check_judged(stop: Stop, target: Target, detector: Detector[Any], law: Law[Any]) -> None:
    """Refuse conditions of convergence on what is not measured: markers without a detector, grey
    levels with a law of markers, a pose that an outline does not tell or the law does not take from
    it.
    """
    goal = stop.converged
    if goal.error_grey is not None and "image" not in law.inputs:
        words = (
            "is of a law that works on grey levels (photometric),"
            f" and law {law.kind} does not; use error_px"
        )
        raise ParameterError("stop.converged.error_grey", words)
    for name in ("error_px", *BY_ESTIMATE):
        limit = getattr(goal, name)
        if limit is None:
            continue
        field = f"stop.converged.{name}"
        if detector.rows == 0:
            words = f"markers, and detector {detector.kind} finds none"
            works = "stop: {converged: {error_grey: 1}}"
            raise ParameterError.needs(field, words, works=works)
        if name in BY_ESTIMATE and (words := _untold_pose(target, law)):
            raise ParameterError.needs(field, f"the target's pose, {words}", limit)


def _untold_pose(target: Target, law: Law[Any]) -> str:
    if not target.outlined:  # of markers some detectors solve the pose themselves
        return ""
    if runs_along(target):
        return f"which the outline of {called(target)} does not tell; works: error_px alone"
    if law.depth.needs_pose or {"T_camera_target", "place"} & set(law.inputs):
        return ""
    works = "law.depth pnp, or error_px alone" if _has_depth(law) else "error_px alone"
    return f"which law.depth {law.depth.kind} does not estimate; works: {works}"


def check_detected(target: Target, detector: Detector[Any], law: Law[Any]) -> None:
    """Refuse a detector that does not see this kind of markers, that nobody reads, or for which the
    target shows nothing.
    """
    marker = target.marker.kind
    if detector.markers and marker not in detector.markers:
        why = (
            f"detector {detector.kind} sees {', '.join(detector.markers)};"
            f" with {marker} use detector {_detectors_of(marker)}"
        )
        raise ParameterError.excluded("target.marker", marker, why=why)
    if set(law.inputs) == {"image"}:
        _check_unread(target, detector, law)
    shown = kind_of(type(target))
    if detector.needs_sheet and target.sheet is None:
        words = (
            f"must be a picture for detector {detector.kind}, which tracks it:"
            " `target: {kind: picture, file: poster.png, width: 0.6}`"
        )
        raise ParameterError("target", words, shown)
    if detector.markers and not target.draw_markers and target.sheet is None:
        what = f"false with detector {detector.kind}"
        why = (
            f"a {shown} without markers shows it nothing to detect;"
            f" use true, or detector {_detectors_of()}"
        )
        raise ParameterError.excluded("target.draw_markers", what, False, why=why)
    _check_told_apart(target, detector)


def _detectors_of(marker: str = "") -> str:
    """The detectors that see markers of a kind, in words; by default those that see any."""
    able = []
    for kind, member in DETECTORS.members.items():
        of_markers = member.rows is None and not member.needs_sheet
        if of_markers and (not member.markers or marker in member.markers):
            able.append(kind)
    return " or ".join(able)


def _check_unread(target: Target, detector: Detector[Any], law: Law[Any]) -> None:
    """Refuse a detector beside a law that works on the whole picture, and reads no points of it."""
    if detector.needs_goal:
        why = f"law {law.kind} works on the whole picture, and reads no points of it; use none"
    elif detector.markers and not target.draw_markers:
        why = (
            "no markers are drawn (target.draw_markers: false),"
            f" and law {law.kind} needs none; use none"
        )
    else:
        return
    raise ParameterError.excluded("detector", detector.kind, why=why)


def _check_told_apart(target: Target, detector: Detector[Any]) -> None:
    """Refuse markers of one colour that a turn of the target puts in one another's places, for a
    detector that tells them by their colours: which is which would be left to chance.
    """
    if not isinstance(detector, Blobs):
        return
    for order in _alike(target.points, [hue % 360 for hue in target.hues_deg], []):
        # a view from behind, where such a target has no markers
        if target.one_sided and _mirrors(target.points, order):
            continue
        exchanged = [
            f"{target.called(i)} for {target.called(j)}" for i, j in enumerate(order) if i != j
        ]
        if exchanged:
            seen = "turned" if target.one_sided else "turned, or from behind"
            words = (
                f"leave it open which marker is which: {seen}, the target shows"
                f" {', '.join(exchanged)}; works: other hues of these, none (all are then"
                " different), marker tag, an arrangement without symmetry"
            )
            raise ParameterError("target.marker.hues", words, list(target.marker.hues))


def _alike(points: Array, hues: Sequence[float], order: list[int]) -> Iterator[list[int]]:
    """The orders of markers that continue one, have the same colours and, within a share ALIKE of
    the largest, the same distances, and so follow from a motion of the target. Of a flat one a
    mirror image, too, is seen: from behind.
    """
    i = len(order)
    if i == len(points):
        centred = points - points.mean(axis=0)
        # a negative one is of a mirror image of a solid
        if np.linalg.det(centred.T @ centred[order]) > -ON_ONE_LINE * np.ptp(points) ** 6:
            yield order
        return
    apart = np.linalg.norm(points[:, None] - points[None], axis=-1)
    for j, hue in enumerate(hues):
        if j in order or hue != hues[i]:
            continue
        off = np.abs(apart[i, :i] - apart[j, order]).max(initial=0.0)
        if off <= ALIKE * apart.max():
            yield from _alike(points, hues, [*order, j])


def _mirrors(points: Array, order: list[int]) -> bool:
    """Whether markers in the plane z = 0 come into one another's places by a mirror image alone,
    and by no turn.
    """
    centred = (points - points.mean(axis=0))[:, :2]
    return float(np.linalg.det(centred.T @ centred[order])) < -ON_ONE_LINE * np.ptp(points) ** 4


def _check_marker_count(
    robot: Robot, camera: Camera, target: Target, detector: Detector[Any], law: Law[Any]
) -> None:
    count = len(target.points)
    basis = robot.motion_basis(Mount.of(camera.mount.T), robot.start_joints())
    # One at least: a robot whose motions need none would still have nothing to look at.
    needed = max(law.markers_needed(basis), 1)
    if detector.rows is not None and detector.rows < law.markers_needed(basis):
        why = (
            f"it reports {detector.rows} points, and law {law.kind} needs {needed} or more;"
            " use another one, or law photometric"
        )
        raise ParameterError.excluded("detector", detector.kind, why=why)
    if detector.rows is None and count < needed:
        markers = "1 marker" if count == 1 else f"{count} markers"
        words = f"has {markers}, and law {law.kind} needs {needed} or more for this robot's motions"
        if robot.base == "planar" and isinstance(law.depth, PnP) and _has_depth(law):
            less = replace(law, depth=OnFloor()).markers_needed(basis)  # pyright: ignore[reportCallIssue] - it has the field
            if count >= less:
                words += f"; with law.depth floor {less} will do"
        raise ParameterError("target", words)


def check_determined(
    robot: Robot, camera: Camera, target: Target, law: Law[Any], goal: Goal
) -> None:
    """Refuse a feature that tells fewer motions than the robot has, where the law does not leave
    motions open. Features of all markers together may, and all features of an outline that looks
    alike from other places.
    """
    for servo, own, seen, all_motions in _told(robot, camera, target, law, goal):
        feature = servo.feature
        told = min(own, seen)
        alike = seen < all_motions
        each = feature.rows_per_marker
        if servo.redundant or told == all_motions or (each and not alike):
            continue
        words = f"{feature.kind} tells {told} of this robot's {all_motions} motions at the goal"
        if alike:
            words += f", since {called(target)} looks alike from other places"
        words += f"; use law.redundant: true, which leaves the others {'open' if each else 'alone'}"
        if hasattr(feature, "rows") and own < seen:
            words += ", or more rows (law.feature.rows)"
        raise ParameterError("law.feature", words)


def free_motions(robot: Robot, camera: Camera, target: Target, law: Law[Any], goal: Goal) -> int:
    """How many of the robot's motions a law with `redundant` leaves free at a goal view, where its
    pose is not determined; 0 for none.
    """
    most = 0
    for servo, own, seen, motions in _told(robot, camera, target, law, goal):
        if servo.redundant:
            most = max(most, motions - min(own, seen))
    return most


def _told(
    robot: Robot, camera: Camera, target: Target, law: Law[Any], goal: Goal
) -> list[tuple[Any, int, int, int]]:
    """Each law with a feature that may leave motions open, how many motions of the robot's its
    interaction matrix tells at a goal view, how many the target's picture does, and how many the
    robot has.
    """
    basis = robot.motion_basis(Mount.of(camera.mount.T), robot.start_joints())
    seen = motions_told(target, goal.T_camera_target, basis)
    told = []
    for servo in _image_based(law):
        inputs = at_goal(servo.feature, goal)
        if inputs is not None:
            L = servo.feature.interaction(*inputs) @ basis
            own = int(np.linalg.matrix_rank(L, rtol=servo.solve.cutoff))
            told.append((servo, own, seen, basis.shape[1]))
    return told


def _image_based(law: Any) -> Iterator[Any]:
    """The laws with a feature that may leave motions open: this law, or those within it."""
    if law.feature is not None and hasattr(law, "redundant"):
        yield law
    if hasattr(law, "law"):
        yield from _image_based(law.law)
    for part in getattr(law, "laws", ()):
        yield from _image_based(part.law)


def _has_depth(law: Law[Any]) -> bool:
    return any(field.name == "depth" for field in fields(law))
