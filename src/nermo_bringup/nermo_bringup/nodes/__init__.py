"""ROS nodes of nermo_bringup, one file a node."""
