"""Targets: what a camera looks at, what its markers look like, how it moves."""
