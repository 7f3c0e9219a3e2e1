"""`nermo drive`: the twin and the keys in one terminal."""
