"""The gap diagnosis applied to the mouse: its channels, its model, its effects, and its recordings."""
