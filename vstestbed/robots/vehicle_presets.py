"""Sets of imperfections of the vehicles (`robot.realism`); their values are chosen, models/README.md says from what."""

from __future__ import annotations

from collections.abc import Mapping

from vstestbed.robots.realism import Level
from vstestbed.robots.tyres import Tyres
from vstestbed.robots.uneven_floor import UnevenFloor
from vstestbed.robots.wheels import WheelSpread

CAR: Mapping[Level, Mapping[str, object]] = {
    "lab": {
        "tyres": Tyres(stiffness=12.0, relaxation_m=0.1),
        "steering_play_deg": 0.5,
        "drive_lag_s": 0.05,
        "wheel_spread": WheelSpread(sigma=0.001),
        "uneven_floor": UnevenFloor(rms_m=0.0005, correlation_m=0.3),
    },
    "field": {
        "tyres": Tyres(stiffness=6.0, relaxation_m=0.25),
        "rolling_resistance": 0.03,
        "steering_play_deg": 2.0,
        "drive_lag_s": 0.2,
        "wheel_spread": WheelSpread(sigma=0.005),
        "uneven_floor": UnevenFloor(rms_m=0.005, correlation_m=0.5),
    },
}
OMNI: Mapping[Level, Mapping[str, object]] = {
    "lab": {
        "rolling_resistance": 0.01,
        "drive_lag_s": 0.03,
        "wheel_spread": WheelSpread(sigma=0.001),
        "uneven_floor": UnevenFloor(rms_m=0.0002, correlation_m=0.3),
    },
    "field": {
        "rolling_resistance": 0.03,
        "drive_lag_s": 0.1,
        "wheel_spread": WheelSpread(sigma=0.004),
        "uneven_floor": UnevenFloor(rms_m=0.001, correlation_m=0.3),
    },
}
