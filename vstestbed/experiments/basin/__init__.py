"""Basins of attraction: from which starts a law reaches its goal, thousands of runs at once."""
