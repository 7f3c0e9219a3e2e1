"""Which effects explain results that are known as numbers in a table only."""
