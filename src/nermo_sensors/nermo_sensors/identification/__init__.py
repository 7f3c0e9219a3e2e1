"""What a bench recording says about the cells (C 4.3.2.2)."""
