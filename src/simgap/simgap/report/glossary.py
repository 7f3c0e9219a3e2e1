"""Words of the page that a reader may not know."""

from __future__ import annotations

GLOSSARY: tuple[tuple[str, str], ...] = (
    ("noise floor", "what a channel would differ by if the very same experiment were repeated: its sensor's noise and "
     "resolution; the unit of the gap, so that channels of different units can be compared"),
    ("gap", "root mean square of measured minus simulated, in noise floors; 1 is as good as repeating the experiment"),
    ("held-out", "data that the fit had no say in; every window is predicted by a fit that has not seen it"),
    ("window", "a short piece of the recording that is simulated from where the robot was measured to be; an error "
     "of that start, and of measured torques, is forgiven in the gap, not in errors that have a unit"),
    ("free-running", "simulated from the start of a run to its end, never put back to the measurement: what a user "
     "of the model gets"),
    ("nominal", "the model as it was given"),
    ("recalibrated", "the model with its own numbers (masses, gains, damping...) moved within their tolerances, and "
     "nothing else"),
    ("diagnosed", "the model with the causes that were found, and its numbers moved within their tolerances"),
    ("fit everything", "every number of the model freed at once, without tolerances and without causes"),
    ("nats", "units of evidence: a lead of n nats makes the data e to the n times likelier; 3 are twentyfold, 7 a "
     "thousandfold"),
    ("90 %", "an interval that holds the true value nine times in ten, as far as model and tolerances are right"),
    ("share of the gap", "part of its power, the square of the gap beyond the noise floor"),
)  # fmt: skip
"""(word, what it means), in the order in which a reader meets them."""
