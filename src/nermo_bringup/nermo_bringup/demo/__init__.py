"""`nermo demo`: the whole graph on the twin, walked through all it can do, recorded, and judged by the recording."""
