"""The report of all experiments: one HTML file with figures and tables."""
