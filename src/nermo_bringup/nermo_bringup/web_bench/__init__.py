"""What the page in the browser costs."""
