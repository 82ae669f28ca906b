"""Luminance as a feature: L against finite differences of rendered pictures, the law in closed
loop, outliers, what it refuses.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.camera import Perspective
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.core.geometry import exp, inverse, rigid_error, transform
from vstestbed.features.depth import Constant, PnP, Sensed
from vstestbed.features.observation import Goal, Observation, Sight
from vstestbed.laws.base import Command, ConstantGain
from vstestbed.laws.photometric import (
    BLANK,
    LEAST_SIGMA,
    NO_DEPTH,
    NO_PICTURE,
    NO_STRUCTURE,
    GoalLevel,
    LevenbergMarquardt,
    Photometric,
    Robust,
    Which,
    coarser,
    gradient,
    luminance,
    motion_px,
    scale,
    weights,
)
from vstestbed.scenario.load import parse
from vstestbed.sim.replay import Rerendering
from vstestbed.tasks.metrics import Metric

CORNERS = np.array([[-0.3, -0.225, 0], [0.3, -0.225, 0], [0.3, 0.225, 0], [-0.3, 0.225, 0]])
AT_GOAL = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1]])
CAMERA = Perspective(width=160, height=120, fovy_deg=25)


@pytest.fixture(scope="module")
def texture() -> np.ndarray:
    """Noise of all scales (900, 1200)."""
    rng, made = np.random.default_rng(0), np.zeros((900, 1200), np.float32)
    for n in (4, 8, 16, 32, 64):
        made += cv2.resize(
            rng.normal(size=(3 * n, 4 * n)).astype(np.float32),
            (1200, 900),
            interpolation=cv2.INTER_CUBIC,
        )
    return np.clip(128 + 50 * made / made.std(), 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def file(texture: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same as a picture file."""
    path = tmp_path_factory.mktemp("texture") / "noise.png"
    cv2.imwrite(str(path), texture)
    return path


def seen(texture: np.ndarray, T: np.ndarray, fine: int = 2) -> Sight:
    """The picture of the texture on a plane 0.6 m wide from T_camera_target, each pixel the mean of
    fine x fine.
    """
    f, (cx, cy), s = CAMERA.f * fine, (CAMERA.centre + 0.5) * fine - 0.5, 0.6 / texture.shape[1]
    plane = np.array(
        [
            [s, 0, -s * (texture.shape[1] - 1) / 2],
            [0, s, -s * (texture.shape[0] - 1) / 2],
            [0, 0, 1],
        ]
    )
    H = np.array([[f, 0, cx], [0, f, cy], [0, 0, 1.0]]) @ T[:3, [0, 1, 3]] @ plane
    grey = cv2.warpPerspective(
        texture, H, (CAMERA.width * fine, CAMERA.height * fine), borderValue=90
    )
    small = cv2.resize(grey, (CAMERA.width, CAMERA.height), interpolation=cv2.INTER_AREA)
    return Sight(np.asarray(cv2.cvtColor(small, cv2.COLOR_GRAY2RGB), np.uint8))


def goal_of(texture: np.ndarray) -> Goal:
    """The goal view with its picture."""
    return replace(Goal.from_view(CAMERA, CORNERS, AT_GOAL), image=seen(texture, AT_GOAL))


def looked(image: Sight | None, t: float = 0.0) -> Observation:
    """An observation of a picture alone."""
    return Observation(t, np.empty((0, 2)), np.empty((0, 2)), np.empty(0), image=image)


def flown(
    law: Photometric,
    texture: np.ndarray,
    off: list[float],
    frames: int = 80,
    spoil=lambda sight, t: sight,
) -> tuple[float, float]:
    """Distance [m] and angle [deg] from the goal after so many frames at 25 Hz from exp(off) T*."""
    goal, T = goal_of(texture), exp(np.array(off)) @ AT_GOAL
    state = law.init(goal)
    for k in range(frames):
        state, command = law.step(
            state, looked(spoil(seen(texture, T), 0.04 * k), 0.04 * k), goal, np.eye(6)
        )
        T = exp(-0.04 * command.twist) @ T
    distance, angle = rigid_error(inverse(T), inverse(AT_GOAL))
    return distance, float(np.degrees(angle))


def scenario_of(file: Path, **changed: object) -> vs.Scenario:
    """The ideal camera before the texture, in small pictures."""
    plain = {
        "robot": {
            "kind": "free",
            "start": {"nominal": {"xyz": [0.02, -0.01, -1.05], "rpy_deg": [1, 1, 4]}},
        },
        "camera": {"kind": "perspective", "width": 160, "height": 120, "fovy_deg": 25},
        "target": {
            "kind": "picture",
            "file": str(file),
            "width": 0.6,
            "pose": {},
            "lit": False,
            "draw_markers": False,
        },
        "detector": {"kind": "none"},
        "law": {
            "kind": "photometric",
            "gain": 10,
            "margin_px": 4,
            "interaction": "mean",
            "levels": 3,
        },
        "world": {"floor_z": -40},
        "goal": {"T_camera_target": {"xyz": [0, 0, 1]}},
        "stop": {"duration_s": 6, "converged": {"error_grey": 0.5, "hold_s": 0.2}},
    }
    return parse(json.dumps(plain | changed), "test.yaml")


@pytest.mark.parametrize(
    ("distortion", "level"), [(None, 0), (None, 1), ((-0.3, 0.1, 0.002, 0.001, 0.0), 0)]
)
def test_interaction_matrix_is_that_of_rendered_pictures(
    file: Path, distortion: tuple[float, ...] | None, level: int
) -> None:
    """Column by column: correlation above 0.98, scale within 4 % of the differences that
    displacements of a pixel make.
    """
    s = scenario_of(
        file,
        camera={
            "kind": "perspective",
            "width": 160,
            "height": 120,
            "fovy_deg": 25,
            "distortion": distortion,
        },
    )
    camera, rerendered = s.camera, Rerendering(s.scene)
    assert isinstance(camera, Perspective)
    T = exp(np.array([0.02, 0.01, 0.1, 0.2, -0.1, 0.3])) @ AT_GOAL
    pixels, normal = GoalLevel.of(camera, np.zeros((1, 1), np.float32), level, 8, 1), T[:3, 2]
    near = ((normal[0] * pixels.x + normal[1] * pixels.y + normal[2]) / (normal @ T[:3, 3])).astype(
        np.float32
    )

    def picture(by: np.ndarray) -> np.ndarray:
        grey = luminance(
            rerendered.picture(0.0, np.eye(4), np.zeros(0), inverse(exp(-by) @ T)), 1.5
        )
        return coarser(grey) if level else grey

    L = pixels.interaction(gradient(picture(np.zeros(6))), near)
    for column, unit in zip(L, np.eye(6), strict=True):
        step = 0.5 * 2**level / motion_px(camera, unit, 1.0)
        measured = (picture(step * unit) - picture(-step * unit))[pixels.at].ravel() / (2 * step)
        assert np.corrcoef(measured, column)[0, 1] > 0.98
        assert (measured @ column) / (column @ column) == pytest.approx(1.0, abs=0.04)
    rerendered.close()


@pytest.mark.parametrize("interaction", ["current", "desired", "mean"])
def test_converges_with_each_matrix(texture: np.ndarray, interaction: Which) -> None:
    """From 3 cm and 3 degrees to under a millimetre."""
    law = Photometric(
        gain=ConstantGain(value=12.0),
        interaction=interaction,
        margin_px=4,
        damping=LevenbergMarquardt(after_s=1.0),
    )
    distance, angle = flown(law, texture, [0.01, -0.01, 0.03, 0.01, 0.01, 0.05])
    assert distance < 1e-3
    assert angle < 0.06


def test_pyramid_widens_the_basin(texture: np.ndarray) -> None:
    """A start from which full pictures alone do not get there."""
    off = [0.05, 0.03, 0.1, 0.02, -0.04, 0.35]
    law = Photometric(
        gain=ConstantGain(value=12.0),
        interaction="mean",
        margin_px=4,
        smooth_px=0.0,
        damping=LevenbergMarquardt(after_s=1.0),
    )
    assert flown(law, texture, off)[0] > 0.05
    assert flown(replace(law, levels=4), texture, off)[0] < 1e-3


def test_other_light_is_fitted_with_the_motion(texture: np.ndarray) -> None:
    """A goal taken a fifth darker: without gain and offset the camera ends beside it, with them it
    does not.
    """

    def brighter(sight: Sight, t: float) -> Sight:
        return Sight(np.clip(sight.image * 0.8 + 10.5, 0, 255).astype(np.uint8))

    law = Photometric(
        gain=ConstantGain(value=12.0),
        interaction="mean",
        margin_px=4,
        damping=LevenbergMarquardt(after_s=1.0),
    )
    off = [0.01, -0.01, 0.03, 0.01, 0.01, 0.05]
    assert flown(law, texture, off, spoil=brighter)[0] > 0.005
    assert flown(replace(law, light="gain_offset"), texture, off, spoil=brighter)[0] < 1e-3


@pytest.mark.parametrize(
    "goal", one_quick({}, {"goal.picture": {"brightness": 0.7}}), ids=["same", "darker"]
)
def test_other_light_is_told_from_a_motion_far_away_too(goal: dict[str, object]) -> None:
    """From a start at which gain and offset, fitted at the coarsest level, take most of the
    motion's error for the light's.
    """
    r = vs.run(vs.load("arm_photometric", {"law.light": "gain_offset", **goal}))
    assert r.outcome is vs.Outcome.converged
    assert r["position_error_m"][-1] < 1e-3


@pytest.mark.parametrize("robust", ["none", "tukey"])
def test_light_alone_is_no_motion(texture: np.ndarray, robust: Robust) -> None:
    """Of I = 0.9 I* + 7 nothing is left for the motion, and no error."""
    grey = luminance(seen(texture, AT_GOAL).image)
    level = GoalLevel.of(CAMERA, grey, 0, 4, 1, "gain_offset")
    level = replace(level, inverse_depth=np.ones_like(level.x))
    H, b, error_grey = level.normal(np.float32(0.9) * grey + 7, "desired", robust)
    assert np.linalg.norm(np.linalg.solve(H, b)) < 1e-5
    assert error_grey < 1e-3


def test_without_structure_or_depth_it_rests(texture: np.ndarray) -> None:
    """A wall as the goal's picture, and a depth camera that measured nothing."""
    law, wall = Photometric(margin_px=4), np.full_like(texture, 128)
    wall += (np.arange(1200) // 400).astype(np.uint8)
    assert (
        law.step(law.init(goal_of(wall)), looked(seen(texture, AT_GOAL)), goal_of(wall), np.eye(6))[
            1
        ].rest_reason
        == NO_STRUCTURE
    )
    blind = replace(seen(texture, AT_GOAL), depth=np.full((CAMERA.height, CAMERA.width), np.nan))
    goal = replace(goal_of(texture), image=blind)
    assert (
        replace(law, depth=Sensed())
        .step(law.init(goal), looked(blind), goal, np.eye(6))[1]
        .rest_reason
        == NO_DEPTH
    )


def test_the_structure_of_the_goals_picture_is_measured_once(
    texture: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, eigenvalues = [], np.linalg.eigvalsh
    monkeypatch.setattr(np.linalg, "eigvalsh", lambda H: asked.append(H) or eigenvalues(H))
    law, goal = Photometric(margin_px=4), goal_of(texture)
    state = law.init(goal)
    for _ in range(3):
        state, command = law.step(state, looked(seen(texture, AT_GOAL)), goal, np.eye(6))
        assert not command.rest_reason
    assert len(asked) == 1


def test_the_gradient_of_a_polynomial_of_fourth_order_is_exact() -> None:
    u, v = np.meshgrid(np.arange(40.0), np.arange(30.0))
    grey = (1e-4 * u**4 - 3e-3 * v**3 + 0.02 * u * v + u).astype(np.float32)
    du, dv = gradient(grey)
    np.testing.assert_allclose(du[3:-3, 3:-3], (4e-4 * u**3 + 0.02 * v + 1)[3:-3, 3:-3], atol=2e-3)
    np.testing.assert_allclose(dv[3:-3, 3:-3], (-9e-3 * v**2 + 0.02 * u)[3:-3, 3:-3], atol=2e-3)


def test_the_motion_of_a_picture_is_that_of_projected_points() -> None:
    u, v = np.meshgrid((np.arange(40) + 0.5) * 4, (np.arange(30) + 0.5) * 4)
    p = 0.8 * CAMERA.ray(np.column_stack([u.ravel(), v.ravel()]))
    p *= 0.8 / p[:, 2:]
    for step in 1e-4 * np.random.default_rng(2).normal(size=(4, 6)):
        moved = CAMERA.project(transform(exp(-step), p)) - CAMERA.project(p)
        assert motion_px(CAMERA, step, 0.8) == pytest.approx(
            float(np.sqrt(np.mean(np.sum(moved**2, axis=1)))), rel=0.05
        )


def test_the_matrix_at_the_goal_is_weighted_too(texture: np.ndarray) -> None:
    level = GoalLevel.of(CAMERA, luminance(seen(texture, AT_GOAL).image), 0, 4, 1)
    level = replace(level, inverse_depth=np.ones_like(level.x))
    spoiled = luminance(seen(texture, exp(np.array([2e-3, 0, 0, 0, 0, 0])) @ AT_GOAL).image)
    spoiled[40:60, 50:90] = 250
    e = (spoiled[level.at] - level.grey[level.at]).ravel()
    w = weights("tukey", e)
    assert w is not None and 0.02 < np.mean(w == 0) < 0.3
    H, b, _ = level.normal(spoiled, "desired", "tukey")
    np.testing.assert_allclose(H, (level.L * w) @ level.L.T, rtol=1e-3, atol=1e-3 * np.abs(H).max())
    np.testing.assert_allclose(b, (level.L * w) @ e, rtol=1e-2, atol=1e-3 * np.abs(b).max())


def test_it_goes_a_level_down_where_the_picture_hardly_moves_and_one_up_where_it_moves_far(
    texture: np.ndarray,
) -> None:
    law, goal = Photometric(margin_px=4, levels=4), goal_of(texture)
    state, _ = law.step(law.init(goal), looked(seen(texture, AT_GOAL)), goal, np.eye(6))
    sideways = np.array([1.0, 0, 0, 0, 0, 0]) / CAMERA.f  # a pixel at 1 m
    for level, px, expected in (
        (3, 0.0, 2),
        (2, 0.9, 1),
        (2, 1.1, 2),
        (2, 15.0, 2),
        (2, 17.0, 3),
        (3, 99.0, 3),
        (0, 0.0, 0),
    ):
        assert law._next_level(replace(state, level=level), px * sideways, goal) == expected, (
            level,
            px,
        )


def test_outliers_break_least_squares_and_not_the_m_estimator(texture: np.ndarray) -> None:
    """A dark band wanders over the picture: without weights the camera follows it."""

    def shaded(sight: Sight, t: float) -> Sight:
        image = sight.image.copy()
        left = int(20 + 25 * t)
        image[:, left : left + 40] = image[:, left : left + 40] // 3
        return Sight(image)

    law = Photometric(
        gain=ConstantGain(value=12.0),
        interaction="mean",
        margin_px=4,
        levels=3,
        damping=LevenbergMarquardt(after_s=1.0),
    )
    off = [0.01, -0.01, 0.02, 0.0, 0.01, 0.05]
    plain, robust = (
        flown(replace(law, robust=kind), texture, off, spoil=shaded)[0]
        for kind in ("none", "tukey")
    )
    assert plain > 0.02
    assert robust < 2e-3


def test_weights() -> None:
    """The scale is that of most errors; Huber's weights fall with 1/|e|, Tukey's are 0 beyond 4.685
    scales.
    """
    e = np.random.default_rng(1).normal(0, 8, 10_000).astype(np.float32)
    e[:2000] = 200
    assert scale(e) == pytest.approx(8 * 1.3, rel=0.1)
    assert scale(np.zeros(10, np.float32)) == LEAST_SIGMA
    assert weights("none", e) is None
    huber, tukey = weights("huber", e), weights("tukey", e)
    assert huber is not None
    assert tukey is not None
    np.testing.assert_allclose(huber[:2000] * 200, 1.345 * scale(e), rtol=1e-4)
    assert not tukey[:2000].any()
    assert tukey[2000:].mean() > 0.8


def test_rests_without_a_picture_and_before_a_wall(texture: np.ndarray) -> None:
    """It says why."""
    law, goal = Photometric(margin_px=4), goal_of(texture)
    for image, why in ((None, NO_PICTURE), (Sight(np.full_like(goal.image.image, 90)), BLANK)):  # pyright: ignore[reportOptionalMemberAccess] - it has one
        _, command = law.step(law.init(goal), looked(image), goal, np.eye(6))
        assert isinstance(command, Command)
        assert command.rest_reason == why
        assert not command.twist.any()
    with pytest.raises(ParameterError, match=r"goal\.image is missing"):
        law.step(law.init(goal), looked(goal.image), replace(goal, image=None), np.eye(6))


def test_depth_of_the_pixels(texture: np.ndarray) -> None:
    """With a goal plane at 1 m a constant depth of 1 m is the same law; a depth picture too, whose
    holes do not count.
    """
    goal = goal_of(texture)
    image = seen(texture, exp(np.array([0.01, 0, 0, 0, 0, 0.02])) @ AT_GOAL)
    plane, constant = (
        Photometric(margin_px=4, depth=d) for d in (Photometric().depth, Constant(depth_m=1.0))
    )
    twists = [
        law.step(law.init(goal), looked(image), goal, np.eye(6))[1].twist
        for law in (plane, constant)
    ]
    np.testing.assert_allclose(*twists, rtol=1e-4)
    assert Photometric().damping.at(3.0) == 0.01
    assert Photometric().damping.at(4.0) == 0.0001


def test_runs_converges_and_knows_it_by_grey_levels(file: Path) -> None:
    """In the loop: no marker, the judged error in grey levels, the truth under a millimetre."""
    vs.testing.check_law(scenario_of(file).law, scenario_of(file))
    r = vs.run(scenario_of(file))
    summary = r.summary()
    assert (summary["outcome"], summary["judged_unit"], summary["judged_limit"]) == (
        "converged",
        "grey levels",
        0.5,
    )
    assert summary["final_error_px"] is None
    assert summary["final_error_grey"] == r["error_grey"][-1] < 0.5
    assert Metric.named("final_error_grey").label == "Measured image error [grey levels]"
    assert r["position_error_m"][-1] < 1e-2
    assert not r["lost"].any()
    assert "u_0" not in r.columns


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (
            {"stop": {"converged": {"error_px": 0.2}}},
            "error_px: needs markers, and detector none finds none",
        ),
        ({"law": {"kind": "ibvs"}}, "detector: may not be none"),
        ({"law": {"kind": "photometric", "depth": "pnp"}}, "needs it of pixels"),
        ({"law": {"kind": "photometric", "depth": "sensor"}}, "or use goal or constant"),
        ({"detector": {"kind": "blobs"}}, "no markers are drawn .*; use none"),
        ({"detector": {"kind": "keypoints"}}, "reads no points of it; use none"),
        ({"law": {"kind": "photometric", "levels": 6}}, "at the coarsest level"),
        (
            {"camera": {"kind": "fisheye", "width": 160, "height": 120}},
            "camera: must be of kind perspective for law photometric",
        ),
        (
            {"law": {"kind": "ibvs", "depth": "oracle"}, "detector": {"kind": "oracle"}},
            "error_grey: is of a law that works on grey levels",
        ),
        (
            {"goal": {"T_camera_target": {"xyz": [0, 0, 1]}, "picture": "nowhere.png"}},
            "is not there",
        ),
        (
            {
                "goal": {
                    "T_camera_target": {"xyz": [0, 0, 1]},
                    "picture": {"file": "x.png", "brightness": 0.5},
                }
            },
            "leave it out, or the file",
        ),
    ],
)
def test_refusals(file: Path, changed: dict[str, object], words: str) -> None:
    """Each names what is wrong and what works."""
    with pytest.raises((ParameterError, ScenarioError), match=words):
        scenario_of(file, **changed)


def test_depth_of_markers_is_refused() -> None:
    """The pose of markers tells nothing of a pixel's depth."""
    with pytest.raises(ParameterError, match="goal, constant or sensor"):
        Photometric(depth=PnP())


@pytest.mark.parametrize("axis", [0, 1])
def test_one_step_is_a_few_per_cent_shorter_than_the_motion_that_it_measures(axis: int) -> None:
    """From 0.26, 0.52 and 0.87 px aside (f = 870 px, 1 m) the first command, over its gain, moves
    the picture by 92 to 100 % of that.

    A step aside and a turn look nearly alike here. What they make together is compared: in the
    middle of the picture x' = -(v_x / Z + w_y), y' = -(v_y / Z - w_x).
    """
    scenario, gain = vs.load("camera_photometric", {"stop.duration_s": 0.1}), 30.0
    for aside in (0.0003, 0.0006, 0.001):
        start = scenario.T_world_goal.copy()
        start[:3, 3] += aside * start[:3, axis]
        first = vs.run(replace(scenario, robot=scenario.robot.started_at(start.ravel())))
        v, w = (first[f"cmd_v{'xy'[axis]}"][0], first[f"cmd_w{'yx'[axis]}"][0] * (1, -1)[axis])
        assert 0.92 < -(v + w) / gain / aside < 1.0
