"""The experiments of N chapter 6, in process."""
