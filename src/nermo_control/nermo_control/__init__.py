"""Leg and spine kinematics, gaits, motion module and high-level controller of the Nermo robot mouse."""
