"""A development benchmark: small robots, a truth that shares no code with the effect library, and the score."""
