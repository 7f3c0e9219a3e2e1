"""The mouse in the blind check of simgap."""
