"""Families of square tags, by the words of a scenario."""

from typing import Literal

Family = Literal[
    "apriltag_16h5",
    "apriltag_25h9",
    "apriltag_36h10",
    "apriltag_36h11",
    "aruco_4x4_50",
    "aruco_4x4_100",
    "aruco_4x4_250",
    "aruco_4x4_1000",
    "aruco_5x5_50",
    "aruco_5x5_100",
    "aruco_5x5_250",
    "aruco_5x5_1000",
    "aruco_6x6_50",
    "aruco_6x6_100",
    "aruco_6x6_250",
    "aruco_6x6_1000",
    "aruco_7x7_50",
    "aruco_7x7_100",
    "aruco_7x7_250",
    "aruco_7x7_1000",
]
"""Families of square tags. AprilTag: bits and least Hamming distance of two tags; ArUco: bits and number of tags."""
APRILTAGS = {"16h5": (4, 30), "25h9": (5, 35), "36h10": (6, 2320), "36h11": (6, 587)}
"""Bits along a side and number of tags of the AprilTag families."""
