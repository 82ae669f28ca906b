"""Physical parameters of the robots for the pages, read from the models and from the classes that
the simulator itself uses.
"""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Iterable, Sequence
from typing import Any

import mujoco
import numpy as np

from vstestbed.core import fields as tree
from vstestbed.core.fields import DIMENSIONLESS, class_text, without_unit
from vstestbed.core.named_files import model_path
from vstestbed.effects.airframe import Downwash, GroundEffect, RotorDrag
from vstestbed.effects.floor import UnevenFloor
from vstestbed.effects.joints import CURVES
from vstestbed.effects.rotors import Battery, MotorSpread, RotorInertia, Vibration
from vstestbed.effects.wheels import Tyres, WheelSpread
from vstestbed.robots.attitude import Imu
from vstestbed.robots.car import Car, CarLimits, CarParameters, Compass
from vstestbed.robots.flight import Gains
from vstestbed.robots.flight_sensors import Flow
from vstestbed.robots.omni import Omni, OmniParameters
from vstestbed.robots.puma560 import ELBOW, FOREARM, OFFSET, SHOULDER, UPPER_ARM, Puma560
from vstestbed.robots.quadrotor import Quadrotor
from vstestbed.robots.realism import Level, Realistic
from vstestbed.robots.rotors import QuadrotorParameters
from vstestbed.robots.vehicle import Vehicle
from vstestbed.scenario.dump import flow_text

CLASSES: dict[str, type] = {
    cls.__name__: cls
    for cls in (
        *(
            Car,
            CarLimits,
            CarParameters,
            Compass,
            Flow,
            Gains,
            Imu,
            OmniParameters,
            Quadrotor,
            QuadrotorParameters,
        ),
        *(Tyres, UnevenFloor, WheelSpread, Vehicle),
    )
}
WORN: dict[str, type[Realistic]] = {"car": Car, "omni": Omni}
CLASSES |= {
    cls.__name__: cls
    for cls in (Battery, Downwash, GroundEffect, MotorSpread, RotorDrag, RotorInertia, Vibration)
}
SERVOS = ("industrial", "raw")
JOINTS = tuple(f"joint_{i}" for i in range(1, 7))


def fields(name: str, only: Sequence[str] = ()) -> Iterable[tuple[str, str, str, str]]:
    """Name, default, unit and sentence of the numbers of a class, as `vstestbed describe` has them.

    Args:
        name: of the class. only: the fields that are wanted; none: all but blocks.
    """
    cls = CLASSES[name]
    for field, text in class_text(cls).fields.items():
        value, unit = tree.fields(cls)[field].default, text.unit
        if (
            field == "kind"
            or (only and field not in only)
            or (not only and list(tree.fields(cls)[field].node.blocks()))
        ):
            continue
        shown = (
            plain(value)
            if isinstance(value, float)
            else "none"
            if value is None
            else flow_text(value)
        )
        yield (
            field,
            shown,
            "" if unit == DIMENSIONLESS else unit,
            with_zero(without_unit(text.description)).replace("|", "\\|"),
        )


def plain(value: float, digits: int = 6) -> str:
    """A number to so many significant digits, without trailing zeros; an exponent has a decimal
    before it: `4.0e-05`.
    """
    mantissa, e, exponent = f"{value:.{digits}g}".partition("e")
    return mantissa + (".0" if e and "." not in mantissa else "") + e + exponent


def with_zero(text: str) -> str:
    """A sentence whose decimals have their zero: `.02` becomes `0.02`."""
    return re.sub(r"(?<![\w.])\.(?=\d)", "0.", text)


PUMA_DH = np.array(
    [
        # d [m]   a [m]   alpha [rad]
        [SHOULDER, 0.0, np.pi / 2],
        [0.0, UPPER_ARM, 0.0],
        [OFFSET, ELBOW, -np.pi / 2],
        [FOREARM, 0.0, np.pi / 2],
        [0.0, 0.0, -np.pi / 2],
        [0.0, 0.0, 0.0],
    ]
)
"""The Puma's standard Denavit-Hartenberg table; the flange is frame 6, which the table leaves at
the wrist's centre (d_6 = 0).
"""


@functools.cache
def model(name: str) -> mujoco.MjModel:
    """A model of models/, compiled as it stands in its file."""
    return mujoco.MjModel.from_xml_path(str(model_path(name)))


def puma_links() -> list[dict[str, Any]]:
    """Each link of the Puma: its row of the Denavit-Hartenberg table, mass [kg], centre [m],
    moments of inertia [kg m^2].
    """
    made = model("puma560.xml")
    links = []
    for i, (d, a, alpha) in enumerate(PUMA_DH, 1):
        body = made.body(f"link_{i}")
        turned = np.zeros(9)
        mujoco.mju_quat2Mat(turned, body.iquat)
        R = turned.reshape(3, 3)
        inertia = np.diag(R @ np.diag(body.inertia) @ R.T)
        links.append(
            {
                "number": i,
                "d": d,
                "a": a,
                "alpha_deg": np.degrees(alpha),
                "mass": float(body.mass[0]),
                "centre": body.ipos.tolist(),
                "inertia": inertia.tolist(),
            }
        )
    return links


def puma_joints() -> list[dict[str, Any]]:
    """Each joint of the Puma: range [deg], largest speed [rad/s] and torque [Nm], and what its
    motor brings to the joint's side: armature [kg m^2], damping [Nm s/rad], Coulomb friction [Nm],
    and the gains of the servos.
    """
    made = model("puma560.xml")
    joints = []
    for name in JOINTS:
        joint, servos = made.joint(name), {kind: made.actuator(f"{kind}_{name}") for kind in SERVOS}
        row = {
            "number": int(name[-1]),
            "range_deg": np.degrees(joint.range).tolist(),
            "speed": float(servos["industrial"].ctrlrange[1]),
            "torque": float(servos["industrial"].forcerange[1]),
            "armature": float(joint.armature[0]),
            "damping": float(joint.damping[0]),
            "friction": float(joint.frictionloss[0]),
            "kp": float(servos["industrial"].gainprm[0]),
            "kv": -float(servos["industrial"].biasprm[2]),
            "raw_kv": float(servos["raw"].gainprm[0]),
        }
        joints.append(row | {"dead_band": row["friction"] / row["raw_kv"]})
    return joints


def arm_preset(level: Level) -> dict[str, str]:
    """What `robot.realism` gives the Puma, in numbers as a table shows them."""
    arm = Puma560(realism=level)
    gears, ripple, encoders, drives, geometry = (
        arm.gears,
        arm.ripple,
        arm.encoders,
        arm.drives,
        arm.geometry_error,
    )
    assert gears and ripple and encoders and drives and geometry
    return {
        "stiffness": ", ".join(plain(k) for k in gears.stiffness_nmprad if k),
        "damping": plain(gears.damping_s),
        "backlash": plain(gears.backlash_deg[0]),
        "cogging": ", ".join(plain(x) for x in ripple.cogging_nm),
        "share": plain(ripple.share),
        "counts": plain(float(round(encoders.counts[0] / encoders.turns[0]))),
        "eccentricity": plain(round(encoders.eccentricity_deg[0] * encoders.turns[0], 3)),
        "bandwidth": plain(drives.bandwidth_hz),
        "delay": plain(drives.delay_s),
        "sigma_m": plain(geometry.sigma_m),
        "sigma_deg": plain(geometry.sigma_deg),
    }


def strain_waves() -> list[tuple[int | str, ...]]:
    """Sizes of strain wave gears with t1, t2 [Nm], K1, K2, K3 [Nm/rad], as a table shows them."""
    return [(size, *(plain(x) for x in curve)) for size, curve in CURVES.items()]


def preset(kind: str, level: Level, field: str) -> str:
    """What a level of `realism` fills a robot's field with, as a scenario has it;
    "-" for nothing.
    """
    value = WORN[kind].presets.get(level, {}).get(field)
    if not dataclasses.is_dataclass(value):
        return "-" if value is None else f"`{value:g}`"
    changed = [
        (f.name, getattr(value, f.name))
        for f in dataclasses.fields(value)
        if getattr(value, f.name) != f.default
    ]
    return "`{" + ", ".join(f"{name}: {x:g}" for name, x in changed) + "}`"
