"""Beside the verdict: input checks, localisation, isolability, the next experiment, the diagnosis."""
