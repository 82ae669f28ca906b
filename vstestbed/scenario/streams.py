"""Independent random streams of one seed. Their numbers enter the seed: a new one comes last, or all recorded runs change."""

from __future__ import annotations

START_STREAM, NOISE_STREAM, IMAGE_STREAM, SENSOR_STREAM, TIMING_STREAM, DEPTH_STREAM, MOTION_STREAM, PERTURB_STREAM = range(8)
"""The start, the noise of measured pixels, of pictures, of the robot's own sensors, of timing, of the calibration of depths, the target's
random walk, perturbations."""
RGBD_STREAM, GOAL_STREAM, BODY_STREAM, LINK_STREAM, STAMP_STREAM, IMAGING_STREAM, RANDOMISE_STREAM, CLUTTER_STREAM = range(8, 16)
"""The depth camera, the goal's picture, what differs from one robot to the next of its kind, losses of the link, time stamps, the image
sensor, the block `randomise`, clutter."""
TARGET_STREAM = 16
"""Changes of the target's own picture."""
