"""The Wi-Fi link on zenoh: one end at the workstation, one at the robot, raw CDR between them. Without ROS."""
