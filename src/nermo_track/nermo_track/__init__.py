"""The pose of the mouse out of film: tags to print, cameras to calibrate, and the clock of a film."""
