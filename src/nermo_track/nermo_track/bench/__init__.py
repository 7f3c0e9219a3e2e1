"""Films that are drawn, so that the truth is known, and what the tracker makes of them."""
