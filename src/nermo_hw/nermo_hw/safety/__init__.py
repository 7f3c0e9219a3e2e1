"""What keeps a broken link, a broken command or a broken robot from being dangerous. Without ROS."""
