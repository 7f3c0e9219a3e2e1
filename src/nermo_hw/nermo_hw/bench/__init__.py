"""Measurements of the robot's path: a network that can be made bad, a walker, a device, and what they say together."""
