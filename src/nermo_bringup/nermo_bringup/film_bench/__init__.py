"""A hidden mouse from a film of it to its opened seal."""
