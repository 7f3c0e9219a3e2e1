"""The blind check: recordings of a hidden truth, a diagnosis that cannot see it, and the score."""
