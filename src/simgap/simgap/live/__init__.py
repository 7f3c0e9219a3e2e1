"""A diagnosis watched in the browser while it runs."""
