"""The robot-agnostic core: any MJCF, any recording. Imports no nermo package."""
