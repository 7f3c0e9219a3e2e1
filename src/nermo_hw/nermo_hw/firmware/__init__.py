"""The firmware of Nermo-Lite's board: its constants for C++, its build for this machine, and what is measured of it."""
