"""Stretched bodies: geoms about the body's origin."""

import mujoco
import pytest

from vstestbed.effects.body import stretch


def test_places_ends_of_capsules_and_sizes_of_boxes_are_stretched_and_shifted_and_no_radii():
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(name="a")
    body.add_geom(
        name="rod",
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=[0.1, 0, 0, 0.3, 0, 0],
        size=[0.02, 0, 0],
    )
    body.add_geom(
        name="box", type=mujoco.mjtGeom.mjGEOM_BOX, pos=[0.2, 0.1, 0], size=[0.1, 0.1, 0.1]
    )
    body.add_geom(
        name="ball", type=mujoco.mjtGeom.mjGEOM_SPHERE, pos=[0, 0, 0.3], size=[0.05, 0, 0]
    )
    stretch(spec, "a", (2.0, 3.0, 1.0), (0.0, 0.0, 0.1))
    model = spec.compile()
    rod, box, ball = (model.geom(name) for name in ("rod", "box", "ball"))
    assert rod.pos == pytest.approx([0.4, 0, 0.1]) and rod.size[:2] == pytest.approx([0.02, 0.2])
    assert box.pos == pytest.approx([0.4, 0.3, 0.1]) and box.size == pytest.approx([0.2, 0.3, 0.1])
    assert ball.pos == pytest.approx([0, 0, 0.4]) and ball.size[0] == 0.05
