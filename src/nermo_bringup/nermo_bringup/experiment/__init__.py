"""Experiments of the thesis on the real mouse: its runs played and recorded, filmed, and measured beside the twin."""
