"""Launch files, configuration, teleoperation, recording and the nermo command."""
