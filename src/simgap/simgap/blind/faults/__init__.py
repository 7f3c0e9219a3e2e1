"""What can be wrong with a truth, by the part that it is wrong with; `table.py` has all of it."""
