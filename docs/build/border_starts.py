"""The starts of the suite's task `border`: displacements of the camera of an arm by which a marker
is near the border of the first picture.

    python -m docs.build.border_starts        # writes scenarios/suite/border_starts.json

Displacements are drawn at random, to a millimetre and a tenth of a degree; kept are those that the
arm reaches, from which all markers are in the picture, and the nearest is NEAR from its border.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

import vstestbed as vs
from vstestbed.core.errors import UnreachableError
from vstestbed.core.files import write_whole
from vstestbed.core.geometry import Pose
from vstestbed.scenario.scenario import Scenario

NUMBER = 60
NEAR = (4.0, 14.0)  # [px]
# largest displacement along each axis, about the picture's axes, about the optical axis
REACH_M, TILT_DEG, TURN_DEG = 0.3, 25.0, 110.0
PLACE = Path(__file__).resolve().parents[2] / "scenarios" / "suite" / "border_starts.json"


def margin(scenario: Scenario, start: Pose) -> float:
    """Distance of the nearest marker from the border of the picture at a displacement [px];
    negative outside.
    """
    camera = scenario.camera
    uv = camera.project(scenario.target.points_at(np.linalg.inv(start.T) @ scenario.goal_poses[-1]))
    return float(min(uv.min(), (np.array([camera.width, camera.height]) - 1 - uv).min()))


def starts() -> list[Pose]:
    """The displacements."""
    rng = np.random.default_rng(0)
    scenario = vs.load("arm_ibvs")  # of the task's plan
    found: list[Pose] = []
    while len(found) < NUMBER:
        xyz = rng.uniform(-REACH_M, REACH_M, 3).round(3)
        turns = (rng.uniform(-1, 1, 3) * [TILT_DEG, TILT_DEG, TURN_DEG]).round(1)
        start = Pose(xyz=tuple(xyz.tolist()), rpy_deg=tuple(turns.tolist()))
        if not NEAR[0] <= margin(scenario, start) <= NEAR[1]:
            continue
        try:
            scenario.displaced(start, "camera")
        except UnreachableError:
            continue
        found.append(start)
    return found


def main() -> None:
    """The command."""
    lines = [json.dumps({"xyz": start.xyz, "rpy_deg": start.rpy_deg}) for start in starts()]
    about = f"The {NUMBER} starts of the suite's task border: python -m docs.build.border_starts"
    write_whole(
        PLACE, f'{{"about": "{about}",\n"camera_from_goal": [\n' + ",\n".join(lines) + "\n]}\n"
    )


if __name__ == "__main__":
    main()
