"""Composes world, robot, camera and target into one MuJoCo model with MjSpec, under prefixes.

Names: joints and actuators `robot/joint_1`, ..., the servo camera `eye` (site `eye` has its
computer-vision axes; a lens that sees more than one pinhole picture holds has `eye_right`,
`eye_left`, `eye_up`, `eye_down`, `eye_back` at the same place), the outside view `overview`, the
target's body `target/frame` (mocap), its markers sites `target/marker_0`, `target/marker_1`, ...
(of lines on the floor, which have no places of their own, only geoms `target/line_0`, ...), plates
`plate_0`, ..., a vehicle that carries the target `leader/...`, scenery `scenery/...`. Geom groups:
0 the room, 1 geoms that enclose the lens (not rendered by the servo camera, which in the textbook's
scene sits at the wrist's centre, inside the hand), 2 the robot, 3 the target, 5 what range finders
alone meet.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from vstestbed.camera import Camera
from vstestbed.core.geometry import FLIP, Array, quaternion_wxyz, transform
from vstestbed.core.named_files import model_path
from vstestbed.effects.tool import SOFT_S
from vstestbed.sim.base import SceneDescription
from vstestbed.sim.render.cube_map import drawn_for
from vstestbed.sim.scene.attach import add_robot, extent_of
from vstestbed.sim.scene.meshes import (
    FACE_VIEWER,
    GLOW,
    HAND_PLATE,
    LENS_GROUP,
    ROBOT_GROUP,
    SITE_GROUP,
    TARGET_GROUP,
)
from vstestbed.sim.scene.model_files import ASSETS, lay_picture
from vstestbed.sim.scene.overview import frame_drive, frame_flight
from vstestbed.sim.scene.scenery import add_scenery
from vstestbed.sim.scene.world import AWAY, LAMP, Floor, Light, WindowPane, World
from vstestbed.targets import Target
from vstestbed.targets.base import Body, Socket
from vstestbed.targets.markers import Solid, thin
from vstestbed.targets.mesh import as_stl
from vstestbed.targets.picture import SHARE, PictureTarget, place_of_picture, read_tile
from vstestbed.vision.tags import printed

# Of a glossy picture, in MuJoCo's unit: the highlight of a lamp falls as cos^64, to a half at 8
# degrees
SHININESS = 0.5
# Height of the paint over the floor, against z-fighting [m]: seen from .3 m up at 60 degrees, it
# appears .35 mm too far out
LIFT_M = 2e-4
# Facets of a ball from pole to pole, and twice as many round it: its outline is within 2e-4 of its
# radius
FACETS = 90
# Samples of the route, a centimetre apart, in a segment: its chord deviates from a bend of 2 m
# radius by .1 mm
SEGMENT = 4


def add_stripe(
    scene: mujoco.MjSpec,
    body: mujoco.MjsBody,
    edges: tuple[Array, Array],
    i: int,
    rgb: Array,
    lit: bool,
) -> None:
    """Line i between its edges (K, 2) as a geom of `body`: a strip of triangles, visible from
    above, without collisions.
    """
    paint = _paint(scene, f"color_{i}", rgb, lit)
    left, right = edges
    kept = np.unique(np.append(np.arange(0, len(left), SEGMENT), len(left) - 1))
    n = len(kept)
    vertices = np.full((2 * n, 3), LIFT_M)
    vertices[0::2, :2] = left[kept]
    vertices[1::2, :2] = right[kept]
    at = 2 * np.arange(n - 1)[:, None]
    faces = np.concatenate([at + [0, 1, 2], at + [1, 3, 2]])  # counter-clockwise from above
    mesh = scene.add_mesh(
        name=f"target/line_{i}", uservert=vertices.ravel(), userface=faces.ravel()
    )
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # a sheet has no volume
    geom = _painted(body, mesh.name, mujoco.mjtGeom.mjGEOM_MESH, [0, 0, 0], paint)
    geom.meshname = mesh.name


def add_sheet(
    scene: mujoco.MjSpec, body: mujoco.MjsBody, sheet: PictureTarget, front: float
) -> float:
    """A picture with its face at z = front in the target's frame; where its back is [m]."""
    paint = _paint(scene, "picture", np.full(3, sheet.albedo), sheet.lit)
    paint.specular = sheet.gloss
    paint.shininess = SHININESS
    paint.texrepeat = SHARE, SHARE
    lay_picture(scene, paint, "target/picture", "target_picture.png", sheet.png)
    half = thin(sheet.width)
    size = [sheet.width / 2, sheet.height / 2, half]
    geom = _painted(body, "target/picture", GEOMS["box"], size, paint)
    geom.pos = [0, 0, front + half]
    geom.quat = FACE_VIEWER
    return front + 2 * half


def add_body(scene: mujoco.MjSpec, body: mujoco.MjsBody, solid: Body) -> None:
    """A target's solid, without collisions. MuJoCo smooths the shading of curved surfaces."""
    shape, rgb, lit = solid
    paint = _paint(scene, "solid", np.array(rgb), lit)
    if not isinstance(shape, np.ndarray):
        # Its outline is measured: with MuJoCo's own 28 facets round the equator it would be a
        # polygon .6 % of the radius too small.
        scene.visual.quality.numslices = 2 * FACETS
        scene.visual.quality.numstacks = FACETS
        _painted(body, "target/solid", GEOMS["sphere"], [shape, 0, 0], paint)
        return
    scene.meshdir = ASSETS
    scene.assets = {**scene.assets, f"{ASSETS}/target_solid.stl": as_stl(shape)}
    mesh = scene.add_mesh(name="target/solid", file="target_solid.stl")
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # it need not be closed
    geom = _painted(body, mesh.name, mujoco.mjtGeom.mjGEOM_MESH, [0, 0, 0], paint)
    geom.meshname = mesh.name


HOUSING_M = 0.03  # distance of the camera housing's centre behind the lens [m]
# how far the housing of a camera in the room is moved back, so that the lens's picture does not
# show it [m]
BEHIND_LENS_M = 0.03
POST_RADIUS_M = 0.012  # a tube of 24 mm, anodised
POST_GREY = [0.5, 0.51, 0.53, 1.0]
PLATE_HALF_M = 0.002  # half of a plate's thickness [m]
PLATE_GREY = [0.45, 0.45, 0.47, 1]
# The free camera's housing is drawn this many times as large as the arm's: it is seen from farther
# away
FREE_HOUSING = 6.0
# a start farther than this and nearer than that leaves the planes as they are [m]
NEAR_START_M = 0.5
FAR_START_M = 25.0
GEOMS = {
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
}
DECOYS = {"ball": "sphere", "disc": "cylinder", "box": "box"}
PAD_HALF_M = 0.01  # half of a landing pad's thickness [m]
PAD_FRICTION = [0.8, 0.005, 0.0001]  # rubber feet on a painted plate, as on a hard floor
# How far a board is behind a flat region, which has no thickness [m]: nearer, OpenGL could mix the
# two far away
BEHIND_SHEET_M = 1e-3
# flat insides of a socket's hole, and half the thickness of its bottom [m]
SOCKET_SIDES = 32
SOCKET_BOTTOM_M = 0.002
# Pixel pitch that MuJoCo's camera is given [m]; it drops out, since focal length and principal
# point are in pixels
PITCH_M = 1e-5


def compose(parts: SceneDescription) -> mujoco.MjSpec:
    """The scene of these parts, ready to compile or to write as XML."""
    scene = mujoco.MjSpec.from_file(str(model_path("world.xml")))
    scene.modelname = "scene"
    scene.option.timestep = parts.step
    scene.compiler.degree = False
    for plane in ("floor", "ground"):
        scene.geom(plane).pos = [0, 0, parts.world.floor_z]
    scenery = parts.world.scenery
    carried: dict[str, bytes] = {}
    if scenery:
        carried = add_scenery(scene, scenery.file, scenery.pose.T, parts.world.floor_z)
    friction = parts.world.floor_friction
    body, T_body_flange = add_robot(scene, parts.robot, "robot/", friction, carried)
    housing = 1.0
    if parts.robot.body is None:
        # A target round the camera, which begins within it, is one of a metre.
        away = float(np.linalg.norm(parts.start[1][:3, 3] - parts.T_world_target[:3, 3])) or 1.0
        housing = FREE_HOUSING * min(1.0, away)
        _fit_planes(scene, away)
    if parts.target.on_gripper:
        _show_hand(scene)
        _add_camera(scene.worldbody, parts.camera.mount.T, parts.camera, housing)
        _add_target(scene, parts.target, body, T_body_flange @ parts.target.pose.T)
    else:
        _add_camera(body, T_body_flange @ parts.camera.mount.T, parts.camera, housing)
        if parts.robot.base == "planar":
            _add_post(body, scene.geom("robot/deck"), T_body_flange @ parts.camera.mount.T)
        carrier = None
        if parts.leader:
            carrier, _ = add_robot(scene, parts.leader, "leader/", friction, carried)
        _add_target(scene, parts.target, carrier, parts.target.pose.T)
    for other in parts.others:
        lens = other.camera
        T = lens.mount.T
        if other.stands:
            _add_camera(scene.worldbody, T, lens, housing, other.name, ROBOT_GROUP)
        else:
            _add_camera(body, T_body_flange @ T, lens, housing, other.name)
    _frame_overview(scene, parts)
    _add_plates(scene, parts)
    light_scene(scene, parts.world, parts.glossy)
    # last: MuJoCo warns of models that are attached to one with assets
    scene.assets = {**scene.assets, **carried}
    return scene


def _fit_planes(scene: mujoco.MjSpec, away: float) -> None:
    """Planes between which the ideal camera sees, `away` [m] from its target at the start.

    Nearer and farther ones than NEAR_START_M to FAR_START_M take them along, by powers of two,
    which move no point of an image. (The lens of an arm's camera lies within the wrist, which would
    be seen.)
    """
    planes = scene.visual.map
    ratio = away / np.array([NEAR_START_M, FAR_START_M])
    factor = 2.0 ** (min(0.0, np.floor(np.log2(ratio[0]))) + max(0.0, np.ceil(np.log2(ratio[1]))))
    planes.znear *= factor  # both: of a near plane alone the sky would be black
    planes.zfar *= factor


def _add_plates(scene: mujoco.MjSpec, parts: SceneDescription) -> None:
    for i, plate in enumerate(parts.world.plates):
        # Mocap bodies are moved by writing their pose: no joint, no dynamics. Until it is present,
        # a plate is out of sight.
        holder = scene.worldbody.add_body(
            name=f"plate_{i}", mocap=True, pos=AWAY, quat=quaternion_wxyz(plate.pose.T[:3, :3])
        )
        size = [plate.width / 2, plate.height / 2, PLATE_HALF_M]
        _visual(holder, f"plate_{i}", GEOMS["box"], size, PLATE_GREY, 0)
    if half := parts.plate_m / 2:
        holder = scene.worldbody.add_body(name=HAND_PLATE, mocap=True, pos=AWAY)
        _visual(holder, HAND_PLATE, GEOMS["box"], [half, half, PLATE_HALF_M], PLATE_GREY, 0)
    for i, decoy in enumerate(parts.world.distractors):
        name = f"decoy_{i}"
        kind = GEOMS[DECOYS[decoy.shape]]
        holder = scene.worldbody.add_body(name=name, mocap=True, pos=decoy.xyz)
        _visual(holder, name, kind, decoy.half_sizes, [*decoy.color, 1], 0)


def _show_hand(scene: mujoco.MjSpec) -> None:
    """Eye to hand: render the geoms round the wrist, and remove the camera that is drawn there."""
    for geom in list(scene.geoms):
        if geom.group == LENS_GROUP and geom.name.startswith("robot/"):
            if "camera" in geom.name:
                # Its contact pairs first: a pair with a missing geom does not compile.
                for pair in [p for p in scene.pairs if geom.name in (p.geomname1, p.geomname2)]:
                    scene.delete(pair)
                scene.delete(geom)
            else:
                geom.group = ROBOT_GROUP


def _frame_overview(scene: mujoco.MjSpec, parts: SceneDescription) -> None:
    """Fit the outside view to the path of a moving base; world.xml's own view shows an arm at the
    origin.
    """
    robot = parts.robot
    target = parts.target
    if robot.body is None:
        frame_flight(scene, robot, target)
    elif robot.base != "fixed":
        start = robot.flange_pose(robot.configuration())[:3, 3]
        sights = transform(target.T_world_start, target.points)
        frame_drive(scene, np.array([start, *parts.sights]), sights, extent_of(robot))


def _add_camera(
    body: mujoco.MjsBody,
    T_body_camera: Array,
    camera: Camera,
    housing: float,
    eye: str = "eye",
    group: int = LENS_GROUP,
) -> None:
    """The servo camera `eye` (MuJoCo axes), or a further one, the site `eye` (computer-vision
    axes), and a visible housing of 5 cm times `housing`, which in a group that the camera itself
    sees lies behind the lens.

    A lens that sees beyond a plane has a camera for each face of the cube that it sees: `eye`
    ahead, `eye_right`, ...
    """
    at = _at(T_body_camera)
    for view in drawn_for(camera, eye):
        T_camera_view = np.eye(4)
        T_camera_view[:3, :3] = view.R_camera_face
        body.add_camera(
            name=view.name,
            **_at(T_body_camera @ T_camera_view @ FLIP),
            resolution=[view.width, view.height],
            sensor_size=[view.width * PITCH_M, view.height * PITCH_M],
            focal_pixel=[view.f, view.f],
            # cx = W/2 - 0.5 - principal_pixel_x: MuJoCo counts from the image's middle, and pixel
            # centres are at whole numbers here
            principal_pixel=[
                view.width / 2 - 0.5 - view.centre[0],
                view.height / 2 - 0.5 - view.centre[1],
            ],
        )
    body.add_site(name=eye, **at, group=SITE_GROUP, size=[0.005] * 3)
    box = [0.025, 0.02, 0.03]
    glass = [0.013, 0.012, 0]
    back = 0.0 if group == LENS_GROUP else BEHIND_LENS_M
    for name, kind, size, grey, along in (
        (f"{eye}_box", mujoco.mjtGeom.mjGEOM_BOX, box, 0.17, -HOUSING_M),
        (f"{eye}_lens", mujoco.mjtGeom.mjGEOM_CYLINDER, glass, 0.3, 0.012),
    ):
        sides = [x * housing for x in size]
        geom = _visual(body, name, kind, sides, [grey, grey, grey, 1], group)
        geom.pos = at["pos"] + T_body_camera[:3, 2] * ((along - back) * housing)
        geom.quat = at["quat"]


def _add_post(body: mujoco.MjsBody, deck: mujoco.MjsGeom | None, T_body_camera: Array) -> None:
    """The post of a vehicle's camera, from the nearest point of the deck; in LENS_GROUP, which the
    camera does not render.
    """
    if deck is None:  # a vehicle of one's own need not have one
        return
    middle = np.asarray(deck.pos, dtype=float)
    half = np.asarray(deck.size, dtype=float)
    head = T_body_camera[:3, 3] - HOUSING_M * T_body_camera[:3, 2]
    foot = np.clip(head, middle - half, middle + half)
    if np.linalg.norm(head - foot) > POST_RADIUS_M:
        size = [POST_RADIUS_M, 0, 0]
        capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
        post = _visual(body, "eye_post", capsule, size, POST_GREY, LENS_GROUP)
        post.fromto = [*foot, *head]


def _add_target(
    scene: mujoco.MjSpec, target: Target, carrier: mujoco.MjsBody | None, T: Array
) -> None:
    """A body with one site and one geom for each marker, its picture, solid, board or pad; of lines
    on the floor, their paint.

    It is a mocap body in the world, or fixed to its carrier, at the pose T (4, 4) there.
    """
    body = (carrier or scene.worldbody).add_body(
        name="target/frame", mocap=carrier is None, **_at(T)
    )
    # MuJoCo gives the velocity of a site in its own axes, which the truth needs of a target in
    # motion
    if target.on_gripper:
        body.add_site(name="target/frame", group=SITE_GROUP, size=[0.005] * 3)
    points_a_line = len(target.points) // max(len(target.stripes), 1)
    for i, edges in enumerate(target.stripes):
        add_stripe(scene, body, edges, i, target.colors[i * points_a_line], target.marker.lit)
    for i, p in enumerate(target.places):
        body.add_site(name=f"target/marker_{i}", pos=p, group=SITE_GROUP, size=[0.005] * 3)
        if target.draw_markers and (solid := target.marker.solid):
            _add_marker(scene, body, target, i, p, solid)
    if target.body is not None:
        add_body(scene, body, target.body)
    _add_back(scene, body, target)
    if target.socket is not None:
        _add_socket(body, target.socket)


def _add_socket(body: mujoco.MjsBody, socket: Socket) -> None:
    """A tube of boxes, whose flat insides touch a circle of the hole's radius, and its bottom; the
    front of a target collides nowhere else.
    """
    middle = socket.radius + socket.wall / 2
    half = (socket.radius + socket.wall) * math.tan(math.pi / SOCKET_SIDES)
    grey = [0.45, 0.47, 0.5, 1.0]
    friction = [socket.friction, 0.005, 0.0001]

    def add(k: int, at: list[float], size: list[float], angle: float) -> None:
        body.add_geom(
            name=f"target/socket_{k}",
            type=GEOMS["box"],
            size=size,
            pos=at,
            quat=[math.cos(angle / 2), 0, 0, math.sin(angle / 2)],
            rgba=grey,
            group=TARGET_GROUP,
            mass=0,
            friction=friction,
            solref=[SOFT_S, 1.0],
        )

    x, y = socket.xy
    add(0, [x, y, SOCKET_BOTTOM_M], [middle, middle, SOCKET_BOTTOM_M], 0.0)
    for k in range(SOCKET_SIDES):
        angle = 2 * math.pi * k / SOCKET_SIDES
        at = [x + middle * math.cos(angle), y + middle * math.sin(angle), -socket.depth / 2]
        add(k + 1, at, [socket.wall / 2, half, socket.depth / 2], angle)


def _add_back(scene: mujoco.MjSpec, body: mujoco.MjsBody, target: Target) -> None:
    if pad := target.pad:  # the only part of a target that collides
        size = [pad.side / 2, pad.side / 2, PAD_HALF_M]
        body.add_geom(
            name="target/pad",
            type=GEOMS["box"],
            size=size,
            pos=[0, 0, PAD_HALF_M],
            rgba=[0.62, 0.63, 0.62, 1],
            group=TARGET_GROUP,
            mass=pad.weight,
            friction=PAD_FRICTION,
        )
    elif target.board_half_m is not None:
        half = target.board_half_m
        marker = target.marker
        front = (marker.height_m or 1.5 * thin(marker.radius)) if target.draw_markers else 0.0
        front = thin(max(half), BEHIND_SHEET_M) if target.body is not None else front
        if target.sheet is not None:
            front = add_sheet(scene, body, target.sheet, front)
        grey = [0.86, 0.86, 0.85, 1]
        board = _visual(body, "target/board", GEOMS["box"], [*half, 0.01], grey, TARGET_GROUP)
        board.pos = [0, 0, front + 0.01]


def _add_marker(
    scene: mujoco.MjSpec, body: mujoco.MjsBody, target: Target, i: int, p: Array, solid: Solid
) -> None:
    marker = target.marker
    normal = target.normals[i]
    colour = np.full(3, marker.albedo) if marker.textured else target.colors[i]
    paint = _paint(scene, f"color_{i}", colour, marker.lit)
    if marker.textured:
        name, png = printed(marker, i)  # in memory; `scene_files` writes it beside model.xml
        lay_picture(scene, paint, f"target/{name}", f"{name}.png", png)
    shape, half_sizes = solid
    # In a plane the front face of a flat marker lies in z = 0; on a solid it lies on the surface.
    inwards = 0.0
    if not marker.height_m:
        thickness = half_sizes[2] or half_sizes[1]
        inwards = thickness if target.body is None else -thickness
    name = f"target/marker_{i}"
    geom = _painted(body, name, GEOMS[shape], half_sizes, paint)
    geom.pos = p - inwards * normal
    geom.quat = _facing(normal)


def _at(T: Array) -> dict[str, Array]:
    """Position and quaternion of a pose (4, 4), as what is added to a spec takes them."""
    return {"pos": T[:3, 3], "quat": quaternion_wxyz(T[:3, :3])}


def _facing(normal: Array) -> tuple[float, ...]:
    """Quaternion (wxyz) of a frame whose z axis is a unit normal (3,) of the target; FACE_VIEWER
    for markers in the target's plane.
    """
    if normal[2] < -1 + 1e-9:
        return FACE_VIEWER
    # the shortest turn of z: (1 + z . n, z x n)
    turn = np.array([1 + normal[2], -normal[1], normal[0], 0.0])
    return tuple(turn / np.linalg.norm(turn))


def _paint(scene: mujoco.MjSpec, name: str, rgb: Array, lit: bool) -> mujoco.MjsMaterial:
    """The material `target/<name>` of a colour that the scene's lights shade, or of constant
    brightness.
    """
    return scene.add_material(
        name=f"target/{name}",
        rgba=[*(rgb if lit else rgb / GLOW), 1.0],
        specular=0,
        shininess=0,
        emission=0.0 if lit else GLOW,
    )


def _painted(
    body: mujoco.MjsBody, name: str, kind: mujoco.mjtGeom, size: object, paint: mujoco.MjsMaterial
) -> mujoco.MjsGeom:
    """A part of the target: as `_visual`, of a material."""
    geom = _visual(body, name, kind, size, paint.rgba, TARGET_GROUP)
    geom.material = paint.name
    return geom


def _visual(
    body: mujoco.MjsBody,
    name: str,
    kind: mujoco.mjtGeom,
    size: object,
    rgba: Sequence[float],
    group: int,
) -> mujoco.MjsGeom:
    """A geom without mass and collisions, and without the material of its body's class, which has
    another name here.
    """
    geom = body.add_geom(
        name=name,
        type=kind,
        size=size,
        rgba=rgba,
        group=group,
        contype=0,
        conaffinity=0,
        mass=0,
    )
    geom.material = ""
    return geom


# The lights of a scene: `world.light` in place of the room's own, windows, and what is seen of
# their light on the floor.

# Distance of a lamp that is as far as the sun, from the room's middle [m]: shadows are drawn from
# there
SUN_M = 6.0
FINE_QUADS = 48
"""Parts of a box's face along each edge where light differs within it, which OpenGL computes at
their corners alone; else MuJoCo's 4.
"""
FINE_FLOOR_M = 10.0
FINE_GRID_M = 0.05
"""Half the floor's edge, and the distance of its corners, where light differs within it [m]: in
OpenGL the peak of a highlight of exponent 100 is up to 4 % too low, and found within 0.07 m of its
place.
"""
# Half the thickness of a window's pane [m]; its lamp is as far before its face as that is before
# its middle
PANE_HALF_M = 1e-3


def light_scene(scene: mujoco.MjSpec, world: World, glossy: bool) -> None:
    """Give the scene a lamp and an even light in place of all its own lights, where the world has
    them, its windows, and its floor.

    glossy: the target shows highlights.
    """
    if glossy or world.light_differs:
        scene.visual.quality.numquads = FINE_QUADS
    if world.light is not None:
        _replace_lights(scene, world.light)
    for i, pane in enumerate(world.windows):
        _add_window(scene, pane, i, world.floor.sharpness)
    if world.floor != Floor():
        _paint_floor(scene, world.floor)
    if world.light_differs:
        scene.geom("floor").size = [FINE_FLOOR_M, FINE_FLOOR_M, FINE_GRID_M]


def _replace_lights(scene: mujoco.MjSpec, light: Light) -> None:
    """The lamp and the even light of `world.light` in place of all lights; a lamp that moves is on
    a body, `LAMP`.
    """
    for other in scene.lights:
        other.active = other.name in ("key", "fill")
    key = scene.light("key")
    fill = scene.light("fill")
    along = np.array(light.direction) / np.linalg.norm(light.direction)
    colour = np.array(light.color)
    fill.ambient = light.ambient * colour
    fill.diffuse = [0, 0, 0]
    place = np.zeros(3) if light.xyz is None else np.array(light.xyz)
    if light.motion.moves:
        scene.delete(key)
        holder = scene.worldbody.add_body(name=LAMP, mocap=True, pos=place)
        key = holder.add_light(name="key", castshadow=True)
        place = np.zeros(3)
    key.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    key.dir = along
    key.pos = -SUN_M * along
    key.ambient = [0, 0, 0]
    # a spot light of half a space: MuJoCo's OpenGL draws its point lights as spots of 45 degrees
    if light.xyz is not None:
        key.type = mujoco.mjtLightType.mjLIGHT_SPOT
        key.pos = place
        key.attenuation = [1, 0, 0]
        key.exponent = 0
        key.cutoff = 90
    key.diffuse = key.specular = light.brightness * colour


def _add_window(scene: mujoco.MjSpec, pane: WindowPane, i: int, sharpness: float) -> None:
    """A pane of constant brightness, and its light, as `WindowPane` has it, for highlights of an
    exponent.
    """
    grey = min(pane.brightness, 1.0) / GLOW
    name = f"window_{i}"
    paint = scene.add_material(
        name=name, rgba=[grey, grey, grey, 1], specular=0, shininess=0, emission=GLOW
    )
    body = scene.worldbody.add_body(name=name, **_at(pane.pose.T))
    size = [pane.width / 2, pane.height / 2, PANE_HALF_M]
    _visual(body, name, GEOMS["box"], size, paint.rgba, 0).material = name
    # cos(b)^1 of a spot light is Lambert's law, 1/(1 + pi d^2/A) its attenuation
    body.add_light(
        name=name,
        type=mujoco.mjtLightType.mjLIGHT_SPOT,
        pos=[0, 0, 2 * PANE_HALF_M],
        dir=[0, 0, 1],
        ambient=[0, 0, 0],
        diffuse=[pane.brightness] * 3,
        specular=[pane.brightness * (sharpness / 4 + 1) / 2] * 3,
        attenuation=[1, 0, np.pi / (pane.width * pane.height)],
        cutoff=90,
        exponent=1,
        castshadow=False,
    )


def _paint_floor(scene: mujoco.MjSpec, floor: Floor) -> None:
    paint = scene.material("floor")
    paint.specular = floor.gloss
    paint.shininess = floor.sharpness / 128
    paint.reflectance = floor.mirror
    if floor.texture is None:
        return
    png, (width, height) = read_tile(place_of_picture(floor.texture), floor.albedo)
    lay_picture(scene, paint, "floor_picture", "floor_picture.png", png)
    # `texuniform`: so many tiles in two metres
    paint.texrepeat = [2 / floor.tile_m, 2 / (floor.tile_m * height / width)]
