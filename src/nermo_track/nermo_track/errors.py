"""What goes wrong with films, in words for the person who runs the program."""


class TrackError(ValueError):
    """A film, camera or recording cannot be used; one sentence says which, why and what to do."""
