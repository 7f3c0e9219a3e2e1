"""What a diagnosis changes about a model: as MJCF, as a wrapper for what MJCF cannot say, and as ranges to train on."""
