"""Speed: of a scenario against its floor, of the ideal loop, and of all that a user waits for."""
