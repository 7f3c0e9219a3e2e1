"""ROS 2 XML launch files for machines without ROS's own launch: read by `description`, run by `runner`."""
