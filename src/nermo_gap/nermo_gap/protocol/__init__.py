"""An experiment protocol: what the mouse is asked to do for a diagnosis, how it is played, and what is kept of it."""
