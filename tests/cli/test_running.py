"""The closing lines of a run."""

from vstestbed.cli import running


def test_lengths_of_a_robot_that_stood_still_have_few_decimals():
    assert [running._digits({"path_length_m": way}) for way in (1e-60, 1e-3, 0.5, None)] == [
        6,
        4,
        2,
        2,
    ]
