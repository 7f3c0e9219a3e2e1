"""What comes before a diagnosis: a map guessed from names and values, and a recording looked at."""
