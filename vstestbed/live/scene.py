"""The scene of a run in the browser: robot, target, goal, camera with its picture, trail, floor."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import viser

from vstestbed.core.geometry import Array, inverse, quaternion_wxyz, rotation_from_quaternion, transform
from vstestbed.live.transport import Sample
from vstestbed.report.video.outside import GOAL, OWN, frustum_corners
from vstestbed.report.video.writer import Image
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.replay import Replay

FLOOR, LINES, SKY = (74, 92, 115), (98, 117, 141), (190, 202, 216)
FLOOR_M, GRID_M = 400.0, 60.0
"""Edges of the floor, and of the part of it with lines [m]."""
AMBIENT = 1.2
LIGHTS = (("key", (-2.0, -3.0, 4.0), 1.7), ("fill", (3.0, 2.0, 1.0), 0.6))
"""Lights from afar: where they come from, and how bright they are."""
REACH = 0.13
"""Length of the camera's frustum over its distance from the target, or from its goal, at the start."""
REACH_OF_ROOM = 0.05
"""The same of a camera that stands in the room: it may be nearer to the viewer than the robot, and must not hide it."""
SHORTEST_M, LONGEST_M = 0.06, 0.6
NEAR = 0.02
"""Near plane over the distance of what is looked at: the depth buffer must tell lines on the floor from the floor."""
LAYER_M = 0.004
"""Distance of the grid under the floor of the simulation, and of the surface under the grid [m]."""
GHOST = 0.3
"""Opacity of the robot, or the target in the gripper, at its goal."""
PLACES = 400
"""Points of the trail: when there are more, every other one is dropped."""
PLATE_GREY = (115, 115, 120)


@dataclass
class _Placed:
    """The parts of one body, under one frame, and where it was put last."""

    frame: viser.FrameHandle
    at: tuple[Array, Array]


class SceneView:
    """Shows samples of one run; a scenario with another scene needs another view.

    Args:
        server: of the pages. scenario: the experiment. replay: places its scene. first: the first sample.

    Attributes:
        reach_m: a length that suits the scene, for gizmos [m].
    """

    def __init__(self, server: viser.ViserServer, scenario: Scenario, replay: Replay, first: Sample):
        self._scene, self._scenario, self._replay = server.scene, scenario, replay
        film = first.film
        ends = [film.T_world_target, *([] if first.T_world_goal is None else [first.T_world_goal])]
        far = max(float(np.linalg.norm(T[:3, 3] - film.T_world_camera[:3, 3])) for T in ends)
        self.reach_m = float(np.clip((REACH_OF_ROOM if scenario.target.on_gripper else REACH) * far, SHORTEST_M, LONGEST_M))
        self._scene.reset()
        self._light()
        self._floor()
        self._bodies = self._solids()
        self._trail, self._spacing = np.zeros((0, 3)), self.reach_m / 12
        self._trail_lines = self._scene.add_line_segments("/trail", np.zeros((1, 2, 3)), OWN, thickness=2.5, thickness_units="screen")
        self._eye = self._frustum("/camera", OWN)
        self._goal = self._frustum("/goal", GOAL) if not scenario.target.on_gripper else None
        self._ghost = self._made_ghost(first)
        self.plate: viser.MeshHandle | None = None
        self._look_at(server, film.t, first.T_world_goal)

    def show(self, sample: Sample, image: Image | None) -> None:
        """Put everything where it is in a sample. image: the camera's picture for its frustum, if there is a new one."""
        film = sample.film
        xpos, xquat = self._replay.body_poses(film.t, film.T_world_target, film.q, film.T_world_camera)
        for body, placed in self._bodies.items():
            if not (np.array_equal(xpos[body], placed.at[0]) and np.array_equal(xquat[body], placed.at[1])):
                placed.at = xpos[body].copy(), xquat[body].copy()
                placed.frame.position, placed.frame.wxyz = placed.at
        _put(self._eye, film.T_world_camera)
        if image is not None:
            self._eye.image = image
        if self._goal is not None:
            self._goal.visible = sample.T_world_goal is not None
        if sample.T_world_goal is not None:
            if self._goal is not None:
                _put(self._goal, sample.T_world_goal)
            if self._ghost is not None:
                at = sample.T_world_goal
                _put(self._ghost, film.T_world_camera @ inverse(at) @ film.T_world_target if self._scenario.target.on_gripper else at)

    def clear(self) -> None:
        """Forget the trail."""
        self._trail = np.zeros((0, 3))
        self._trail_lines.points = np.zeros((1, 2, 3), np.float32)

    def draw_trail(self) -> None:
        """Send the trail, which need not be done with every sample."""
        if len(self._trail) > 1:
            self._trail_lines.points = np.stack([self._trail[:-1], self._trail[1:]], axis=1).astype(np.float32)

    def put_plate(self, T_world_plate: Array | None, edge_m: float) -> None:
        """Show the plate in reserve at a pose (4, 4), or not at all."""
        if self.plate is not None and T_world_plate is None:
            self.plate.remove()
            self.plate = None
        if T_world_plate is not None and self.plate is None:
            half = edge_m / 2
            corners = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
            faces = np.array([[0, 1, 2], [0, 2, 3]])
            self.plate = self._scene.add_mesh_simple("/plate", corners, faces, color=PLATE_GREY, side="double")
        if T_world_plate is not None and self.plate is not None:
            _put(self.plate, T_world_plate)

    def _light(self) -> None:
        self._scene.set_background_image(np.full((2, 2, 3), SKY, np.uint8))
        self._scene.configure_default_lights(enabled=False)
        self._scene.configure_environment_map(None)
        self._scene.add_light_ambient("/lights/all", intensity=AMBIENT)
        for name, direction, intensity in LIGHTS:
            self._scene.add_light_directional(f"/lights/{name}", intensity=intensity, position=direction, cast_shadow=False)

    def _floor(self) -> None:
        z = self._scenario.world.floor_z
        half = FLOOR_M / 2
        corners = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
        faces = np.array([[0, 1, 2], [0, 2, 3]])
        self._scene.add_mesh_simple("/floor", corners, faces, color=FLOOR, side="double", position=(0, 0, z - 2 * LAYER_M))
        grid = {"cell_size": 1.0, "section_size": 5.0, "cell_color": LINES, "section_color": LINES}
        self._scene.add_grid("/grid", GRID_M, GRID_M, plane="xy", position=(0, 0, z - LAYER_M), **grid)

    def _solids(self) -> dict[int, _Placed]:
        bodies: dict[int, _Placed] = {}
        nowhere = np.full(3, np.nan), np.full(4, np.nan)
        solids, panes = self._replay.solids, self._replay.panes
        for body in dict.fromkeys(part.body for part in (*solids, *panes)):
            bodies[body] = _Placed(self._scene.add_frame(f"/body_{body}", show_axes=False), nowhere)
        for i, solid in enumerate(solids):
            color = np.rint(255 * np.array(solid.rgb)).astype(np.uint8)
            self._scene.add_mesh_simple(
                f"/body_{solid.body}/{i}", solid.vertices, solid.faces, color=color, side="double", flat_shading=True
            )
        for i, pane in enumerate(panes):
            shown = self._scene.add_image(f"/body_{pane.body}/print_{i}", pane.image, pane.width, pane.height, cast_shadow=False)
            _put(shown, pane.T_body_pane)
        return bodies

    def _frustum(self, name: str, color: tuple[int, int, int]) -> viser.CameraFrustumHandle:
        corners = np.abs(frustum_corners(self._scenario.camera)).max(axis=0)
        fov = 2 * math.atan(float(corners[1]))
        aspect = float(corners[0] / corners[1])
        return self._scene.add_camera_frustum(name, fov, aspect, scale=self.reach_m, thickness=2.0, thickness_units="screen", color=color)

    def _made_ghost(self, first: Sample) -> viser.FrameHandle | None:
        """What moves, at its goal: a vehicle or a craft, or the target in the gripper; None for an arm or a free camera."""
        robot, target = self._scenario.robot, self._scenario.target
        if first.T_world_goal is None or (robot.base == "fixed" and not target.on_gripper):
            return None
        film = first.film
        xpos, xquat = self._replay.body_poses(film.t, film.T_world_target, film.q, film.T_world_camera)
        names, prefix = self._replay.body_names, "target/" if target.on_gripper else "robot/"
        T_ref = inverse(film.T_world_target if target.on_gripper else film.T_world_camera)
        parts = []
        for solid in self._replay.solids:
            if names[solid.body].startswith(prefix):
                T = np.eye(4)
                T[:3, :3], T[:3, 3] = rotation_from_quaternion(xquat[solid.body]), xpos[solid.body]
                parts.append(transform(T_ref @ T, solid.vertices))
        if not parts:
            return None
        frame = self._scene.add_frame("/ghost", show_axes=False)
        vertices = np.concatenate(parts)
        faces = np.arange(len(vertices)).reshape(-1, 3)
        self._scene.add_mesh_simple("/ghost/solid", vertices, faces, color=GOAL, opacity=GHOST, side="double", cast_shadow=False)
        return frame

    def extend_trail(self, place: Array) -> None:
        """The camera was at a place (3,)."""
        trail = self._trail
        if not len(trail) or np.linalg.norm(place - trail[-1]) >= self._spacing:
            trail = np.vstack([trail, place])
        if len(trail) > PLACES:
            trail, self._spacing = trail[::2], 2 * self._spacing
        self._trail = trail

    def _look_at(self, server: viser.ViserServer, t: float, T_world_goal: Array | None) -> None:
        """The view from which pages look at first: that of the film from outside."""
        T, middle, fovy = self._replay.outside_view(t, T_world_goal)
        camera = server.initial_camera
        camera.position, camera.look_at, camera.fov = tuple(T[:3, 3].tolist()), tuple(middle.tolist()), fovy
        camera.up = (0.0, 0.0, 1.0) if self._scenario.robot.model else tuple((-T[:3, 1]).tolist())  # a free camera's room has no upright
        camera.near = NEAR * float(np.linalg.norm(middle - T[:3, 3]))


def _put(handle: viser.SceneNodeHandle, T: Array) -> None:
    handle.position, handle.wxyz = T[:3, 3], quaternion_wxyz(T[:3, :3])
