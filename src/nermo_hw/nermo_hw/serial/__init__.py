"""The host's side of the serial line: driver, fixed-step schedule, calibration."""
