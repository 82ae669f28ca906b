"""Groups of the scene's geoms, by which renderers and rays choose: 0 the room, and these."""

LENS_GROUP, ROBOT_GROUP, TARGET_GROUP, SITE_GROUP, RANGE_GROUP = 1, 2, 3, 4, 5
"""What encloses the lens, the robot, the target, sites, what range finders alone meet (and no picture shows)."""
OF_FILES = {0: ROBOT_GROUP, 3: RANGE_GROUP, 4: RANGE_GROUP}
"""Groups of a robot's file in the scene: by the usual custom 0 to 2 are drawn, and from 3 on there are shapes for contacts alone."""
