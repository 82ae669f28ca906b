"""Effects of one's own: forces are added to those of others, columns are checked, and what does not
fit is told with its place.
"""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np
import pytest

import vstestbed as vs
from vstestbed.core.errors import ParameterError, ScenarioError
from vstestbed.effects import Actor

QUICK = {"detector": "oracle", "stop.duration_s": 0.2}


@vs.spec
class Twister(vs.EffectBase):
    """A constant torque on the first joint.

    Args:
        torque_nm: of the motor [Nm].
        values: how many it reports [1].
    """

    kind: Literal["twister"] = "twister"
    torque_nm: float = 0.0
    values: int = 1
    columns: ClassVar[tuple[str, ...]] = ("twist_nm",)

    def check(self, joints: tuple[str, ...]) -> None:
        if self.torque_nm > 100:
            raise ParameterError(
                "torque_nm", f"must be at most 100 for {joints[0]}", self.torque_nm
            )

    def actor(self, body: Any, rng: np.random.Generator) -> Actor:
        return Torque(self, body)


class Torque(Actor):
    def __init__(self, effect: Twister, body: Any):
        self.effect, self.at, self.data, self.force = (
            effect,
            body.at.motor_qvel[0],
            body.data,
            np.zeros(body.model.nv),
        )

    def act(self, t: float, dt: float) -> None:
        self.force[self.at] = self.effect.torque_nm

    def row(self) -> tuple[float, ...]:
        return (float(self.data.qfrc_applied[self.at]),) * self.effect.values


@pytest.fixture
def twister(own_kinds) -> None:
    vs.EFFECTS.add(Twister)


def table(*effects: dict[str, Any], **given: Any) -> Any:
    return vs.run(
        vs.load(
            "arm_ibvs",
            QUICK | {"robot.effects": [{"kind": "twister"} | e for e in effects]} | given,
        )
    ).frame()


def test_its_force_is_added_to_those_of_other_effects(twister) -> None:
    """In an arm with current loops, whose motors are an effect, too."""
    field = {"robot.realism": "field"}
    plain = vs.run(vs.load("arm_ibvs", QUICK | field)).frame()
    nothing, some = table({}, **field), table({"torque_nm": 5.0}, **field)
    assert np.array_equal(nothing["q_joint_1"], plain["q_joint_1"])
    assert not np.array_equal(some["q_joint_1"], plain["q_joint_1"])
    assert nothing["twist_nm"].abs().max() > 0.01  # the motor's own torque


def test_without_others_it_is_all_that_is_applied(twister) -> None:
    assert set(table({"torque_nm": 2.0})["twist_nm"][1:]) == {2.0}


@pytest.mark.parametrize(
    ("effects", "words"),
    [
        (
            [{"values": 2}],
            "Twister has the columns twist_nm; `row` of its actor must return as many",
        ),
        ([{"values": 0}], "Twister has the columns twist_nm"),
        ([{}, {}], "robot.effects must have columns of their own: the log has twist_nm twice"),
    ],
)
def test_columns_that_do_not_fit_are_refused(
    twister, effects: list[dict[str, Any]], words: str
) -> None:
    with pytest.raises(ParameterError, match=words):
        table(*effects)


def test_what_does_not_fit_the_robot_is_refused_with_its_place(twister) -> None:
    with pytest.raises(
        ScenarioError,
        match=r"robot\.effects\.1\.torque_nm: must be at most 100 for joint_1, got 200",
    ):
        table({}, {"torque_nm": 200.0})


def test_the_suite_refuses_an_effect_that_does_nothing(twister) -> None:
    with pytest.raises(AssertionError, match="the robot moves as without it"):
        vs.testing.check_effect(Twister())
    vs.testing.check_effect(Twister(torque_nm=5.0))


@vs.spec
class Derated(vs.EffectBase):
    """Motors that give at most 3 Nm in each joint, from 0.1 s on."""

    kind: Literal["derated"] = "derated"
    columns: ClassVar[tuple[str, ...]] = ("motor_1_nm",)

    def actor(self, body: Any, rng: np.random.Generator) -> Actor:
        return Limit(body)


class Limit(Actor):
    def __init__(self, body: Any):
        self.body = body

    def act(self, t: float, dt: float) -> None:
        if t >= 0.1:
            self.body.model.actuator_forcerange[:] = [-3.0, 3.0]

    def row(self) -> tuple[float, ...]:
        return (float(self.body.motor_torque()[0]),)


@pytest.mark.parametrize("realism", ["none", "field"])
def test_the_torque_of_the_motors_is_known_to_it_and_may_be_limited(
    own_kinds, realism: str
) -> None:
    """MuJoCo's own servos and current loops keep the limit alike; their lag is over within 20 ms.
    Cogging and ripple come on top.
    """
    vs.EFFECTS.add(Derated)
    frame = vs.run(
        vs.load("arm_ibvs", QUICK | {"robot.realism": realism, "robot.effects": ["derated"]})
    ).frame()
    torque = frame.select("^tau_.*$").to_numpy()
    assert np.array_equal(frame["motor_1_nm"], torque[:, 0])
    before, after = (np.abs(torque[frame["t"].to_numpy() >= t]).max() for t in (0.0, 0.15))
    assert before > 10 and after <= (3.0 if realism == "none" else 4.0)
