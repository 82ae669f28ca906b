"""Groups of the scene's geoms, by which renderers and rays choose (0 the room, and these), a name, and how flat things face and glow."""

from vstestbed.effects.base import RANGE_GROUP

LENS_GROUP, ROBOT_GROUP, TARGET_GROUP, SITE_GROUP = 1, 2, 3, 4
"""What encloses the lens, the robot, the target, sites; besides them RANGE_GROUP, which no picture shows."""
OF_FILES = {0: ROBOT_GROUP, 3: RANGE_GROUP, 4: RANGE_GROUP}
"""Groups of a robot's file in the scene: by the usual custom 0 to 2 are drawn, and from 3 on there are shapes for contacts alone."""
HAND_PLATE = "hand_plate"  # name of the plate in reserve
FACE_VIEWER = (0, 1, 0, 0)
"""A half turn about x (wxyz): the face that MuJoCo draws a texture on upright, +z with y up, looks at the viewer, y down."""
GLOW = 1000.0
"""Emission of an unlit marker, whose own colour is divided by it: emission gives the exact colour 255 * rgba, and what
the scene's lights add (the plain colour times their brightness) is under half a grey level."""
