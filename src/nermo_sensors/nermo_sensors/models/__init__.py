"""Forward models of the tactile foot as a whole, and of what its cells share: electronics and memory."""
