"""What can be wrong with a truth: each fault weak, medium and strong at every kind of site, and faults no library has.

The size of a fault is relative to what the healthy robot does in the very recording (its torques, speeds, swings), so
that weak, medium and strong mean the same for a pendulum and for a mouse.
"""

from __future__ import annotations

from simgap.blind.faults import bodies, cables, joints, sensing, servos, unknown
from simgap.blind.faults.base import Fault, Scale
from simgap.blind.truth import Soft

FAULTS: tuple[Fault, ...] = (
    Fault("coulomb_friction", "joint", (0.12, 0.3, 0.7), joints.coulomb),
    Fault("viscous_friction", "unsprung", (0.15, 0.35, 0.8), joints.viscous),
    Fault("stribeck_friction", "joint", (0.1, 0.25, 0.5), joints.stribeck),
    Fault("load_friction", "driven", (0.12, 0.25, 0.45), joints.load),
    Fault("torque_ripple", "geared", (0.2, 0.4, 0.9), joints.ripple),
    Fault("armature", "joint", (0.25, 0.6, 1.5), joints.armature),
    Fault("joint_stiffness", "joint", (0.2, 0.5, 1.2), joints.spring),
    Fault("joint_stiffness", "sprung", (0.25, 0.45, 0.75), joints.fatigue),
    Fault("joint_rest_angle", "sprung", (0.15, 0.35, 0.8), joints.creep),
    Fault("joint_damping", "sprung", (0.15, 0.35, 0.8), joints.viscous),
    Fault("joint_range", "joint", (0.12, 0.25, 0.45), joints.stop),
    Fault("mass", "body", (0.25, 0.5, 1.0), bodies.mass),
    Fault("com_shift", "unbalanced", (0.25, 0.5, 1.0), bodies.com),
    Fault("inertia", "turned", (0.5, 1.0, 2.5), bodies.inertia),
    Fault("servo_delay", "actuator", (0.006, 0.015, 0.04), servos.delay),
    Fault("servo_dead_band", "servo", (0.04, 0.1, 0.25), servos.band),
    Fault("servo_backlash", "play", (0.05, 0.12, 0.3), servos.backlash),
    Fault("joint_elasticity", "elastic", (0.04, 0.1, 0.25), joints.elastic),
    Fault("soft_mount", "mounted", (0.015, 0.04, 0.1), bodies.soft_mount),
    Fault("servo_gain", "actuator", (0.75, 0.6, 0.4), servos.gain),
    Fault("servo_offset", "servo", (0.1, 0.2, 0.5), servos.offset),
    Fault("servo_rate_limit", "servo", (0.85, 0.65, 0.4), servos.rate),
    Fault("servo_torque_limit", "servo", (0.8, 0.6, 0.4), servos.torque_limit),
    Fault("thermal_drift", "servo", (0.3, 0.6, 1.2), servos.hot),
    Fault("supply_sag", "supply", (0.12, 0.25, 0.45), servos.sag),
    Fault("tendon_slack", "cable", (0.15, 0.4, 1.0), cables.of_its_actuator(cables.slack)),
    Fault("tendon_elasticity", "cable", (0.4, 1.0, 3.0), cables.of_its_actuator(cables.stretch)),
    Fault("tendon_friction", "cable", (0.1, 0.25, 0.5), cables.of_its_actuator(cables.routing)),
    Fault("tendon_detached", "cable", (1.0, 1.0, 1.0), cables.of_its_actuator(cables.broken)),
    Fault("tendon_slack", "strap", (0.02, 0.05, 0.12), cables.loose_strap),
    Fault("tendon_detached", "strap", (1.0, 1.0, 1.0), cables.cut_strap),
    Fault("ground_friction", "foot", (0.6, 0.4, 0.2), bodies.slippery),
    Fault("ground_slope", "ground", (0.03, 0.06, 0.12), bodies.slope_of_ground),
    # A foot sinks in by the square of this; twice as strong would be softer than the leg is long.
    Fault("foot_compliance", "foot", (1.5, 2.2, 3.2), bodies.soft_foot),
    Fault("sensor_bias", "sensor", (0.05, 0.12, 0.3), sensing.bias),
    Fault("sensor_scale", "sensor", (1.05, 1.12, 1.3), sensing.scaled),
    Fault("sensor_delay", "sensor", (0.006, 0.015, 0.04), sensing.late),
    Fault("sensor_delay", "filtered", (0.006, 0.015, 0.04), sensing.smoothed),
    Fault("sensor_saturation", "sensor", (0.85, 0.7, 0.5), sensing.saturated),
    Fault("sensor_misalignment", "axes", (0.06, 0.15, 0.35), sensing.askew),
    Fault("link_latency", "several", (0.008, 0.02, 0.05), sensing.latency),
    Fault("link_jitter", "all", (0.008, 0.02, 0.05), sensing.jitter),
    Fault("link_loss", "all", (0.3, 0.55, 0.8), sensing.loss),
)
"""Names are those of the diagnosis's contract; mechanisms and laws are not its own."""

UNKNOWN: tuple[Fault, ...] = (
    Fault("tight_spot", "joint", (0.4, 0.8, 1.6), unknown.tight_spot, known=False),
    Fault("periodic_push", "joint", (0.15, 0.35, 0.8), unknown.push, known=False),
    Fault("cubic_drag", "joint", (0.15, 0.35, 0.7), unknown.drag, known=False),
    Fault("odd_spring", "joint", (0.15, 0.35, 0.8), unknown.odd_spring, known=False),
    Fault("slipped_horn", "servo", (0.1, 0.2, 0.5), unknown.slipped, known=False),
    Fault("hysteresis", "joint", (0.2, 0.4, 0.8), unknown.hysteresis, known=False),
    Fault("flexing_link", "flexing", (0.1, 0.2, 0.4), unknown.built_in, known=False),
    Fault("crosstalk", "servo", (0.2, 0.4, 0.8), unknown.crosstalk, known=False),
    Fault("hanging_sensor", "sensor", (0.15, 0.3, 0.6), unknown.hanging, known=False),
)


def soft_of(name: str, size: float, scale: Scale, joint: str, actuator: int) -> Soft | None:
    """What a fault puts between motor and link; None for faults that change the finished truth."""
    if name == "servo_backlash":
        return Soft(width=size * float(scale.swing[actuator]))
    if name in ("flexing_link", "joint_elasticity"):
        swing = max(scale.high[joint] - scale.low[joint], 1e-6)
        return Soft(stiffness=4.0 * scale.torque[joint] / (size * swing), seen=name == "joint_elasticity")
    return None


def fault(name: str, kind: str) -> Fault:
    """A fault by its name and the kind of its site."""
    return next(f for f in (*FAULTS, *UNKNOWN) if (f.name, f.kind) == (name, kind))
