"""What the log has of a flight besides what it has of every run."""

from __future__ import annotations

import math

import numpy as np

from vstestbed.core.geometry import Array
from vstestbed.features.observation import Goal, Observation
from vstestbed.loop.failsafe import Pilot
from vstestbed.robots.attitude import level
from vstestbed.robots.base import Encoders
from vstestbed.scenario.scenario import Scenario
from vstestbed.sim.base import Truth


def flight_columns(scenario: Scenario) -> tuple[str, ...]:
    """Names of a flight's columns; none where nothing flies.

    `fly_roll`, `fly_pitch` [rad], `fly_vx`, `fly_vy`, `fly_vz` (level frame) [m/s], `fly_wx`, `fly_wy`, `fly_wz` (body) [rad/s]: the
    craft's own estimate; `ask_roll`, ..., `ask_wz`: what its velocity loop and its attitude loop ask for; `level_error_px`: as
    `error_px`, of what the law is given, the picture turned level as the scenario derotates; `wind_x`, ... in the world [m/s];
    `speed_NAME`: of each rotor [rad/s]; `pilot`: 0 follows the law, 1 holds, 2 sinks, 3 rotors off.
    """
    if not scenario.robot.feet:
        return ()
    estimate = ("fly_roll", "fly_pitch", "fly_vx", "fly_vy", "fly_vz", "fly_wx", "fly_wy", "fly_wz")
    asked = ("ask_roll", "ask_pitch", "ask_wx", "ask_wy", "ask_wz")
    speeds = (f"speed_{name}" for name in scenario.robot.actuators)
    return (*estimate, *asked, "level_error_px", "wind_x", "wind_y", "wind_z", *speeds, "pilot")


def flight_row(scenario: Scenario, encoders: Encoders, truth: Truth, seen: Observation, goal: Goal, pilot: Pilot) -> Array:
    """The numbers of `flight_columns` at one exposure."""
    told, aloft = encoders.instruments, truth.aloft
    roll, pitch = told["tilt"].tolist()
    up = (-math.sin(pitch), math.cos(pitch) * math.sin(roll), math.cos(pitch) * math.cos(roll))
    velocity = level(up).to_level(tuple(told["flown_velocity"].tolist()))
    wind, act = (aloft.wind, aloft.act) if aloft else (np.full(3, np.nan), np.full(len(scenario.robot.actuators), np.nan))
    error = level_error(scenario, seen, goal)
    loops = told["flown_rates"], told["asked_tilt"], told["asked_rates"]
    return np.array([roll, pitch, *velocity, *np.concatenate(loops), error, *wind, *np.sqrt(np.maximum(act, 0.0)), pilot.mode])


def level_error(scenario: Scenario, seen: Observation, goal: Goal) -> float:
    """RMS over the coordinates of goal minus what the law is given, as pixels of the camera [px]; NaN where nothing is seen."""
    p = np.column_stack([seen.xy, np.ones(len(seen.xy))]) if seen.ray is None else seen.ray
    error = scenario.believed_camera.project(p) - goal.uv
    error = error[np.isfinite(error[:, 0])]
    return float(np.sqrt(np.mean(error**2))) if error.size else math.nan
