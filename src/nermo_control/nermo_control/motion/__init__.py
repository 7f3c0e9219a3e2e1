"""What the motion module is made of: its settings, the feet's paths, the servos' targets, and its states."""
