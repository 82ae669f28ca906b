"""Names of the folders of a comparison's runs."""

from __future__ import annotations

SIDE_BY_SIDE = 1000
"""Most folders in one: file browsers, and some file systems, are slow with more."""


def among(number: int, of: int, name: str = "") -> str:
    """The name of a folder with a number; of more than SIDE_BY_SIDE, in one that holds as many: `12000/12345`."""
    name = name or str(number)
    return name if of <= SIDE_BY_SIDE else f"{number // SIDE_BY_SIDE * SIDE_BY_SIDE}/{name}"
