"""`nermo optimize`: gait and leg parameters for a stated cost, searched on the twin."""
