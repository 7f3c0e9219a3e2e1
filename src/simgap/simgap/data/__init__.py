"""What comes in: maps, units, recordings, the model bound to its channels, a common grid, and the noise on it."""
