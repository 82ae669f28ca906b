"""Studies: a run with its folder, comparisons, basins, gain limits under delay, sweeps,
benchmarks.
"""

from __future__ import annotations
