"""What the oracle sees and does not see."""

from __future__ import annotations

import numpy as np
import pytest

from vstestbed.camera import Perspective
from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose
from vstestbed.targets.base import Points
from vstestbed.vision import DETECTORS, Blobs, Detection, Oracle, TruthView

CAMERA = Perspective()  # 640 x 480, f = 384 px
TARGET = Points(pose=Pose(), at=((0, 0, 0), (1, 0, 0), (2, 0, 0)))  # discs of 2 cm: 7.7 px at 1 m
RNG = np.random.default_rng(0)


def _ask(
    oracle: Oracle,
    p: Array | list[list[float]],
    hidden: tuple[bool, bool, bool] = (False, False, False),
) -> Detection:
    view = TruthView(np.array(p, dtype=float), np.array(hidden))
    return oracle.detect(oracle.init(), None, view, CAMERA, TARGET, RNG)[1]


def test_true_pixels_and_true_depths() -> None:
    p = np.array([[0, 0, 1], [0.1, 0.2, 2], [-0.3, 0.1, 1.5]])
    found = _ask(Oracle(), p)
    assert found.uv == pytest.approx(CAMERA.project(p), abs=0)
    assert found.p_camera == pytest.approx(p, abs=0)
    assert found.T_camera_target is None


@pytest.mark.parametrize("field_of_view", ["limited", "unlimited"])
def test_never_behind_the_camera(field_of_view: str) -> None:
    found = _ask(Oracle(field_of_view=field_of_view), [[0, 0, -1], [0, 0, 0], [0, 0, 1]])
    assert found.seen.tolist() == [False, False, True]


def test_limited_field_of_view() -> None:
    # Half the picture is 320 px / 384 = .8333 wide at 1 m. The second marker's centre is 4 px
    # inside, less than its 7.7 px.
    p = [[0.9, 0, 1], [0.8333 - 4 / 384, 0, 1], [0.8333 - 9 / 384, 0, 1]]
    assert _ask(Oracle(), p).seen.tolist() == [False, False, True]
    assert _ask(Oracle(field_of_view="unlimited"), p).seen.all()


def test_hidden_markers() -> None:
    p = [[0, 0, 1], [0.1, 0, 1], [0.2, 0, 1]]
    assert _ask(Oracle(), p, (True, False, False)).seen.tolist() == [False, True, True]
    assert _ask(Oracle(field_of_view="unlimited"), p, (True, False, False)).seen.all()


def test_needs_the_truth_and_only_the_truth() -> None:
    assert (Oracle().needs_truth, Oracle().needs_image) == (True, False)
    assert (Blobs().needs_truth, Blobs().needs_image) == (False, True)
    assert set(DETECTORS.members) >= {"blobs", "oracle"}
    with pytest.raises(ParameterError, match="blobs"):
        Oracle().detect(None, None, None, CAMERA, TARGET, RNG)
    with pytest.raises(ParameterError, match="oracle"):
        Blobs().detect(Blobs().init(), None, None, CAMERA, TARGET, RNG)
