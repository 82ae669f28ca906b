"""Robots, in numpy only: kinematics, limits, onboard controllers, sensor models. Their bodies are
MJCF files in models/.
"""

from collections.abc import Callable, Mapping

from vstestbed.core.registry import Contract, Registry
from vstestbed.robots.allocation import Actuation, Allocation, Mount, Order
from vstestbed.robots.arm import Arm
from vstestbed.robots.base import BodyFile, Onboard, Reading, Robot, RobotBase
from vstestbed.robots.car import Car
from vstestbed.robots.compound import Compound
from vstestbed.robots.free import Free
from vstestbed.robots.mjcf import Mjcf
from vstestbed.robots.omni import Omni
from vstestbed.robots.puma560 import Puma560
from vstestbed.robots.quadrotor import Quadrotor
from vstestbed.robots.vehicle import Vehicle

ROBOTS = Registry(
    "robot",
    Free,
    Puma560,
    Mjcf,
    Compound,
    Omni,
    Car,
    Quadrotor,
    contract=Contract(Robot, base=Robot),
)
# Robots that can carry a target along a route (`Carried.by`)
VEHICLES: Mapping[str, Callable[[], Vehicle]] = {"omni": Omni, "car": Car}

__all__ = [
    "ROBOTS",
    "VEHICLES",
    "Actuation",
    "Allocation",
    "Arm",
    "BodyFile",
    "Car",
    "Compound",
    "Free",
    "Mjcf",
    "Mount",
    "Omni",
    "Onboard",
    "Order",
    "Puma560",
    "Quadrotor",
    "Reading",
    "Robot",
    "RobotBase",
    "Vehicle",
]
