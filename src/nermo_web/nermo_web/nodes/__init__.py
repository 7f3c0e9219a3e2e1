"""The node of the page."""
