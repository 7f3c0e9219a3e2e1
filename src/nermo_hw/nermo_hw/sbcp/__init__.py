"""SBCP, the Simple Binary Communication Protocol of C 5.3: packets, parser, registers, Nermo's boards."""
