"""Suites that every kind must pass, bundled or brought along: `check_law`, `check_robot`, `check_target`, `check_detector`, `check_task`.

    import vstestbed.testing

    def test_my_law():
        vstestbed.testing.check_law(MyLaw(gain=1.0))

Each raises AssertionError with a sentence that says what was expected and what was found.
"""

from vstestbed.testing.detectors import check_detector
from vstestbed.testing.laws import check_law
from vstestbed.testing.robots import check_robot
from vstestbed.testing.targets import check_target
from vstestbed.testing.tasks import check_task

__all__ = ["check_detector", "check_law", "check_robot", "check_target", "check_task"]
