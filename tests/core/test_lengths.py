"""Every constant length of the package is known here with the reason for which it does not depend
on the scene's size.

What has no such reason is to be a share of the target's size or of its distance (`unit_of`,
`Goal.reach_m`, `thin`, `Marker.clearance_m`); `tests/loop/test_scale.py` then flies the same scene
in all sizes.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

import vstestbed
from tests.shortcuts import is_here

PACKAGE = Path(vstestbed.__file__).parent
METRES = re.compile(r"\[(?:[^\]]*[ ,;])?m(?:[ ,;][^\]]*)?\]")
"""A unit as comments and docstrings give it: `[m]`, `[m, rad]`, `[rad; m for one that slides]`;
`[m/s]` is none.
"""
LENGTHS = {"Length", "Distance", "PositiveLength", "Position"}
"""Types of fields that are lengths."""

REASONS = {
    "bounds of what is a length at all, or what is in millimetres by mistake": (
        """
        core/geometry.py ORDINARY_M
        core/quantity.py Distance Length Position
        core/spatial.py LEVEL
        loop/inputs.py OUTSIDE
        loop/termination.py FAR_M
        report/run/page.py FARTHEST_M
        apps/ros/messages.py DEPTHS
        scenario/checks.py MOST_MOUNT_M MOST_PLACE_M MOST_VIEW_M
        sim/render/rays.py FAR
        scenario/cameras.py LEAST_BASELINE_M
        apps/calibrate/calibration.py LEAST_M MOST_M
        tasks/metrics.py LEAST
        sim/scene/joint_chain.py MOST_ARM_M
        sim/scene/model_files.py MOST_M"""
    ),
    (
        "the size of a robot that exists, of its parts and its sensors,"
        " or a tolerance of what is that large"
    ): (
        """
        effects/links.py Payload.com_m Payload.edge_m
        effects/rotors.py ROTOR_M
        effects/tool.py Plug.length Plug.radius
        effects/wheels.py Tyres.relaxation_m
        laws/qp.py STEP
        robots/arm.py LIMIT_MARGIN NEAR_M PositionBox.slide_m
        robots/car.py CarParameters.track_m CarParameters.wheel_radius_m CarParameters.wheelbase_m
        robots/compound.py DECK_M
        robots/flight.py RESUME_M
        robots/mjcf.py WIND_UP_M
        robots/omni.py OmniParameters.track_m OmniParameters.wheel_radius_m
        robots/omni.py OmniParameters.wheelbase_m
        robots/own_model.py OwnModel.unit_m
        robots/puma560.py ELBOW FOREARM OFFSET SHOULDER UPPER_ARM
        robots/quadrotor.py FAR_M FlightPose.xyz LOWEST_M Quadrotor.range_sigma_m STANDING_M
        robots/rotors.py HUB_M QuadrotorParameters.arm_m QuadrotorParameters.rotor_radius_m
        sim/plant.py EXACT_M
        sim/scene/compose.py BEHIND_LENS_M HOUSING_M PAD_HALF_M POST_RADIUS_M SOCKET_BOTTOM_M
        sim/scene/compose.py SOCKET_SIDES
        sim/scene/model_report.py APART_DEG APART_M CLEAR_M DISTANCES_M MOUNTS_M
        apps/calibrate/calibration.py POSE_SIGMA
        apps/maps/delay.py OFF OFF_WITH_FRICTION"""
    ),
    "a task of such a robot: lines and places on the floor, insertion, landing": (
        """
        laws/line_following.py LEAST_AHEAD_M
        targets/route.py LONGEST_M SPACING_M
        tasks/following.py ALONG_M ONE_PLACE_M
        tasks/insertion.py BEYOND_M CRAWL_M DEEP_ENOUGH_M LEAD_M
        vision/floor_pose.py SETTLED
        vision/lines.py Lines.reach_m"""
    ),
    (
        "the room that is drawn:"
        " its floor, lamps and views from outside, which no law sees, and shadows"
    ): (
        """
        effects/floor.py HALF_M
        apps/live/page.py FLOOR_M GRID_M LAYER_M LONGEST_M SHORTEST_M
        sim/plant.py AWAY
        sim/render/still.py FLOOR_M NEAR_M
        apps/gpu/warp_kernels.py AWAY
        sim/replay.py FLOOR_M
        sim/scene/compose.py FINE_FLOOR_M FINE_GRID_M LIFT_M PANE_HALF_M PLATE_HALF_M SUN_M
        sim/scene/follow.py HIDDEN_M
        sim/scene/meshes.py ENDLESS_M PRINT_M
        sim/scene/overview.py LEAST_REACH LIGHT_HEIGHT ROAM ROAM_M
        sim/scene/scenery.py SAME_HEIGHT_M
        sim/scene/world.py AWAY DISC_HALF_M"""
    ),
    (
        "the most of a length that is a share of the scene where that is small,"
        " or whose ratio to it drops out"
    ): (
        """
        imaging/depth.py NEAREST_M
        sim/scene/compose.py BEHIND_SHEET_M FAR_START_M NEAR_START_M PITCH_M
        targets/markers.py HALF_THICKNESS_M HIDDEN HIDDEN_M"""
    ),
    "the default of a field, which a scenario of another size gives": (
        """
        effects/floor.py UnevenFloor.correlation_m UnevenFloor.rms_m
        features/depth.py Constant.depth_m Estimate.initial_m
        features/points.py StereoPoint.baseline_m
        imaging/depth.py DepthSensor.far_m Stereo.baseline_m Stereo.far_m Stereo.near_m
        imaging/depth.py StructuredLight.baseline_m StructuredLight.far_m StructuredLight.near_m
        imaging/depth.py TimeOfFlight.far_m TimeOfFlight.near_m
        laws/pose_controller.py PoseController.average_m PoseController.pass_m PoseController.rest_m
        sim/scene/world.py Clutter.radius_m Clutter.size_m Decoy.radius Floor.tile_m
        sim/scene/world.py Plate.height Plate.width WindowPane.height WindowPane.width
        apps/calibrate/calibration.py Board.marker_m Board.square_m
        targets/base.py Pad.side Socket.depth Socket.radius Socket.wall
        targets/ground_lines.py GroundLines.look_m
        targets/markers.py RoundMarker.radius Stripe.width_m Tag.size
        targets/route.py CircularRoute.radius_m FigureEight.length_m FigureEight.width_m
        targets/route.py Straight.length_m
        tasks/following.py GoalLine.band_m
        tasks/insertion.py GoalInsertion.standoff_m GoalInsertion.within_m
        tasks/landing.py GoalLanding.commit_m GoalLanding.pad_m GoalLanding.within_m
        tasks/path.py GoalPath.band_m
        tasks/stop.py Stop.lost_after_m
        tasks/view.py GoalTrack.band_m"""
    ),
    "a scene of a test's own": (
        """
        cli/doctor.py BALLS
        cli/templates/monitor.py MyMonitor.margin_m
        cli/templates/motion.py MyMotion.amplitude_m
        cli/templates/task.py MyTask.distance_m
        testing/laws.py RADIUS_M STEP
        testing/perception.py AT_M
        testing/robots.py STEP"""
    ),
}


def has_number(value: ast.expr) -> bool:
    """Whether an expression has a number that is not 0."""
    return any(
        isinstance(n, ast.Constant) and isinstance(n.value, int | float) and n.value
        for n in ast.walk(value)
    )


def said_after(body: list[ast.stmt], i: int) -> str:
    """The docstring of a constant: the text behind its statement."""
    after = body[i + 1] if i + 1 < len(body) else None
    text = after.value if isinstance(after, ast.Expr) else None
    return text.value if isinstance(text, ast.Constant) and isinstance(text.value, str) else ""


def lengths_in(source: str) -> set[str]:
    """Names of the constants and defaults that are lengths: by name, by type, or, of a module's, by
    the unit in its comment, which stands above it or at its end.
    """
    tree, lines, found = ast.parse(source), source.splitlines(), set[str]()
    for scope in (tree, *(node for node in ast.walk(tree) if isinstance(node, ast.ClassDef))):
        prefix = f"{scope.name}." if isinstance(scope, ast.ClassDef) else ""
        for i, node in enumerate(scope.body):
            if (
                not isinstance(node, ast.Assign | ast.AnnAssign)
                or node.value is None
                or not has_number(node.value)
            ):
                continue
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [
                n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)
            ]
            first = node.lineno - 1
            while first and lines[first - 1].lstrip().startswith("#"):
                first -= 1
            comment = " ".join(lines[first : node.end_lineno]).partition("#")[2]
            told = not prefix and METRES.search(f"{comment} {said_after(scope.body, i)}")
            typed = isinstance(node, ast.AnnAssign) and LENGTHS & {
                n.id for n in ast.walk(node.annotation) if isinstance(n, ast.Name)
            }
            found |= {
                prefix + name for name in names if name.endswith(("_M", "_m")) or typed or told
            }
    return found


def known() -> dict[str, set[str]]:
    """The table by file, without those of apps that are not there."""
    table: dict[str, set[str]] = {}
    for lines in REASONS.values():
        for file, *names in (line.split() for line in lines.strip().splitlines()):
            if is_here(file):
                table.setdefault(file, set()).update(names)
    return table


@pytest.mark.app()
def test_every_constant_length_has_its_reason():
    found = {
        p.relative_to(PACKAGE).as_posix(): lengths_in(p.read_text(encoding="utf-8"))
        for p in sorted(PACKAGE.rglob("*.py"))
    }
    table = known()
    new = {
        file: sorted(names - table.get(file, set()))
        for file, names in found.items()
        if names - table.get(file, set())
    }
    gone = {
        file: sorted(names - found.get(file, set()))
        for file, names in table.items()
        if names - found.get(file, set())
    }
    assert not new, (
        "constants in metres without a reason here;"
        f" make them shares of the scene, or say why not: {new}"
    )
    assert not gone, f"no constants in metres any more: {gone}"


def test_a_new_constant_length_is_found():
    constants = (
        "NEAREST_M = 0.01\n"
        "LEAST = 1e-3  # under which nothing is seen [m, rad]\n"
        "QUICK = 2.0  # [m/s]\n"
        "# what a comment above a constant tells [m],\n"
        "# in two lines\n"
        "FAR = 5\n"
    )
    source = constants + "class A:\n    gap: PositiveLength = 0.1\n"
    assert lengths_in(source) == {"NEAREST_M", "LEAST", "FAR", "A.gap"}
