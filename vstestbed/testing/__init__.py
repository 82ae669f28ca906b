"""Suites that every kind must pass, bundled or brought along: `check_law`, `check_robot`,
`check_detector`, `check_camera`, ...

    import vstestbed.testing

    def test_my_law():
        vstestbed.testing.check_law(MyLaw(gain=1.0))

Each raises AssertionError with a sentence that says what was expected and what was found.
`vstestbed new` writes files that have one.
"""

from vstestbed.testing.laws import check_feature, check_law
from vstestbed.testing.perception import (
    check_camera,
    check_detector,
    check_effect,
    check_keypoints,
    check_metric,
    check_monitor,
    check_noise,
)
from vstestbed.testing.robots import check_robot
from vstestbed.testing.targets import check_motion, check_target, check_task

__all__ = [
    "check_camera",
    "check_detector",
    "check_effect",
    "check_feature",
    "check_keypoints",
    "check_law",
    "check_metric",
    "check_monitor",
    "check_motion",
    "check_noise",
    "check_robot",
    "check_target",
    "check_task",
]
