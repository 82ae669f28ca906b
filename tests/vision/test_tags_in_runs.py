"""Tags in a whole run: the loop, the folder with the files of the tags, and what is refused."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import EnvironmentLackError, ScenarioError
from vstestbed.studies.run_folder import new_folder, run_into
from vstestbed.targets.markers import Tag
from vstestbed.vision.tags import tag_picture


def test_the_arm_converges_and_its_model_loads_alone(tmp_path: Path) -> None:
    scenario = vs.load("arm_tags", {"law.gain": 1.0})
    recording = run_into(new_folder(scenario, tmp_path / "run"), scenario, "none")
    assert recording.outcome is vs.Outcome.converged
    summary = recording.summary()
    assert summary["final_error_px"] < 0.2
    assert summary["frames_lost"] == 0
    seen = np.array(
        [[recording[f"{c}_{i}"] - recording[f"{c}_true_{i}"] for c in "uv"] for i in range(4)]
    )
    assert np.median(np.hypot(seen[:, 0], seen[:, 1])) < 0.03
    (tmp_path / "run").rename(tmp_path / "elsewhere")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "elsewhere" / "model.xml"))
    tags = [model.texture(f"target/apriltag_36h11_{i}") for i in range(4)]
    for i, texture in enumerate(tags):
        data = model.tex_data[texture.adr[0] :][: texture.width[0] * texture.height[0] * 3].reshape(
            texture.height[0], -1, 3
        )
        assert (data[..., 0] == tag_picture(Tag(), i)).mean() > 0.999 or (
            data[::-1, :, 0] == tag_picture(Tag(), i)
        ).mean() > 0.999


def test_a_run_that_cannot_start_leaves_no_assets(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise EnvironmentLackError("no OpenGL", "get some")

    monkeypatch.setattr("vstestbed.loop.plants.build_plant", broken)
    with pytest.raises(EnvironmentLackError):
        run_into(new_folder(vs.load("arm_tags"), tmp_path / "run"), vs.load("arm_tags"), "none")
    assert not (tmp_path / "run").exists()


def test_what_does_not_belong_together_is_refused() -> None:
    for scenario, setting, words in (
        (
            "arm_ibvs",
            {"detector": "tags"},
            (
                r"overrides: target.marker: may not be disc: detector tags sees tag;"
                r" with disc use detector blobs or oracle"
            ),
        ),
        (
            "arm_tags",
            {"detector": "blobs"},
            (
                r"target.marker: may not be tag: detector blobs sees disc, sphere;"
                r" with tag use detector tags or oracle"
            ),
        ),
        ("arm_tags", {"target.marker.size": 0.3}, r"target.*marker.size: must be under 0.2828 m"),
        (
            "arm_tags",
            {"target.marker.first_id": 584},
            r"marker.first_id: must be at most 583: family apriltag_36h11 has 587 tags",
        ),
        ("arm_tags", {"target.marker.family": "apriltag_36h12"}, r"target.marker.family"),
        ("arm_tags", {"target.marker.radius": 0.1}, r"target.marker.radius"),
    ):
        with pytest.raises(ScenarioError, match=words):
            vs.load(scenario, setting)


def test_the_oracle_sees_tags() -> None:
    assert (
        vs.run(vs.load("arm_tags", {"detector": "oracle", "stop.duration_s": 0.2})).summary()[
            "frames_lost"
        ]
        == 0
    )
