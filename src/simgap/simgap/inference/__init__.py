"""Which effects cause it: nominal numbers that may be off, hypotheses, their fits, their comparison, the verdict."""
