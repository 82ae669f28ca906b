"""Reports of studies: basins, sweeps, gain limits, flow fields."""
