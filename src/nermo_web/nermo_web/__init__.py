"""The mouse in the browser: seen in 3D, driven with a stick, its parameters as sliders."""
