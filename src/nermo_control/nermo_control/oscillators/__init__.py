"""Limbs that coordinate each other: coupled oscillators and the Tegotae rule (C 3.2 and 3.3)."""
