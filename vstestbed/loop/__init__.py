"""The time loop: exposures, the frame controller, verdicts, the log of a run and its metrics."""
