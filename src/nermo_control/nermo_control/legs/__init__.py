"""Kinematics of the legs: two servos to a foot position and back."""
