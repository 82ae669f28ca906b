"""The page of a run: scene, picture, plots and panel, kept up to date from the thread that
simulates.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from vstestbed.apps.live.run import PICTURE_S, Sample
from vstestbed.core.geometry import (
    Array,
    inverse,
    pose_from,
    quaternion_wxyz,
    transform,
)
from vstestbed.imaging.chain import scaled
from vstestbed.report.marks import AXIS_COLORS, LINE_COLORS
from vstestbed.report.video.film import Pictures
from vstestbed.report.video.outside import GOAL, OWN, frustum_corners
from vstestbed.report.video.writer import Image
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.replay import Replay

FLOOR, LINES, SKY = (74, 92, 115), (98, 117, 141), (190, 202, 216)
FLOOR_M, GRID_M = 400.0, 60.0  # edges of the floor, and of the part of it with lines [m]
LIGHTS = (("key", (-2.0, -3.0, 4.0), 1.7), ("fill", (3.0, 2.0, 1.0), 0.6))
SHORTEST_M, LONGEST_M = 0.06, 0.6  # of the frustum
# distance of the grid under the floor of the simulation, and of the surface under the grid [m]
LAYER_M = 0.004
GHOST = 0.3  # opacity of the robot, or the target in the gripper, at its goal
PLACES = 400  # points of the trail: when there are more, every other one is dropped


class SceneView:
    """Shows samples of one run; a scenario with another scene needs another view. reach_m: a length
    that suits the scene [m].
    """

    def __init__(
        self, server: viser.ViserServer, scenario: Scenario, replay: Replay, first: Sample
    ):
        self._scene = server.scene
        self._scenario = scenario
        self._replay = replay
        film = first.film
        aside = scenario.target.on_gripper
        ends = [film.T_world_target]
        if first.T_world_goal is not None:
            ends.append(first.T_world_goal)
        far = max(float(np.linalg.norm(T[:3, 3] - film.T_world_camera[:3, 3])) for T in ends)
        # a camera that stands in the room may be nearer to the viewer than the robot, and must not
        # hide it
        share = 0.05 if aside else 0.13
        self.reach_m = float(np.clip(share * far, SHORTEST_M, LONGEST_M))
        self._scene.reset()
        self._surroundings()
        self._bodies = self._solids()
        self._poses: Array | None = None  # of all bodies as they were put last (B, 7)
        self._trail = np.zeros((0, 3))
        self._spacing = self.reach_m / 12
        self._trail_lines = self._scene.add_line_segments(
            "/trail", np.zeros((1, 2, 3)), OWN, thickness=2.5, thickness_units="screen"
        )
        self._eye = self._frustum("/camera", OWN)
        self._goal = self._frustum("/goal", GOAL) if not aside else None
        self._ghost = self._made_ghost(first)
        self.plate: viser.MeshHandle | None = None
        T, middle, fovy = replay.outside_view(film.t, first.T_world_goal)
        view = server.initial_camera
        view.position = tuple(T[:3, 3].tolist())
        view.look_at = tuple(middle.tolist())
        view.fov = fovy
        # a free camera's room has no upright
        view.up = (0.0, 0.0, 1.0) if scenario.robot.body else tuple((-T[:3, 1]).tolist())
        # the depth buffer must tell lines on the floor from the floor
        view.near = 0.02 * float(np.linalg.norm(middle - T[:3, 3]))

    def show(self, sample: Sample, image: Image | None) -> None:
        """Put everything where it is in a sample. image: the camera's picture for its frustum, if
        there is a new one.
        """
        film = sample.film
        xpos, xquat = self._replay.body_poses(
            film.t, film.T_world_target, film.q, film.T_world_camera
        )
        poses = np.hstack([xpos, xquat])
        for body, frame in self._bodies.items():
            if self._poses is None or not np.array_equal(poses[body], self._poses[body]):
                frame.position, frame.wxyz = poses[body, :3], poses[body, 3:]
        self._poses = poses
        _put(self._eye, film.T_world_camera)
        if image is not None:
            self._eye.image = image
        at = sample.T_world_goal
        if self._goal is not None:
            self._goal.visible = at is not None
            if at is not None:
                _put(self._goal, at)
        if self._ghost is not None and at is not None:
            if self._scenario.target.on_gripper:
                at = film.T_world_camera @ inverse(at) @ film.T_world_target
            _put(self._ghost, at)

    def clear(self) -> None:
        """Forget the trail."""
        self._trail = np.zeros((0, 3))
        self._trail_lines.points = np.zeros((1, 2, 3), np.float32)

    def draw_trail(self) -> None:
        """Send the trail, which need not be done with every sample."""
        if len(self._trail) > 1:
            lines = np.stack([self._trail[:-1], self._trail[1:]], axis=1)
            self._trail_lines.points = lines.astype(np.float32)

    def put_plate(self, T_world_plate: Array | None, edge_m: float) -> None:
        """Show the plate in reserve at a pose (4, 4), or not at all."""
        if T_world_plate is not None:
            self.plate = self.plate or self._scene.add_mesh_simple(
                "/plate", *_square(edge_m), color=(115, 115, 120), side="double"
            )
            _put(self.plate, T_world_plate)
        elif self.plate is not None:
            self.plate.remove()
            self.plate = None

    def _surroundings(self) -> None:
        self._scene.set_background_image(np.full((2, 2, 3), SKY, np.uint8))
        self._scene.configure_default_lights(enabled=False)
        self._scene.configure_environment_map(None)
        self._scene.add_light_ambient("/lights/all", intensity=1.2)
        for name, direction, intensity in LIGHTS:
            self._scene.add_light_directional(
                f"/lights/{name}", intensity=intensity, position=direction, cast_shadow=False
            )
        z = self._scenario.world.floor_z
        self._scene.add_mesh_simple(
            "/floor",
            *_square(FLOOR_M),
            color=FLOOR,
            side="double",
            position=(0, 0, z - 2 * LAYER_M),
        )
        grid = {"cell_size": 1.0, "section_size": 5.0, "cell_color": LINES, "section_color": LINES}
        self._scene.add_grid(
            "/grid", GRID_M, GRID_M, plane="xy", position=(0, 0, z - LAYER_M), **grid
        )

    def _solids(self) -> dict[int, viser.FrameHandle]:
        """A frame for each body that has something to be seen, by number, with its solids and panes
        below it.
        """
        bodies: dict[int, viser.FrameHandle] = {}
        solids = self._replay.solids
        panes = self._replay.panes
        for body in dict.fromkeys(part.body for part in (*solids, *panes)):
            bodies[body] = self._scene.add_frame(f"/body_{body}", show_axes=False)
        for i, solid in enumerate(solids):
            self._scene.add_mesh_simple(
                f"/body_{solid.body}/{i}",
                solid.vertices,
                solid.faces,
                color=np.rint(255 * np.array(solid.rgb)).astype(np.uint8),
                side="double",
                flat_shading=True,
            )
        for i, pane in enumerate(panes):
            shown = self._scene.add_image(
                f"/body_{pane.body}/print_{i}",
                pane.image,
                pane.width,
                pane.height,
                cast_shadow=False,
            )
            _put(shown, pane.T_body_pane)
        return bodies

    def _frustum(self, name: str, color: tuple[int, int, int]) -> viser.CameraFrustumHandle:
        corners = np.abs(frustum_corners(self._scenario.camera)).max(axis=0)
        fov = 2 * math.atan(float(corners[1]))
        aspect = float(corners[0] / corners[1])
        return self._scene.add_camera_frustum(
            name,
            fov,
            aspect,
            scale=self.reach_m,
            thickness=2.0,
            thickness_units="screen",
            color=color,
        )

    def _made_ghost(self, first: Sample) -> viser.FrameHandle | None:
        """What moves, at its goal: a vehicle or a craft, or the target in the gripper; None for an
        arm or a free camera.
        """
        held = self._scenario.target.on_gripper
        if first.T_world_goal is None or (self._scenario.robot.base == "fixed" and not held):
            return None
        film = first.film
        xpos, xquat = self._replay.body_poses(
            film.t, film.T_world_target, film.q, film.T_world_camera
        )
        prefix = "target/" if held else "robot/"
        T_ref = inverse(film.T_world_target if held else film.T_world_camera)
        parts = []
        for solid in self._replay.solids:
            if self._replay.body_names[solid.body].startswith(prefix):
                T = pose_from(xpos[solid.body], xquat[solid.body])
                parts.append(transform(T_ref @ T, solid.vertices))
        if not parts:
            return None
        frame = self._scene.add_frame("/ghost", show_axes=False)
        vertices = np.concatenate(parts)
        faces = np.arange(len(vertices)).reshape(-1, 3)
        self._scene.add_mesh_simple(
            "/ghost/solid",
            vertices,
            faces,
            color=GOAL,
            opacity=GHOST,
            side="double",
            cast_shadow=False,
        )
        return frame

    def extend_trail(self, place: Array) -> None:
        """The camera was at a place (3,)."""
        trail = self._trail
        if not len(trail) or np.linalg.norm(place - trail[-1]) >= self._spacing:
            trail = np.vstack([trail, place])
        if len(trail) > PLACES:
            trail = trail[::2]
            self._spacing *= 2
        self._trail = trail


def _square(edge_m: float) -> tuple[Array, Array]:
    corners = edge_m / 2 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def _put(handle: viser.SceneNodeHandle, T: Array) -> None:
    handle.position = T[:3, 3]
    handle.wxyz = quaternion_wxyz(T[:3, :3])


WIDTH, EYE_HEIGHT = 400, 320  # the picture in the panel is at most as large [px]


class Eye:
    """The picture of a run. gui: where it is added, in the container that is open. replay: draws
    what the run did not.
    """

    def __init__(self, gui: viser.GuiApi, scenario: Scenario, replay: Replay):
        camera = scenario.camera
        share = min(WIDTH / camera.width, EYE_HEIGHT / camera.height, 1.0)
        width = max(16, round(share * camera.width))
        self._own_height = height = max(16, round(share * camera.height))
        for eye in scenario.eyes.values():  # below each other
            height += round(width * eye.camera.height / eye.camera.width)
        self._size = width, height
        self._scenario = scenario
        self._replay = replay
        self._pictures = Pictures(scenario, "eye", replay, self._size)
        blank = np.full((height, width, 3), 60, np.uint8)
        self._shown = gui.add_image(
            blank,
            label=" \u00b7 ".join(("servo camera", *scenario.cameras)),
            format="jpeg",
            jpeg_quality=70,
        )

    def draw(self, sample: Sample) -> Image:
        """Send the picture of a sample; returns a small one, at most 160 px wide,
        for the frustum.
        """
        image = self._pictures.picture(sample.film)
        self._shown.image = image
        image = image[: self._own_height]  # without further cameras
        share = min(1.0, 160 / image.shape[1])
        return scaled(image, (round(share * image.shape[1]), round(share * image.shape[0])))

    def clear(self) -> None:
        """Forget the trails."""
        self._pictures = Pictures(self._scenario, "eye", self._replay, self._size)

    def remove(self) -> None:
        """Take the picture away."""
        self._shown.remove()


# Points of a curve: when there are more, every other one is dropped, so that the whole run stays in
# sight
MOST = 1200
PLOT_HEIGHT = 150  # of a plot [px]
THIN: dict[str, Any] = {
    "font": "11px sans-serif",
    "ticks": {"size": 4, "width": 1},
    "grid": {"width": 1, "stroke": "#e3e6ea"},
}
AXES: tuple[Any, ...] = ({"size": 26, **THIN}, {"size": 46, **THIN})


class Plots:
    """The plots of a run. gui: where they are added, in the container that is open. unit: of the
    judged error.
    """

    def __init__(self, gui: viser.GuiApi, scenario: Scenario, unit: str):
        self._joints = joints = len(scenario.robot.joints)
        self._rows = np.empty((MOST, 8 + joints))  # time, error, twist, joints
        self.clear()
        self._error = _plot(gui, f"judged error [{unit}]", ["error"], [LINE_COLORS[0]], log=True)
        key = " · ".join(
            f'<span style="color:{color}">{axis}</span>'
            for axis, color in zip("xyz", AXIS_COLORS, strict=True)
        )
        self._key = gui.add_html(
            '<div style="font-size:12px;text-align:center">'
            f"commanded twist: {key} of the camera</div>"
        )
        self._v = _plot(gui, "commanded speed [m/s]", ["vx", "vy", "vz"], AXIS_COLORS)
        self._w = _plot(gui, "commanded rate [rad/s]", ["wx", "wy", "wz"], AXIS_COLORS)
        names = list(scenario.robot.joints)
        self._q = None
        if joints:
            colors = [LINE_COLORS[i % len(LINE_COLORS)] for i in range(joints)]
            self._q = _plot(gui, "joints [rad]", names, colors)

    def add(self, sample: Sample) -> None:
        """One more frame; only every k-th is kept once the run is long."""
        self._skipped += 1
        if self._skipped < self._every:
            return
        self._skipped = 0
        if self._count == MOST:
            self._count = MOST // 2
            self._rows[: self._count] = self._rows[::2].copy()
            self._every *= 2
        positive = sample.judged if sample.judged > 0 else np.nan  # logarithmic
        q = sample.film.q[: self._joints]
        self._rows[self._count] = sample.film.t, positive, *sample.twist, *q
        self._count += 1

    def clear(self) -> None:
        """Begin anew."""
        self._count = self._skipped = 0
        self._every = 1

    def draw(self) -> None:
        """Send the curves, which need not be done with every frame."""
        t, error, *rest = (np.ascontiguousarray(column) for column in self._rows[: self._count].T)
        if len(t) < 2:
            return
        self._error.data = t, error
        self._v.data = t, *rest[:3]
        self._w.data = t, *rest[3:6]
        if self._q is not None:
            self._q.data = t, *rest[6:]

    def remove(self) -> None:
        """Take the plots away."""
        for plot in (self._error, self._key, self._v, self._w, self._q):
            if plot is not None:
                plot.remove()


def _plot(
    gui: viser.GuiApi, title: str, names: list[str], colors: Any, log: bool = False
) -> viser.GuiUplotHandle:
    t = np.array([0.0, 1.0])
    series: list[Any] = [{"label": "t [s]"}]
    series += [
        {"label": name, "stroke": color, "width": 1.5, "points": {"show": False}}
        for name, color in zip(names, colors, strict=False)
    ]
    scales: dict[str, Any] = {"x": {"time": False}, "y": {"distr": 3 if log else 1}}
    blank = np.full(2, np.nan)
    return gui.add_uplot(
        (t, *(blank for _ in names)),
        tuple(series),
        title=title,
        scales=scales,
        axes=AXES,
        legend={"show": False},
        height=PLOT_HEIGHT,
        padding=(10, 12, 0, 0),
    )


SCENE_S, PLOTS_S = 1 / 30, 1 / 4
"""Least time on the wall between two updates of the scene, of plots [s]; of picture and words:
`live.run`.
"""
VIEW_WIDTH = 340  # of the panel beside the scene [px]


class LiveView:
    """What pages show of a run besides its panel: scene, picture and plots. recorded: pictures are
    drawn again.
    """

    def __init__(
        self, server: viser.ViserServer, scenario: Scenario, first: Sample, recorded: bool = False
    ):
        self._server = server
        self._recorded = recorded
        panel = server.gui.add_panel()
        self._tab = panel.add_tab("camera and curves")
        panel.dock_left()
        panel.set_width(VIEW_WIDTH)
        self._made_at: dict[str, float] = {}
        self._replay: Replay | None = None
        self._scenario = scenario
        self._build(first)

    def _build(self, first: Sample) -> None:
        if self._replay is not None:
            self._replay.close()
            self.eye.remove()
            self.plots.remove()
        scenario = self._scenario
        self._unit = first.unit
        # the servo camera makes pictures as large as they are shown
        share = min(1.0, WIDTH / scenario.camera.width)
        self._replay = Replay(scenario.scene, shadows=False, share=share)
        self.scene = SceneView(self._server, scenario, self._replay, first)
        with self._tab:
            self.eye = Eye(self._server.gui, scenario, self._replay)
            self.plots = Plots(self._server.gui, scenario, first.unit)

    def restart(self, scenario: Scenario, first: Sample) -> bool:
        """Begin anew; whether the scene is another one, so that all that others put into it is
        gone.
        """
        now, before = (
            (s.robot, s.camera, s.target, getattr(s.target_in_run.sheet, "png", None), s.world)
            for s in (scenario, self._scenario)
        )
        other = now != before or first.unit != self._unit
        self._scenario = scenario
        if other:
            self._build(first)
        else:
            self.forget()
        return other

    def forget(self) -> None:
        """Begin curves and trails anew."""
        self.eye.clear()
        self.plots.clear()
        self.scene.clear()

    def add(self, sample: Sample) -> None:
        """A frame was made, whether it is drawn or not."""
        self.plots.add(sample)
        self.scene.extend_trail(sample.film.T_world_camera[:3, 3])

    def draw(self, sample: Sample, tell: Callable[[], None], now: bool = False) -> None:
        """Send what is due; `now`: everything. tell: writes what the page says of the sample, which
        goes with its picture alone.
        """
        if not self._server.get_clients() and not now:  # nobody looks
            return
        pictured = now or sample.film.image is not None
        if not pictured and self._recorded:
            pictured = self._due("picture", PICTURE_S)
        if pictured:
            with self._server.atomic():
                self.scene.show(sample, self.eye.draw(sample))
                tell()
        elif self._due("scene", SCENE_S):
            with self._server.atomic():
                self.scene.show(sample, None)
        if now or self._due("plots", PLOTS_S):
            self.plots.draw()
            self.scene.draw_trail()

    def _due(self, what: str, period_s: float) -> bool:
        """Whether something was not sent for a while; it is to be sent now."""
        t = time.monotonic()
        if t - self._made_at.get(what, -np.inf) < period_s:
            return False
        self._made_at[what] = t
        return True

    def close(self) -> None:
        """Free the scene."""
        if self._replay is not None:
            self._replay.close()


def add_gizmo(
    server: viser.ViserServer, name: str, T: Array, size_m: float, dragged: Callable[[Array], None]
) -> viser.TransformControlsHandle:
    """A handle in the scene at which something is dragged. T: pose (4, 4). dragged: called with the
    pose, from another thread.
    """
    wxyz = quaternion_wxyz(T[:3, :3])
    handle = server.scene.add_transform_controls(
        name, scale=size_m, position=T[:3, 3], wxyz=wxyz, depth_test=False
    )

    async def moved(event: Any) -> None:
        if event.client is not None:
            dragged(pose_from(np.array(event.target.position), np.array(event.target.wxyz)))

    handle.on_update(moved)
    return handle
