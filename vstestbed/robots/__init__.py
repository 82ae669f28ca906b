"""Robots, in numpy only: what they can do, how a command becomes a setpoint, their limits. Their bodies are in models/."""

from vstestbed.robots.base import Allocation, Mount, Robot, Servo
from vstestbed.robots.free import Free
from vstestbed.robots.puma560 import Puma560
from vstestbed.spec import OneOf

ROBOTS = OneOf("robot", Free, Puma560)

__all__ = ["ROBOTS", "Allocation", "Free", "Mount", "Puma560", "Robot", "Servo"]
