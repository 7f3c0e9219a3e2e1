"""What is said beside the verdict: checks, where, waterfall, free runs, remainder, what next; the whole diagnosis."""
