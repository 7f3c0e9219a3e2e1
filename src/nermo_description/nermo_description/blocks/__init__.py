"""One module a block: reads its MJCF (topology, names, shapes, looks) and writes the robot's numbers into it."""
