"""The compliant spine: kinematics, tendon, and what its flexion is used for (N 5.2)."""
