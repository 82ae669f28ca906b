"""The commands of ROS."""

from vstestbed.apps.ros import roles


def test_a_law_that_never_started_tells_no_time():
    assert roles._after([], "after its picture each") == ""
    assert (
        roles._after([0.1], "after its picture each")
        == ", 100.00 ms after its picture each (median)"
    )
