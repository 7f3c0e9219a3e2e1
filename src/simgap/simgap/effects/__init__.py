"""What may cause a gap, the effect library: one small class an effect, one file a subsystem."""
