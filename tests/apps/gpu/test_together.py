"""Runs that fly together: each as alone, their pictures by one call; what fails, and what a device
does not draw.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mujoco_warp")

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.apps.gpu.together import Together, TogetherPool, device, must_fly_together
from vstestbed.apps.gpu.warp import Device, PictureRequest
from vstestbed.core.errors import EnvironmentLackError, ParameterError
from vstestbed.loop.session import run
from vstestbed.scenario.load import seeded
from vstestbed.studies.pools import Request, WorkerLostError, pool_of

WORLDS, FRAMES = 8, 40
ROBOTS = "arm_ibvs", "quadrotor_hover", "omni_ibvs", "car_pbvs"


def short(name: str, frames: int = FRAMES) -> vs.Scenario:
    rate = vs.load(name).camera.rate_hz
    return vs.load(name, {"stop.duration_s": frames / rate})


def flown(scenarios: Sequence[vs.Scenario]) -> list[vs.Recording]:
    return [
        done.result()
        for done in Together(device()).fly([lambda one=one: run(one) for one in scenarios])
    ]


def places(one: vs.Recording) -> np.ndarray:
    """Where the markers were seen [px], (frames, 2 N)."""
    return np.stack(
        [one[name] for name in one.columns if name.startswith(("u_", "v_")) and name[2:].isdigit()],
        axis=1,
    )


@pytest.mark.parametrize("name", ROBOTS)
def test_runs_that_fly_together_agree_with_those_that_fly_alone(name: str) -> None:
    worlds = [seeded(short(name), seed) for seed in range(WORLDS)]
    found = flown(worlds)
    assert all("mujoco_warp" in one.versions["renderer"] for one in found)
    assert len({places(one)[0].tobytes() for one in found}) == WORLDS  # each from its own start
    by_rays = run(
        seeded(
            vs.load(
                name, {"stop.duration_s": worlds[0].stop.duration_s, "camera.renderer": "rays"}
            ),
            0,
        )
    )
    assert found[0].outcome is by_rays.outcome
    assert len(found[0].rows) == len(by_rays.rows) >= FRAMES // 2
    assert np.nanmax(np.abs(places(found[0]) - places(by_rays))) < 0.3


VIEWS = [
    *((name, WORLDS) for name in ROBOTS),
    *((name, 200) for name in ("arm_fisheye", "arm_spherical", "omni_catadioptric", *ROBOTS)),
]


@pytest.mark.parametrize(
    ("name", "views"), one_quick(*VIEWS[:4], every=1) + one_quick(None, *VIEWS[4:])[1:]
)
def test_markers_are_seen_as_near_to_the_truth_as_where_opengl_draws_them(
    name: str, views: int
) -> None:
    """Of small markers each renderer's few samples a pixel leave some hundredths of a pixel,
    OpenGL's four as many as these four.
    """

    def worlds(**more: object) -> list[vs.Scenario]:
        changed = {
            "camera.multisampling": 4,
            "stop.duration_s": 2 / vs.load(name).camera.rate_hz,
            **more,
        }
        return [seeded(vs.load(name, changed), seed) for seed in range(views)]

    drawn = np.array([places(one)[0] for one in flown(worlds())])
    by_gl, true = (
        np.array([places(run(one))[0] for one in made])
        for made in (worlds(), worlds(detector={"kind": "oracle"}))
    )
    apart, own, opengl = (
        np.abs(a - b)[np.isfinite(a - b)] for a, b in ((drawn, by_gl), (drawn, true), (by_gl, true))
    )
    told = "; ".join(
        f"{what} median {np.median(d):.3f}, 95 % {np.quantile(d, 0.95):.3f}, most {d.max():.3f}"
        for what, d in (
            ("from OpenGL's", apart),
            ("from the true", own),
            ("OpenGL's from the true", opengl),
        )
    )
    print(f"{name}, {views} views [px]: {told}")
    # of the car some are too small to be sure of
    assert np.mean(np.isfinite(drawn) != np.isfinite(by_gl)) < 0.1
    assert np.median(apart) < 0.05
    assert np.quantile(apart, 0.95) < 0.15
    assert np.quantile(own, 0.9) < (1.3 if views == WORLDS else 1.05) * np.quantile(opengl, 0.9)


@pytest.mark.parametrize(
    "name", one_quick("arm_ibvs", "omni_ibvs", "car_line", "arm_fisheye", "arm_two_eyes")
)
def test_a_run_does_not_depend_on_those_beside_it(name: str) -> None:
    scenario = short(name, 15)
    (alone,) = flown([scenario])
    beside = flown([short(name, 4), scenario, short("arm_mesh", 6)])
    assert beside[1].table.tobytes() == alone.table.tobytes()
    assert beside[1].outcome is alone.outcome


def test_runs_go_on_in_turn_and_an_error_is_its_own() -> None:
    inside, most = 0, 0

    class Nothing(Device):
        name = "nothing"

        def __init__(self) -> None:
            self.calls: list[int] = []

        def draw(self, shots: Sequence[Any]) -> list[Any]:
            self.calls.append(len(shots))
            return [[shot] for shot in shots]

    nothing = Nothing()
    group = Together(nothing)

    def task(n: int) -> int:
        nonlocal inside, most
        for i in range(n):
            inside += 1
            most = max(most, inside)
            inside -= 1
            assert group.draw(i) == [i]  # pyright: ignore[reportArgumentType] - any object will do for this device
        if n == 2:
            raise ValueError("two")
        return n

    results = group.fly([lambda n=n: task(n) for n in (3, 2, 1, 0)])
    assert [done.exception() is None for done in results] == [True, False, True, True]
    assert str(results[1].exception()) == "two"
    assert [results[i].result() for i in (0, 2, 3)] == [3, 1, 0]
    assert nothing.calls == [3, 2, 1]
    assert most == 1


def test_a_device_that_fails_is_told_by_every_run_and_none_waits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(self: Device, shots: Sequence[PictureRequest]) -> Any:
        raise RuntimeError("out of memory")

    monkeypatch.setattr(Device, "draw", full)
    done = Together(device()).fly([lambda: run(short("arm_ibvs", 3)) for _ in range(2)])
    for one in done:
        with pytest.raises(EnvironmentLackError, match="out of memory"):
            one.result()


@pytest.mark.parametrize(
    ("changed", "field"),
    [
        ({"camera.renderer": "gl"}, "camera.renderer"),
        ({"camera.shadows": True}, "camera.shadows"),
        ({"world.floor": {"mirror": 0.3}}, "world.floor.mirror"),
    ],
)
def test_what_a_device_does_not_draw_is_refused_by_its_field(changed: dict, field: str) -> None:
    with pytest.raises(ParameterError, match="executor warp draws") as refused:
        must_fly_together([vs.load("arm_ibvs"), vs.load("arm_ibvs", changed)])
    assert refused.value.field == field


@pytest.mark.parametrize("missing", ["greenlet", "mujoco_warp", "warp"])
def test_what_is_missing_is_named(
    missing: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in (
        "vstestbed.apps.gpu.together",
        "vstestbed.apps.gpu.warp",
        "vstestbed.apps.gpu.warp_kernels",
    ):
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(
        EnvironmentLackError, match=f"MuJoCo Warp is not installed .*{missing}"
    ) as lack:
        pool_of("warp", 1, tmp_path)
    assert "vstestbed[gpu]" in str(lack.value)


def double(n: int, place: str | None = None) -> int:
    if n == 13:
        raise ValueError("thirteen")
    if n == 99:
        os._exit(1)
    return 2 * n


@pytest.mark.process
def test_a_worker_that_dies_takes_its_runs_with_it_and_a_second_try_flies_alone(
    tmp_path: Path,
) -> None:
    pool = TogetherPool(1, tmp_path)
    requests = {n: Request(str(n), double, (n,)) for n in (1, 2, 13, 99)}
    try:
        futures = {n: pool.submit(request) for n, request in requests.items()}
        pool.dispatch()
        assert all(isinstance(future.exception(60), WorkerLostError) for future in futures.values())
        again = {n: pool.submit(request) for n, request in requests.items()}
        while pool._waiting:
            pool.dispatch()
        assert isinstance(again[99].exception(60), WorkerLostError)
        assert [again[n].result(60) for n in (1, 2)] == [2, 4]
        assert str(again[13].exception(60)) == "thirteen"
        assert pool.tries(requests[99]) == 2
    finally:
        pool.close()


@pytest.mark.process
def test_compare_by_warp_is_complete_without_films_and_tells_what_it_does_not_draw(
    command, one_figure: None
) -> None:
    words = (
        "compare",
        "arm_ibvs",
        "arm_pbvs",
        "--seeds",
        2,
        "--set",
        "stop.duration_s=0.4",
        "--executor",
        "warp",
        "--out",
        "found",
    )
    ended = command(*words, "--no-figures")
    assert ended.code == 0, ended.err
    summaries = [json.loads(path.read_text()) for path in Path("found/runs").rglob("summary.json")]
    assert len(summaries) == 4
    assert all("mujoco_warp" in one["versions"]["renderer"] for one in summaries)
    assert not list(Path("found").rglob("*.mp4"))
    # by rays: OpenGL stays out of a process with Warp
    assert len(list(Path("found/runs").rglob("end.png"))) == 4
    refused = command(
        "compare", "arm_ibvs", "--set", "camera.shadows=true", "--executor", "warp", "--out", "none"
    )
    assert refused.code != 0
    assert "camera.shadows" in refused.err


@pytest.mark.study
def test_a_hundred_starts_end_as_by_opengl() -> None:
    """The outcome, and the time to the goal as closely as of runs whose target is a micrometre
    elsewhere, which no detector can tell.
    """

    def reached_s(one: vs.Recording) -> float:
        after = one.summary()["time_to_converge_s"]
        return np.nan if after is None else after

    given = vs.load("arm_ibvs")
    worlds = [seeded(given, seed) for seed in range(100)]
    moved = replace(
        given,
        target=replace(
            given.target,
            pose=replace(given.target.pose, xyz=tuple(np.add(given.target.pose.xyz, [1e-6, 0, 0]))),
        ),
    )
    together = [one for i in range(0, 100, 20) for one in flown(worlds[i : i + 20])]
    by_gl = [run(world) for world in worlds]
    beside = [run(seeded(moved, seed)) for seed in range(100)]
    apart = {}
    for what, found in (("together", together), ("moved by a micrometre", beside)):
        same = sum(one.outcome is other.outcome for one, other in zip(found, by_gl, strict=True))
        frames = (
            np.array(
                [
                    abs(reached_s(one) - reached_s(other))
                    for one, other in zip(found, by_gl, strict=True)
                ]
            )
            / given.camera.period
        )
        frames = frames[np.isfinite(frames)]
        apart[what] = frames
        print(
            (
                f"{what}: {same} of 100 the same outcome; {len(frames)} times,"
                f" {100 * np.mean(frames < 1.5):.0f} % within one frame, "
            ),
            end="",
        )
        print(f"median {np.median(frames):.1f} frames, 95 % {np.quantile(frames, 0.95):.0f}")
        assert same >= 99
    own, other = apart["together"], apart["moved by a micrometre"]
    assert np.median(own) <= np.median(other) + 2
    assert np.quantile(own, 0.95) < 2 * np.quantile(other, 0.95)
