"""What goes wrong with recordings, in words for the person who runs the program."""


class RecordingError(RuntimeError):
    """A recording cannot be written or read; the message is one sentence that names the file and the reason."""
