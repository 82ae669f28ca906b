"""Basins of attraction: the starts from which a law reaches its goal, computed for thousands of runs at once."""
