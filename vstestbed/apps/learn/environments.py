"""Environments for learners: every scenario as a Gymnasium and as a dm_env environment, over
`vstestbed.Session`.

    import gymnasium, vstestbed.env

    # One id for each bundled scenario:
    env = gymnasium.make("vstestbed/arm_ibvs-v0", observation="pixels")
    env = vstestbed.env.make("my.yaml", reward="sparse")  # any other
    env = vstestbed.env.dm("arm_ibvs")  # a dm_env.Environment

To import this registers the ids. Gymnasium is an extra (`pip install 'vstestbed[env]'`), dm_env is
not.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vstestbed.core.errors import EnvironmentLackError
from vstestbed.core.named_files import bundled_scenarios

if TYPE_CHECKING:
    import gymnasium

    from vstestbed.apps.learn.deepmind import DmServo
    from vstestbed.scenario.scenario import Scenario

# the id of any scenario, whose keyword `scenario` names it: for `gymnasium.make_vec` of one's own
# file
ANY = "vstestbed/scenario-v0"
__path__ = [
    str(Path(__file__).parent)
]  # so that `vstestbed.env` has parts: `vstestbed.env.gym_env`
REMEDY = "pip install 'vstestbed[env]'"


def make(scenario: str | Path | Scenario, **settings: Any) -> gymnasium.Env[dict[str, Any], Any]:
    """A Gymnasium environment of any scenario (a YAML file, a bundled name, or a loaded one),
    `gymnasium.make` of the id ANY. settings: as of `GymServo` or `gymnasium.make`. Errors: those of
    `GymServo`; EnvironmentLackError where Gymnasium is not installed.
    """
    if find_spec("gymnasium") is None:
        raise EnvironmentLackError("Gymnasium is not installed", REMEDY)
    import gymnasium

    return gymnasium.make(ANY, scenario=scenario, **settings)


def dm(scenario: str | Path | Scenario, *, seed: int | None = None, **settings: Any) -> DmServo:
    """A dm_env environment of any scenario (a YAML file, a bundled name, or a loaded one).
    settings: as of `rollout.Rollout`. seed: of the seeds that episodes get, one after the other;
    None: other ones each time.
    Raises ScenarioError: the scenario has mistakes. ParameterError: a setting is none of the
    possible ones.
    """
    from vstestbed.apps.learn.deepmind import DmServo
    from vstestbed.apps.learn.rollout import Rollout

    return DmServo(Rollout(scenario, **settings), seed)


if find_spec("gymnasium") is not None:
    from gymnasium import register

    def _register(name: str, **settings: str) -> None:
        entry, vector = (
            "vstestbed.apps.learn.gym_env:GymServo",
            "vstestbed.apps.learn.vector_env:GymServos",
        )
        register(name, entry_point=entry, vector_entry_point=vector, kwargs=settings)

    _register(ANY)
    for _name in bundled_scenarios():
        _register(f"vstestbed/{_name}-v0", scenario=_name)
