"""ROS nodes of the real robot's path."""
