"""A simulated test bench (C 4.3.2) and the recordings that it, or a real one, makes."""
