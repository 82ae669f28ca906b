"""Identification: what was put into a simulated robot is found in its record, and what cannot be told apart is said."""

import numpy as np
import polars as pl
import pytest

import vstestbed as vs
from tests.shortcuts import one_quick
from vstestbed.core.errors import ParameterError, RunFolderError, ScenarioError
from vstestbed.studies import identification as idn
from vstestbed.studies.identification import Parameter

LAG = Parameter("robot.drive_lag_s", 0.001, 0.5)
LATENCY, STAMPS = Parameter(idn.COMMAND_LATENCY, 0.0, 0.5), Parameter(idn.STAMPS, -0.2, 0.5)
TRUTH = {"robot.drive_lag_s": 0.08, "timing.command_latency_s": 0.032, "camera.latency_s": 0.04, "noise.pixel_sigma_px": 0.3}
PLANAR = {"robot.wheels": "planar"}  # without contacts a run takes a tenth of the time


@pytest.fixture(scope="module")
def record():
    scenario = vs.load("omni_ibvs", {**TRUTH, **PLANAR, "detector": "oracle"})
    motion = idn.motion_of(scenario)
    return idn.fly(scenario, motion[:100])  # a step ahead and back, and the next one


def test_a_motion_ends_where_it_began_and_moves_all():
    for name, n in (("arm_ibvs", 6), ("omni_ibvs", 3), ("car_line", 2), ("quadrotor_perspective", 4)):
        motion = idn.motion_of(vs.load(name))
        u = motion.drop("t").to_numpy()
        assert u.shape[1] == n and (np.abs(u).max(axis=0) > 0.05).all()
        np.testing.assert_allclose(u.sum(axis=0), 0, atol=1e-9)
        assert (u[:10] == 0).all() and (u[-10:] == 0).all()


@pytest.mark.parametrize("fit", one_quick([LAG], [LATENCY, STAMPS, LAG]))
def test_what_was_put_in_is_found_and_is_a_preset_of_the_robot(record, tmp_path, fit):
    found = idn.identify(record, vs.load("omni_ibvs", {**PLANAR, "timing.command_latency_s": 0.032}), fit)
    true = {"robot.drive_lag_s": 0.08, idn.COMMAND_LATENCY: 0.032, idn.STAMPS: 0.0}
    for p, value, half in zip(found.parameters, found.values, found.half, strict=True):
        assert value == pytest.approx(true[p.field], abs=max(half, 1e-6)) and half < 0.006, p.field
    assert found.latency_s == pytest.approx(0.04) and found.noise["markers"] == pytest.approx(0.3, rel=0.25)
    assert found.residual < 1.5 and found.together == []
    page = idn.write(tmp_path, found, "record", "vstestbed identify").read_text(encoding="utf-8")
    assert "The simulator reads what the robot read" in page
    scenario = vs.load("omni_ibvs", {"robot.realism": str(tmp_path / "robot.yaml"), **idn.overrides(found)})
    assert scenario.robot.drive_lag_s == pytest.approx(0.08, rel=0.02) and scenario.robot.realism == "none"
    assert scenario.camera.latency_s == pytest.approx(0.04, abs=5e-3)
    both = vs.load("omni_ibvs", {"robot.realism": str(tmp_path / "robot.yaml"), "robot.drive_lag_s": 0.5})
    assert both.robot.drive_lag_s == 0.5  # what is given stays


def test_without_joints_two_latencies_are_one(record):
    """Of pictures alone the command's latency and the stamps' delay shift the same: only their sum is told, and the page says so."""
    pictures = record.drop([name for name in record.columns if name.startswith(("q_", "qd_", "t_q"))])
    found = idn.identify(pictures, vs.load("omni_ibvs", {**PLANAR, "robot.drive_lag_s": 0.08}), [LATENCY, STAMPS])
    assert [(a, b) for a, b, _ in found.together] == [(LATENCY.field, STAMPS.field)]
    assert not np.isfinite(found.half).any()
    assert found.values.sum() == pytest.approx(0.032, abs=2.5e-3)


def test_what_is_no_record_or_no_parameter_is_refused(record, tmp_path):
    for words in ("robot.drive_lag_s", "robot.drive_lag_s=1..0", "=0..1", "a=b..c"):
        with pytest.raises(ParameterError, match="--fit needs the form"):
            Parameter.of(words)
    assert Parameter.of("robot.servo_kv=x0.5..x2") == Parameter("robot.servo_kv", 0.5, 2.0, factor=True)
    with pytest.raises(RunFolderError, match=r"has no record\.parquet"):
        idn.read_record(tmp_path)
    (tmp_path / "a.csv").write_text("x,y\n1,2\n")
    with pytest.raises(RunFolderError, match="has the columns x, y"):
        idn.read_record(tmp_path / "a.csv")
    with pytest.raises(ParameterError, match="commands of 3 motions, and robot puma560 has 6"):
        idn.identify(record, vs.load("arm_ibvs"))
    with pytest.raises(ParameterError, match="has none of q_"):
        idn.identify(record.select("t", "arrived", "u_0", "u_1", "u_2"), vs.load("omni_ibvs"))
    with pytest.raises(ScenarioError, match="unknown field"):
        idn.identify(record, vs.load("omni_ibvs"), [Parameter("robot.nothing", 0, 1)])
    with pytest.raises(ScenarioError, match="realism"):
        vs.load("omni_ibvs", {"robot.realism": str(tmp_path / "no.yaml")})


def test_a_table_of_ones_own_is_read(record, tmp_path):
    record.write_csv(tmp_path / "mine.csv")
    again = idn.read_record(tmp_path / "mine.csv")
    np.testing.assert_allclose(again.to_numpy(), record.to_numpy())
    assert isinstance(again, pl.DataFrame)
