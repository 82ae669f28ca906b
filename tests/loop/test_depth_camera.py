"""Depth from the depth camera, in the loop: accuracy at the markers, holes, what is refused, a
camera of one's own.
"""

from __future__ import annotations

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.geometry import Array
from vstestbed.features.depth import DepthCues, Sensed, depth_at
from vstestbed.features.observation import Goal
from vstestbed.loop.controller import Controller

SHORT = {"stop.duration_s": 0.12, "camera.width": 320, "camera.height": 240}


def errors(**changes: object) -> tuple[Array, vs.Recording]:
    """Errors (K, 4) [m] of the law's depths against the truth."""
    found: list[Array] = []

    class Watch:
        def frame(self, frame: vs.Frame) -> None:
            found.append(frame.observation.depth - frame.truth.p_camera[:, 2])

    recording = vs.run(vs.load("arm_depth", SHORT | changes), watch=[Watch()])
    return np.array(found), recording


@pytest.mark.parametrize("detector", ["blobs", "oracle"])
def test_a_noiseless_sensor_measures_the_markers_depth(detector: str):
    e, _ = errors(**{"camera.depth_sensor": "ideal", "detector": {"kind": detector}})
    assert e.size >= 12 and np.abs(e).max() < 1e-4


def test_noise_is_the_sensors_and_repeats():
    """The median of 25 pixels, correlated over 5 x 5, has little less noise than one pixel: 2.3 mm
    at 0.92 m, f = 192 px.
    """
    (e, first), (_, again), (_, other) = errors(), errors(), errors(seed=1)
    assert 0.3 < e.std() / (0.92**2 * 0.08 / (192 * 0.05)) < 1.2
    assert first.table.tobytes() == again.table.tobytes() != other.table.tobytes()


def test_without_depth_a_marker_is_left_out_or_given_one():
    e, recording = errors(**{"camera.depth_sensor": {"kind": "ideal", "far_m": 0.5}})
    assert np.isnan(e).all() and not recording["cmd_vx"].any()
    _, recording = errors(
        **{
            "camera.depth_sensor": {"kind": "ideal", "far_m": 0.5},
            "law.depth": {"kind": "sensor", "missing_m": 100},
        }
    )
    assert (recording["depth_0"] == 100).all() and recording["cmd_vx"].any()


def test_a_source_reads_medians_of_what_is_valid():
    image = np.full((20, 30), 2.0, np.float32)
    image[10, 12:] = 1.0
    image[:8] = np.nan
    uv = np.array(
        [
            [12.4, 9.6],
            [12.4, 15.0],
            [5.0, 7.0],
            [5.0, 6.0],
            [np.nan, np.nan],
            [29.0, 19.0],
            [80.0, -3.0],
        ]
    )
    # In the corner 9 of 25 pixels are in the picture; at v = 7, 10 of 25 are valid.
    np.testing.assert_array_equal(
        depth_at(image, uv, 5), [2.0, 2.0, np.nan, np.nan, np.nan, np.nan, np.nan]
    )
    np.testing.assert_array_equal(
        depth_at(image, uv), [1.0, 2.0, np.nan, np.nan, np.nan, 2.0, np.nan]
    )
    # of an even number the mean of both in the middle
    nine = np.array([[1, 2, np.nan], [3, 4, np.nan], [5, 6, np.nan]], np.float32)
    assert depth_at(nine, np.array([[1.0, 1.0]]), 3) == 3.5


def test_ranges_follow_from_depths():
    goal = vs.load("arm_depth").goal_view
    assert isinstance(goal, Goal)
    xy = np.array([[0.3, -0.4], [0.0, 0.0]])
    cues = DepthCues(goal, xy, measured=np.array([2.0, np.nan]))
    np.testing.assert_allclose(Sensed().ranges(cues), [2 * np.sqrt(1.25), np.nan])
    np.testing.assert_allclose(Sensed(missing_m=3).ranges(cues), [2 * np.sqrt(1.25), 3])


def test_what_cannot_be_measured_is_refused():
    with pytest.raises(
        vs.errors.ScenarioError,
        match=r"law\.depth: may be sensor only with a depth camera: add camera\.depth_sensor",
    ):
        vs.load("arm_ibvs", {"law.depth": "sensor"})
    with pytest.raises(vs.errors.ScenarioError, match="window_px: must be odd"):
        vs.load("arm_depth", {"law.depth": {"kind": "sensor", "window_px": 4}})
    with pytest.raises(vs.errors.ScenarioError, match="for camera perspective"):
        vs.load("arm_fisheye", {"camera.depth_sensor": "stereo"})


def test_pictures_of_a_session_have_their_depth():
    with vs.Session(vs.load("arm_depth", SHORT | {"law.depth": "pnp"})) as session:
        frame = session.reset()
    assert frame.depth_image is not None and frame.depth_image.shape == (240, 320)
    with vs.Session(vs.load("arm_ibvs", SHORT)) as session:
        assert session.reset().depth_image is None


def test_a_controller_is_given_the_depth_of_a_real_camera():
    scenario = vs.load("arm_depth", SHORT)
    with vs.Session(scenario, pictures=True) as session:
        frame = session.reset()
        assert (
            frame.image is not None
            and frame.depth_image is not None
            and session.episode is not None
        )
        reading = session.episode.plant.reading()
    z = np.nan_to_num(frame.depth_image)  # drivers have 0 where nothing was measured
    cycle = Controller(scenario).step(frame.image, 0.0, reading, depth=z)
    np.testing.assert_array_equal(cycle.observation.depth, frame.observation.depth)
    for wrong in (None, z[:100], (1000 * z).astype(np.uint16)):
        with pytest.raises(
            vs.errors.ParameterError, match=r"depth must be \(240, 320\) floats, in metres"
        ):
            Controller(scenario).step(frame.image, 0.0, reading, depth=wrong)
