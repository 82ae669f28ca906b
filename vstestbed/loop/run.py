"""run(scenario): a session turned to its end."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable

from vstestbed.core.errors import ParameterError
from vstestbed.core.outcome import Outcome
from vstestbed.loop.episode import Episode
from vstestbed.loop.recording import Recording, Rows, Watcher
from vstestbed.scenario.scenario import Scenario


def run(scenario: Scenario, watch: Iterable[Watcher] = (), rows: Rows | None = None, *, pictures: bool = False) -> Recording:
    """Simulate a scenario from its nominal start until an outcome.

    Args:
        scenario: the experiment (`Scenario.randomised` draws another start).
        watch: receive every frame. A KeyboardInterrupt ends the run with the outcome `interrupted`.
        rows: where the rows of the log go; into memory by default.
        pictures: take whole pictures for those who watch, see `Session`.

    Raises:
        ParameterError: `scenario` is not a Scenario.
        EnvironmentLackError: a picture is needed that only OpenGL can draw, and it does not work here.
    """
    if not isinstance(scenario, Scenario):
        raise ParameterError("scenario", "must be a Scenario: vstestbed.run(vstestbed.load('arm_ibvs'))", scenario)
    episode = Episode(scenario, pictures, tuple(watch), rows)
    with contextlib.closing(episode), contextlib.suppress(KeyboardInterrupt):
        while episode.outcome is None:
            episode.advance()
    return episode.recording()


def uninterrupted(recording: Recording) -> Recording:
    """The recording of a run in a study, which ends as a whole where the run was interrupted.

    Raises:
        KeyboardInterrupt: the outcome is `interrupted`; without it the study would go on with its next run.
    """
    if recording.outcome is Outcome.interrupted:
        raise KeyboardInterrupt
    return recording
