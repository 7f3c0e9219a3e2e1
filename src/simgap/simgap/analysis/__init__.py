"""What is said beside the verdict: input checks, localisation, isolability, the next experiment; the whole diagnosis."""
