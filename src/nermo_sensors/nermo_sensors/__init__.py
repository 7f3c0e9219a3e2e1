"""Tactile sensor models, calibration and leg-load estimation of the Nermo robot mouse."""
