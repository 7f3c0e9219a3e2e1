"""A model watched beside its robot: the gap of the last seconds, and whether it has grown."""
