"""Pose, homography and depth from pixels."""
