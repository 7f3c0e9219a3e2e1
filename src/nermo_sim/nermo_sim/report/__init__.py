"""Pages of one HTML file that needs nothing beside it, and the figures of the single experiments."""
