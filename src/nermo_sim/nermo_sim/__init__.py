"""The MuJoCo twin of the Nermo robot mouse: simulation node, in-process loop and experiments."""
