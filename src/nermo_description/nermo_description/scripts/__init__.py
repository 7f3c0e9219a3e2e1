"""Commands that make files of this package."""
