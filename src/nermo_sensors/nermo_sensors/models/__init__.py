"""Forward models of the tactile cells and their electronics."""
