"""Measurements of the control tick, the in-process loop and the load estimator; those of the graph are in `nodes/`."""
