"""Leg load from two imperfect cells (C 4.3.1), and better."""
