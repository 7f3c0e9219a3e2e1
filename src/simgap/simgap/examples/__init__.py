"""Recordings to try the commands on: one of a real double pendulum, and a simulated arm with a hidden fault."""
