"""The closing lines of a run."""

from vstestbed.cli import progress, ros


def test_lengths_of_a_robot_that_stood_still_have_few_decimals():
    assert [progress._digits({"path_length_m": way}) for way in (1e-60, 1e-3, 0.5, None)] == [
        6,
        4,
        2,
        2,
    ]


def test_a_law_that_never_started_tells_no_time():
    assert ros._after([], "after its picture each") == ""
    assert (
        ros._after([0.1], "after its picture each") == ", 100.00 ms after its picture each (median)"
    )
