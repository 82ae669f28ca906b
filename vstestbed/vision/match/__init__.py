"""Matches between two pictures: key points and their descriptors, mutual matches, inliers of a plane, sub-pixel places, tracking."""
