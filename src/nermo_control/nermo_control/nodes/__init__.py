"""ROS nodes of the controller: each declares its parameters, converts messages and calls an algorithm object."""
