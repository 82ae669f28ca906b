"""The geoms of a scene as triangles: closed where the geom is, as large as it, facing outwards."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import vstestbed as vs
from vstestbed.sim.replay import Replay
from vstestbed.sim.scene.meshes import solids
from vstestbed.vision.tags import PX_PER_MODULE, tag_picture

SIZES = {
    "sphere": (".3", 4 / 3 * np.pi * 0.3**3),
    "box": (".1 .2 .3", 8 * 0.1 * 0.2 * 0.3),
    "cylinder": (".2 .4", np.pi * 0.04 * 0.8),
}
SIZES |= {
    "capsule": (".2 .4", np.pi * 0.04 * 0.8 + 4 / 3 * np.pi * 0.008),
    "ellipsoid": (".1 .2 .3", 4 / 3 * np.pi * 0.006),
}


@pytest.mark.parametrize("kind", SIZES)
def test_a_geom_keeps_its_volume_and_faces_outwards(kind: str):
    size, volume = SIZES[kind]
    geom = f'<geom type="{kind}" size="{size}" rgba="1 0 0 1" pos="1 2 3" euler="20 30 40"/>'
    xml = f"<mujoco><worldbody><body>{geom}</body></worldbody></mujoco>"
    (solid,) = solids(mujoco.MjModel.from_xml_string(xml))
    a, b, c = (solid.vertices[solid.faces[:, i]] for i in range(3))
    # of the divergence theorem: positive where normals face outwards
    signed = np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6
    assert (
        signed == pytest.approx(volume, rel=0.04)
        and solid.rgb == (1.0, 0.0, 0.0)
        and solid.body == 1
    )
    np.testing.assert_allclose(solid.vertices.mean(axis=0), [1, 2, 3], atol=0.03)


@pytest.mark.parametrize(
    "name",
    [
        "arm_ibvs",
        "car_parking",
        "quadrotor_hover",
        "omni_ibvs",
        "arm_tags",
        "arm_eye_to_hand",
        "car_line",
        "arm_picture",
        "arm_mesh",
    ],
)
def test_every_robot_and_target_is_there(name: str):
    s = vs.load(name)
    replay = Replay(s.scene)
    names = replay.body_names
    shown = {names[solid.body].partition("/")[0] for solid in replay.solids}
    assert {"robot", "target"} <= shown
    for solid in replay.solids:
        assert np.isfinite(solid.vertices).all() and solid.faces.max() < len(solid.vertices)
    replay.close()


def test_markers_have_their_colours_and_tags_their_print():
    s = vs.load("arm_ibvs")
    replay = Replay(s.scene)
    colours = {
        solid.rgb for solid in replay.solids if replay.body_names[solid.body] == "target/frame"
    }
    for colour in s.target.colors:
        assert min(np.abs(np.array(c) - colour).max() for c in colours) < 0.01
    replay.close()
    s = vs.load("arm_tags")
    replay = Replay(s.scene)
    prints = replay.panes
    assert len(prints) == 4
    assert {replay.body_names[pane.body] for pane in prints} == {"target/frame"}
    for i, pane in enumerate(prints):
        size = (s.target.marker.modules + 2) * PX_PER_MODULE
        np.testing.assert_array_equal(pane.image[..., 0], tag_picture(s.target.marker, i))
        assert pane.image.shape == (size, size, 3)
        assert pane.width == pytest.approx(s.target.marker.tile)
        # upright for who looks along z
        np.testing.assert_allclose(pane.T_body_pane[:3, :3], np.eye(3), atol=1e-9)
    replay.close()


def test_a_picture_is_there_without_its_margin():
    s = vs.load("arm_picture")
    replay = Replay(s.scene)
    (pane,) = replay.panes
    assert (pane.width, pane.height) == pytest.approx((0.6, 0.424))
    assert pane.image.shape == (
        896,
        1792,
        3,
    )
    corner = pane.image[: 2 * 40, : 2 * 50].mean(), pane.image[-30:, -40:].mean()
    assert min(corner) > 200  # white paper, as in the file
    tag = pane.image[round(130 / 848 * 896), round(55 / 1200 * 1792)]
    assert tag.max() < 40  # the black border of the first tag
    replay.close()


def test_poses_are_those_of_the_state():
    s = vs.load("arm_ibvs")
    replay = Replay(s.scene)
    q = s.robot.start_joints()
    xpos, xquat = replay.body_poses(0.0, s.target.T_world_start, q, np.eye(4))
    np.testing.assert_allclose(
        xpos[replay.body_names.index("target/frame")], s.target.T_world_start[:3, 3], atol=1e-9
    )
    before = xpos.copy()
    xpos, xquat = replay.body_poses(0.0, s.target.T_world_start, q + 0.1, np.eye(4))
    assert np.abs(xpos - before).max() > 0.01 and np.allclose(np.linalg.norm(xquat, axis=1), 1)
    T, middle, fovy = replay.outside_view(0.0, s.T_world_goal)
    assert 0.2 < fovy < 1.5 and (T[:3, :3].T @ (middle - T[:3, 3]))[2] > 0.5
    replay.close()
