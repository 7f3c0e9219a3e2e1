"""Driving the mouse: gamepads, the keyboard and command files, all without ROS."""
