"""The device emulator: what Nermo's firmware does, as a program of its own."""
