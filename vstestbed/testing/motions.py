"""What every motion of a target must do."""

from __future__ import annotations

import numpy as np

from vstestbed.core.errors import ParameterError
from vstestbed.core.geometry import Array, Pose
from vstestbed.targets.motion import MotionBase

SPAN_S, STEP_S = 10.0, 1e-3
FASTEST_MPS = 50.0
"""A path that moves by more than that is taken to jump [m/s]."""


def check_motion(motion: MotionBase) -> None:
    """The path is rigid, continuous, a function of time alone once its seed is given, and starts in one place whatever the seed.

    `draws` says whether another seed gives another path: a motion that draws without saying so is refused more than one seed.

    Raises:
        AssertionError: it says what was expected and what was found.
    """
    assert isinstance(motion, MotionBase), f"{type(motion).__name__}: a motion must derive from vstestbed.MotionBase"
    rest = Pose(xyz=(1, 2, 3), rpy_deg=(10, -20, 30)).T
    start = motion.start(rest)
    assert start.shape == (4, 4) and np.isfinite(start).all(), f"{motion.kind}: start(pose) must be a pose (4, 4), got {start}"
    if motion.moves and not motion.by_itself:
        _check_refusal(motion)
        return
    times = np.arange(0.0, SPAN_S, STEP_S)
    D = _along(motion, times)
    _check_rigid(motion.kind, D)
    jump = float(np.abs(np.diff(D[:, :3, 3], axis=0)).max())
    when = times[np.abs(np.diff(D[:, :3, 3], axis=0)).max(axis=1).argmax()]
    assert jump <= FASTEST_MPS * STEP_S, f"{motion.kind}: the path jumps by {jump:.3g} m within {STEP_S:g} s at {when:.3f} s"
    backwards = _along(motion, times[::-500])[::-1]
    assert np.array_equal(backwards, D[::-500][::-1]), f"{motion.kind}: another path when the times are asked for backwards"
    _check_start(motion, rest, D[0])
    drawn = not np.array_equal(_along(motion, times, seed=8), D)
    assert drawn is motion.draws, (
        f"{motion.kind}: `draws` is {motion.draws}, and another seed gives {'another' if drawn else 'the same'} path"
    )
    still = bool(np.all(D[0] == D))
    assert still is not motion.moves, f"{motion.kind}: `moves` is {motion.moves}, and the path {'stands still' if still else 'moves'}"


def _check_start(motion: MotionBase, rest: Array, D: Array) -> None:
    """The displacement at 0 s (4, 4) is that of every seed, and where `start` says."""
    for seed in range(3):
        off = float(np.abs(motion.path(np.random.default_rng(seed))(0.0) - D).max())
        assert off < 1e-12, f"{motion.kind}: every seed must start at the same place, one is {off:.3g} off"
    off = float(np.abs(rest @ D - motion.start(rest)).max())
    assert off < 1e-9, f"{motion.kind}: start(pose) must be pose @ path(rng)(0), it is {off:.3g} off"


def _along(motion: MotionBase, times: Array, seed: int = 7) -> Array:
    """Displacements (n, 4, 4) of one seed at times (n,) [s]."""
    at = motion.path(np.random.default_rng(seed))
    return np.array([at(float(t)) for t in times])


def _check_rigid(kind: str, D: Array) -> None:
    assert D.shape[1:] == (4, 4) and np.isfinite(D).all(), f"{kind}: a displacement must be a finite matrix (4, 4)"
    R = D[:, :3, :3]
    off = float(np.abs(R @ R.mT - np.eye(3)).max())
    assert off < 1e-9, f"{kind}: the rotation of a displacement must be orthonormal, it is {off:.3g} off"
    assert (np.linalg.det(R) > 0).all(), f"{kind}: the rotation of a displacement must not mirror"
    assert np.array_equal(D[:, 3], np.tile([0.0, 0, 0, 1], (len(D), 1))), f"{kind}: the last row of a displacement must be 0 0 0 1"


def _check_refusal(motion: MotionBase) -> None:
    try:
        motion.path(np.random.default_rng(0))
    except ParameterError:
        return
    raise AssertionError(f"{motion.kind}: a target that is carried has no path; path must raise ParameterError")
