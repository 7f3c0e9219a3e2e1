"""The effect library: one small class an effect, one file a subsystem."""
