"""Gaits: their parameters, the phases of the legs, and the paths of the feet (N 5.1.6, 5.4)."""
