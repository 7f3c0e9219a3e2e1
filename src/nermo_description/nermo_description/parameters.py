"""Typed, validated parameters of a robot, read from YAML. Does not import mujoco, so that the robot's end can use it.

Frames and units: SI and REP-103 (x forward, y left, z up) throughout. The theses' own frames are converted where a
value is entered: N's forward is -y and its left +x, so (x, y, z) of N becomes (-y, x, z) here.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from nermo_description.effects import EFFECTS, EffectKind

LEGS = ("front_left", "front_right", "rear_left", "rear_right")
"""The legs, always in this order."""

SERVOS = (
    *(f"{leg}_{joint}" for leg in LEGS for joint in ("hip", "knee")),
    "spine_lateral",
    "spine_vertical",
    "tail",
    "head_pan",
    "head_tilt",
)
"""All servos that a robot can have, in the order of servo arrays."""
OPTIONAL_SERVOS = ("spine_vertical", "head_tilt")
"""Nermo's, not Nermo-Lite's."""

TendonType = Literal["type_1", "type_2", "type_3", "type_3_adjusted"]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Vector3 = tuple[Finite, Finite, Finite]


class Parameters(BaseModel):
    """Base of all parameter classes: immutable, no unknown fields."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class LegParameters(Parameters):
    """Geometry of one leg pair (N tables A.4, A.5 and A.7). Lengths in m, angles in rad."""

    tendon_type: TendonType = "type_3"
    upper_length: Positive
    """l1: hip axis O to knee A."""
    tendon_attachment: Positive
    """l2: knee A to tendon attachment B on the lower leg."""
    lower_length: Positive
    """l3: knee A to ankle G."""
    foot_length: Positive
    """l4: ankle G to foot end H."""
    pulley_radius: Positive
    """r_p of the knee servo's pulley E."""
    pulley_distance: Positive
    """d1: hip axis O to pulley axis E."""
    tendon_length: Positive
    """l_t0: free tendon length at q2 = 0."""
    ankle_angle: Finite
    """theta3, constant."""
    routing_distance: Positive | None = None
    """Hip axis O to the second routing point I on the upper leg, adjusted type 3 only (N 5.1.4)."""


class SpineParameters(Parameters):
    """The spine and its tendon: modified DH chain from front torso {M} to hip {10}, in N's frame (N table 5.3)."""

    alpha: tuple[Finite, ...]
    """alpha_(i-1) [rad], eleven rows i = 0...10."""
    a: tuple[Finite, ...]
    """a_(i-1) [m]."""
    theta: tuple[Finite, ...]
    """theta_i at rest [rad]."""
    d: tuple[Finite, ...]
    """d_i [m]."""
    lateral_joints: tuple[int, ...] = (2, 4, 6, 8)
    """Rows of the lateral joints."""
    vertical_joints: tuple[int, ...] = (1, 3, 5, 7)
    """Rows of the vertical (lumbar) joints."""
    pulley_radius: Positive
    """r_sp of the spine servo's pulley [m]."""
    vertebra_length: Positive
    """l_v: distance between two vertebrae along the spine [m]."""
    tendon_offset: Positive
    """d1: tendon to the spine's central axis [m]."""
    max_flexion: Positive
    """Largest |theta_v| of one lateral joint [rad]."""


class ServoType(Parameters):
    """What all servos of a robot have in common. SI units, at the output shaft."""

    max_velocity: Positive
    """No-load speed [rad/s]."""
    max_torque: Positive
    """Stall torque [N m]."""
    armature: Positive
    """Inertia of rotor and gears, seen at the shaft [kg m^2]."""
    proportional_gain: Positive
    """Of the position controller [N m/rad]."""
    integral_gain: NonNegative = 0.0
    """[N m/(rad s)]; 0 for the servo's own P controller."""
    derivative_gain: NonNegative = 0.0
    """[N m s/rad], on the measured velocity."""

    @property
    def damping(self) -> float:
        """Slope of the torque-speed line [N m s/rad]: the stall torque is used up at the no-load speed."""
        return self.max_torque / self.max_velocity


class ServoParameters(ServoType):
    """One servo: its type and its range."""

    lower: Finite
    """Lowest position [rad]."""
    upper: Finite
    """Highest position [rad]."""
    neutral: Finite
    """Position in the neutral stance [rad]."""

    @model_validator(mode="after")
    def _ordered(self) -> ServoParameters:
        if not self.lower < self.upper:
            raise ValueError(f"lower {self.lower} must be below upper {self.upper}")
        if not self.lower <= self.neutral <= self.upper:
            raise ValueError(f"neutral {self.neutral} must lie in [{self.lower}, {self.upper}]")
        return self


class JointParameters(Parameters):
    """A compliant joint as a virtual spring-damper (k_j, c_j) at its centre of rotation (N 5.1.1)."""

    stiffness: Positive
    """k_j [N m/rad] (N table A.1)."""
    damping: NonNegative
    """c_j [N m s/rad]."""
    armature: NonNegative
    """[kg m^2], for numerical stability (N A.1.1)."""
    rest: Finite = 0.0
    """Angle at which the spring is free [rad]; a pretensioned joint rests beyond the range in which it works."""
    lower: Finite
    """Form stop [rad]."""
    upper: Finite
    """Form stop [rad]."""

    @model_validator(mode="after")
    def _ordered(self) -> JointParameters:
        if not self.lower < self.upper:
            raise ValueError(f"lower {self.lower} must be below upper {self.upper}")
        return self


class LegDynamics(Parameters):
    """What a leg pair is made of, beside its geometry in `LegParameters`."""

    knee: JointParameters
    """theta1 [rad]."""
    ankle: JointParameters
    """theta3 [rad]; rests at the leg's `ankle_angle`."""
    upper_mass: Positive
    """[kg]"""
    lower_mass: Positive
    """[kg]"""
    foot_mass: Positive
    """[kg]"""
    foot_radius: Positive
    """Radius of the sole around the foot end H [m]."""
    caddy_tilt: Finite
    """Rotation of the leg caddy from horizontal [rad]: raises the pulley E around the hip axis O (N A.2.1)."""


class SpineDynamics(Parameters):
    """Joints of the spine, beside its geometry in `SpineParameters`."""

    lateral: JointParameters
    """One lateral joint; positive bends to the left."""
    vertical: JointParameters | None = None
    """One lumbar joint; positive arches the back. None: fused (Nermo-Lite)."""
    mass: Positive
    """All vertebrae together [kg]."""
    lumbar_tendon_offset: Positive | None = None
    """Lumbar tendon below the spine's axis [m]; with `vertical` only."""


TailModel = Literal["chain", "rigid"]
"""How the tail is simulated: joint by joint, or as one body, which takes 0.55 of the time for a step."""


class TailParameters(Parameters):
    """The tail: a chain of equal compliant joints, modelled like the spine (N 4.2, 5.2)."""

    model: TailModel = "chain"
    """A rigid tail has the mass of the straight one; its servo turns a pulley without a tendon."""
    joint: JointParameters
    """One joint; positive bends to the left."""
    position: Vector3
    """First joint in base_link at rest [m]."""
    pitch: Finite
    """Slope upwards from horizontal [rad]."""
    segment_length: Positive
    """[m]"""
    mass: Positive
    """All segments together [kg]; a segment's share falls linearly to nothing at the tip."""
    tendon_offset: Positive
    """Tendon to the axis at the root, falling linearly to a third at the tip [m]."""
    pulley_radius: Positive
    """[m]"""


class HeadParameters(Parameters):
    """The head, from its pan axis on."""

    position: Vector3
    """Pan axis in base_link [m]."""
    mass: Positive
    """With cameras [kg]."""
    com: Vector3
    """Centre of mass from the pan axis [m]."""
    size: Vector3
    """Edges of the box whose inertia it gets [m]."""


class MassParameters(Parameters):
    """Masses and centres of mass of the two bodies of N (5.34). The torsos get what the limbs leave."""

    total: Positive
    """[kg]"""
    rear: Positive
    """m_rr: rear torso with rear legs and tail [kg]."""
    front_com: Vector3
    """p_com_fr: front torso with front legs and head, in base_link, in the neutral stance [m]."""
    rear_com: Vector3
    """p_com_rr: the same of the rear torso, in the hip frame {10} with REP-103 axes [m]."""
    front_size: Vector3
    """Edges of the box whose inertia the front torso gets [m]."""
    rear_size: Vector3
    """Likewise the rear torso [m]."""


class ContactParameters(Parameters):
    """Feet on the ground, limits of joints and tendons (MuJoCo's solver parameters)."""

    friction: Positive
    """Sliding friction coefficient."""
    solref_contact: Positive
    """Time constant of a contact [s]."""
    solref_limit: Positive
    """Time constant of joint and tendon limits [s]."""


class Deviation(Parameters):
    """One thing in which this very mouse differs from its description, as `nermo gap apply` writes it."""

    effect: str
    """One of EFFECTS, which says what its sites and values are."""
    sites: tuple[str, ...] = ()
    """Names of the model's actuators, joints, tendons, bodies or geoms."""
    values: dict[str, Finite]

    @model_validator(mode="after")
    def _known(self) -> Deviation:
        if self.effect not in EFFECTS:
            raise ValueError(f"effect {self.effect!r} must be one of {', '.join(EFFECTS)}")
        if (wrong := self.kind.error(self.values)) is not None:
            raise ValueError(wrong)
        if not self.sites and self.kind.site != "world":
            raise ValueError(f"sites: {self.effect} needs one at least")
        return self

    @classmethod
    def at(cls, effect: str, *sites: str, **values: float) -> Deviation:
        """An effect at sites, with its values."""
        return cls(effect=effect, sites=sites, values=values)

    @property
    def kind(self) -> EffectKind:
        """Its row of the catalogue."""
        return EFFECTS[self.effect]


class RobotDescription(Parameters):
    """What every robot has: its servos, their postures, its contact with the world."""

    family: ClassVar[str]
    """What its file says as `family`: which of these classes it is."""
    name: str
    servo_type: ServoType
    """What every servo gets that does not say otherwise."""
    servos: dict[str, ServoParameters]
    """In the order of SERVOS, in which servo positions stand in arrays."""
    postures: dict[str, dict[str, Finite]]
    """Servo positions [rad] of `stand`, `sit` and `crouch`; a servo that is not named is at its neutral position."""
    hip_positions: tuple[Vector3, Vector3, Vector3, Vector3]
    """Hip or shoulder axes in base_link [m], REP-103, in the order of LEGS."""
    contact: ContactParameters
    deviations: tuple[Deviation, ...] = ()
    """In what this very robot differs from all that stands beside it."""

    @model_validator(mode="before")
    @classmethod
    def _complete_servos(cls, data: Any) -> Any:
        """Gives every servo its type and puts the servos into order."""
        match data:
            case {"servo_type": dict(common), "servos": dict(own)} if all(isinstance(s, dict) for s in own.values()):
                try:
                    ServoType.model_validate(common)
                except ValidationError:  # is reported as servo_type's fault, and not again by every servo
                    return {**data, "servos": {}}
                order = sorted(own, key=lambda name: SERVOS.index(name) if name in SERVOS else len(SERVOS))
                return {**data, "servos": {name: {**common, **own[name]} for name in order}}
        return data

    @property
    def total_mass(self) -> float:
        """Of the whole robot [kg]."""
        raise NotImplementedError

    def posture(self, name: str) -> dict[str, float]:
        """Servo positions [rad] of a posture, every servo in order. Raises KeyError for a name that does not exist."""
        named = self.postures[name]
        return {servo: named.get(servo, parameters.neutral) for servo, parameters in self.servos.items()}

    def check_postures(self) -> None:
        """Raises ValueError for a posture that is missing, or that the servos cannot take."""
        if missing := sorted({"stand", "sit", "crouch"} - set(self.postures)):
            raise ValueError(f"postures: missing {', '.join(missing)}")
        for posture, angles in self.postures.items():
            for servo, angle in angles.items():
                if servo not in self.servos:
                    raise ValueError(f"postures.{posture}: unknown servo {servo}")
                limits = self.servos[servo]
                if not limits.lower <= angle <= limits.upper:
                    raise ValueError(
                        f"postures.{posture}.{servo}: {angle} is outside the servo's [{limits.lower}, {limits.upper}]"
                    )


class RobotParameters(RobotDescription):
    """Everything that is known of one mouse."""

    family = "mouse"
    bus: Literal["servo_boards", "pwm_board"] = "servo_boards"
    """What its servos hang on: Nermo's boards, or the one of Nermo-Lite, which measures nothing but its supply."""
    material: Literal["PA12", "PETG"]
    """What the skeleton is printed from."""
    stiffness_scale: Positive = 1.0
    """Factor on the stiffness of all compliant joints: for another material, the ratio of the moduli."""
    front_leg: LegParameters
    rear_leg: LegParameters
    front_leg_dynamics: LegDynamics
    rear_leg_dynamics: LegDynamics
    spine: SpineParameters
    spine_dynamics: SpineDynamics
    tail: TailParameters
    head: HeadParameters
    masses: MassParameters

    @property
    def total_mass(self) -> float:
        """[kg]"""
        return self.masses.total

    @property
    def front_mass(self) -> float:
        """m_fr: front torso with front legs and head [kg]; the spine's vertebrae count to neither side."""
        return self.masses.total - self.masses.rear - self.spine_dynamics.mass

    def with_tail(self, model: TailModel) -> RobotParameters:
        """The same mouse with its tail simulated in another way.

        A mouse that deviates in its tail keeps it: the deviation's joints are in the chain only.
        """
        if any(site.startswith("tail_") for deviation in self.deviations for site in deviation.sites):
            return self
        return self.model_copy(update={"tail": self.tail.model_copy(update={"model": model})})

    @model_validator(mode="after")
    def _consistent(self) -> RobotParameters:
        names = set(self.servos)
        if missing := [name for name in SERVOS if name not in names and name not in OPTIONAL_SERVOS]:
            raise ValueError(f"servos: missing {', '.join(missing)}")
        if unknown := sorted(names - set(SERVOS)):
            raise ValueError(f"servos: unknown {', '.join(unknown)}; possible are {', '.join(SERVOS)}")
        if self.bus == "pwm_board" and (more := sorted(names & set(OPTIONAL_SERVOS))):
            raise ValueError(f"bus: a pwm_board has no channel for {', '.join(more)}; servo_boards have")
        if ("spine_vertical" in names) != (self.spine_dynamics.vertical is not None):
            raise ValueError("spine_dynamics.vertical and the servo spine_vertical go together")
        if (self.spine_dynamics.lumbar_tendon_offset is None) != (self.spine_dynamics.vertical is None):
            raise ValueError("spine_dynamics.lumbar_tendon_offset and spine_dynamics.vertical go together")
        self.check_postures()
        for side, mass, leg, rest in (
            ("front", self.front_mass, self.front_leg_dynamics, self.head.mass),
            ("rear", self.masses.rear, self.rear_leg_dynamics, self.tail.mass),
        ):
            if mass <= 2.0 * (leg.upper_mass + leg.lower_mass + leg.foot_mass) + rest:
                raise ValueError(
                    f"masses: legs, head and tail leave nothing for the torsos ({side}: {mass:.3f} kg in all)"
                )
        return self
