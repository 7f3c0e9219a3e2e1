"""What goes wrong with recordings, in words for the person who runs the program."""

from nermo_node.recording_reader import RecordingError

__all__ = ["RecordingError"]
