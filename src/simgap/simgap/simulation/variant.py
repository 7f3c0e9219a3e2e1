"""One hypothesis about the robot: a changed model and what happens to signals and joints on the way."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.plant import Plant
from simgap.data.setup import Setup

Array = NDArray[np.float64]

SPRING_DAMPING = 0.05
"""Damping ratio of an elastic drive or mount of which nothing is known: gears, belts, tables have a few hundredths."""
HEAT_TIME = 4.0
"""[s] in which a small servo warms, where nothing is known of it: windings take seconds, and what is far slower than a
recording looks the same in it, with another loss."""


@dataclass
class InputPath:
    """What happens to the inputs before they act, (ni,) each, in the units of the control; neutral by default."""

    scale: Array
    offset: Array
    delay: Array
    """[s]"""
    rate_limit: Array
    """Largest change per second."""
    play: Array
    """Full width of a hysteresis (play operator) of the command."""
    loss: Array
    """Probability that an update of the command does not arrive: the expected command lags and is smoothed."""
    jitter: Array
    """[s] The delay of every update is drawn between 0 and this: the expected command lags and is smoothed."""
    update: Array
    """[s] between two updates of the command."""
    low: Array
    high: Array
    added: Array | None = None
    """(n, ni) on the grid: an error of a measured input, sample by sample."""

    @classmethod
    def neutral(cls, plant: Plant) -> InputPath:
        """The path of the nominal model: only the actuators' own control range."""
        n = len(plant.inputs)
        low, high = np.full(n, -np.inf), np.full(n, np.inf)
        for i, channel in enumerate(plant.inputs):
            bounds = plant.model.actuator_ctrlrange[channel.actuator] if channel.actuator >= 0 else (0.0, 0.0)
            if channel.actuator >= 0 and bounds[1] > bounds[0] and not channel.measured:
                low[i], high[i] = bounds
        zero = np.zeros((6, n))
        return cls(np.ones(n), zero[0], zero[1], np.full(n, np.inf), zero[2], zero[3], zero[4], zero[5], low, high)

    def key(self) -> bytes:
        """Equal for paths that do the same to the samples (the delay acts later, between samples)."""
        fields = (self.scale, self.offset, self.rate_limit, self.play, self.loss, self.jitter, self.low, self.high)
        numbers = np.concatenate(fields).tobytes()
        return numbers if self.added is None else numbers + self.added.tobytes()


@dataclass
class ServoPath:
    """What happens inside the servos, (nu,) each; neutral by default."""

    dead_band: Array
    """Error below which the servo does nothing (half width), in the unit of the actuator's length."""
    hard: NDArray[np.bool_]
    """Whether the servo answers with the full error outside its dead band (True) or with what exceeds it (False)."""
    backlash: Array
    """Full width of the play between motor and joint, in joint units."""
    compliance: Array
    """How far the drive between motor and joint gives: joint units per torque at the joint."""
    ringing: Array
    """Damping ratio of a drive that gives, against a motor that stands."""
    heat_loss: Array
    """Torque goes with 1 / (1 + heat_loss * heat); heat, from 0, follows (torque / heat_reference)^2 in heat_time."""
    heat_time: Array
    """[s]"""
    heat_reference: Array
    """In the unit of the actuator's force."""
    temperature_loss: Array
    """The same for each 10 K that a motor was measured to be warmer than at first."""
    sag: float = 0.0
    """Share of the torque that is lost when all servos together give ``sag_reference``."""
    sag_reference: float = 1.0
    follows: float = 0.0
    """How far torque goes with the measured voltage: 1 in proportion to it, 0 not at all."""

    @classmethod
    def neutral(cls, plant: Plant) -> ServoPath:
        """Nothing happens."""
        nu = plant.model.nu
        zero, one = np.zeros((5, nu)), np.ones((2, nu))
        hard, ringing = np.zeros(nu, bool), np.full(nu, SPRING_DAMPING)
        return cls(zero[0], hard, zero[1], zero[2], ringing, zero[3], HEAT_TIME * one[0], one[1], zero[4])


@dataclass
class FrictionPath:
    """Friction beyond Coulomb and viscous (which MuJoCo has), and ripple, (nv,) each; neutral by default.

    Friction loss = that of the model + stribeck * exp(-(v / stribeck_velocity)^2) + load * |transmitted force|.
    Added torque = ripple * sin(2 pi (q - ripple_origin) / ripple_period).
    """

    stribeck: Array
    stribeck_velocity: Array
    load: Array
    ripple: Array
    ripple_period: Array
    """In joint units."""
    ripple_origin: Array
    """Joint position at which the torque rises through zero."""

    @classmethod
    def neutral(cls, plant: Plant) -> FrictionPath:
        """Nothing happens."""
        nv = plant.model.nv
        return cls(np.zeros(nv), np.ones(nv), np.zeros(nv), np.zeros(nv), np.ones(nv), np.zeros(nv))


@dataclass
class MountPath:
    """What a fixed base stands on, (nbody,) each: a spring that tilts about two horizontal axes; neutral by default."""

    compliance: Array
    """[rad/(N m)]"""
    ringing: Array
    """Damping ratio, with all joints held."""
    inertia: Array
    """[kg m^2] of what tilts along beside the robot."""

    @classmethod
    def neutral(cls, plant: Plant) -> MountPath:
        """It stands firm."""
        n = plant.model.nbody
        return cls(np.zeros(n), np.full(n, SPRING_DAMPING), np.zeros(n))

    @property
    def gives(self) -> bool:
        """Whether some base tilts."""
        return bool(self.compliance.any())


@dataclass
class OutputPath:
    """What happens to the outputs before they are recorded, (no,) each: filter, turn, scale, bias, delay, saturate."""

    scale: Array
    bias: Array
    delay: Array
    """[s]"""
    limit: Array
    """Largest absolute value."""
    lead: Array
    """[s] by which an output is read later: a time step's own error, see nuisance.py."""
    lag: Array
    """[s] Time constant of a filter of first order."""
    turns: tuple[tuple[tuple[int, int, int], Array], ...] = ()
    """(channels x, y, z of a vector sensor, rotation matrix) pairs."""

    @classmethod
    def neutral(cls, plant: Plant) -> OutputPath:
        """Nothing happens."""
        n = len(plant.outputs)
        return cls(np.ones(n), np.zeros(n), np.zeros(n), np.full(n, np.inf), np.zeros(n), np.zeros(n))

    @property
    def late(self) -> Array:
        """[s] by which a slow change comes late, delayed or filtered."""
        return self.delay + self.lag

    def is_static_neutral(self) -> bool:
        """Whether the measured state can be used as recorded."""
        return bool((self.scale == 1).all() and (self.bias == 0).all() and (self.late == 0).all())

    def key(self) -> bytes:
        """Equal for paths with the same inverse."""
        return np.concatenate([self.scale, self.bias, self.late]).tobytes()


@dataclass
class Variant:
    """A changed copy of the nominal model and its signal paths. Effects edit it in place."""

    plant: Plant
    model: mujoco.MjModel
    inputs: InputPath
    servos: ServoPath
    friction: FrictionPath
    outputs: OutputPath
    mounts: MountPath
    moment: float = 0.0
    """[s] after the middle of the recording, for effects that grow with time."""

    @classmethod
    def nominal(cls, plant: Plant) -> Variant:
        """The nominal model; its paths are neutral but for what the map knows of them."""
        made = cls(
            plant,
            copy.copy(plant.model),
            InputPath.neutral(plant),
            ServoPath.neutral(plant),
            FrictionPath.neutral(plant),
            OutputPath.neutral(plant),
            MountPath.neutral(plant),
        )
        for known in plant.known:
            known.enter(made)
        return made

    def set_up(self, setup: Setup) -> Variant:
        """The same as some runs have it."""
        if not setup.changes:
            return self
        made = self.copy()
        setup.apply(made.model)
        return made

    def copy(self) -> Variant:
        """An independent copy."""
        return Variant(
            self.plant,
            copy.copy(self.model),
            copy.deepcopy(self.inputs),
            copy.deepcopy(self.servos),
            copy.deepcopy(self.friction),
            copy.deepcopy(self.outputs),
            copy.deepcopy(self.mounts),
            self.moment,
        )
