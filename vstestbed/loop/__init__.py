"""The time loop: exposures, the controller, the record of a run, its log and its metrics."""
