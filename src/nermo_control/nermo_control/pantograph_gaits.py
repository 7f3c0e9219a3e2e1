"""Gaits of robots with pantograph legs, whose legs are always oscillators (C 3.2.3): phase advances, front left first.

The differences of (3.2) follow from them (`oscillators/cpg.py`). Duty factors follow Alexander: walks stand for more
than half of a cycle, runs for less. Offsets follow Hildebrand: what a leg is ahead of the rear left one.
"""

from __future__ import annotations

from nermo_control.gait.gaits import GAITS, GaitDefinition

PANTOGRAPH_GAITS = {
    "trot": GAITS["trot"],
    "lateral_sequence": GaitDefinition(duty_factor=0.75, phase_offsets=(0.75, 0.25, 0.0, 0.5)),
    "diagonal_sequence": GaitDefinition(duty_factor=0.75, phase_offsets=(0.25, 0.75, 0.0, 0.5)),
    "pace": GaitDefinition(duty_factor=0.5, phase_offsets=(0.0, 0.5, 0.0, 0.5)),
    "bound": GaitDefinition(duty_factor=0.4, phase_offsets=(0.5, 0.5, 0.0, 0.0)),
    "transverse_gallop": GaitDefinition(duty_factor=0.4, phase_offsets=(0.5, 0.6, 0.0, 0.1)),
    "rotary_gallop": GaitDefinition(duty_factor=0.4, phase_offsets=(0.6, 0.5, 0.0, 0.1)),
}
"""By name; the first is the one of a command that names none."""
