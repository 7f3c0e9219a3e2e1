"""Small robots for the tests, written out here so that a test can be read alone."""

from __future__ import annotations

import signal
from collections.abc import Callable

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.blind.robots import ARM, CART_POLE, LEG, MAPS, MODELS, PENDULUM, commands
from simgap.data.align import Aligned, align
from simgap.data.mapping import parse_map
from simgap.data.noise_floor import noise_floor
from simgap.data.plant import Plant, build_plant
from simgap.data.recording import recording_from_table

Array = NDArray[np.float64]

__all__ = ["ARM", "CART_POLE", "LEG", "MAPS", "MODELS", "PENDULUM", "aligned_of", "plant_of", "simulate"]


def plant_of(name: str, edit: Callable[[dict[str, object]], None] | None = None) -> Plant:
    """The nominal plant of one of the robots."""
    import copy

    data = copy.deepcopy(MAPS[name])
    if edit:
        edit(data)
    return build_plant(mujoco.MjSpec.from_string(MODELS[name]), parse_map(data))


def simulate(
    name: str,
    seconds: float = 12.0,
    seed: int = 0,
    period: float = 0.005,
    noise: float = 2e-4,
    change: Callable[[mujoco.MjModel], None] | None = None,
    signal: Callable[[dict[str, Array]], dict[str, Array]] | None = None,
    push: Callable[[mujoco.MjData], None] | None = None,
    told: float = 1.0,
) -> dict[str, Array]:
    """A table as a robot would have logged it: a plain mj_step loop, with held commands and white noise.

    ``push`` may set forces before every step; ``told`` is a factor of the commands.
    """
    model = plant_of(name).model
    if change:
        change(model)
    mujoco.mj_setConst(model, mujoco.MjData(model))
    n = int(seconds / period)
    table = {column: v if column == "t" else told * v for column, v in commands(name, seed, n, period).items()}
    acting = signal(table) if signal else table
    plant = plant_of(name)
    data = mujoco.MjData(model)
    rng = np.random.default_rng(seed + 1000)
    rows, steps = np.empty((n, len(plant.outputs))), round(period / model.opt.timestep)
    for k in range(n):
        for channel in plant.inputs:
            data.ctrl[channel.actuator] = acting[channel.column][k] * channel.scale
        mujoco.mj_forward(model, data)
        rows[k] = plant.read(data.sensordata)
        for _ in range(steps):
            if push:
                push(data)
            mujoco.mj_step(model, data)
    rows += noise * rng.standard_normal(rows.shape)
    return {"t": period * np.arange(n), **table, **{c.column: rows[:, i] for i, c in enumerate(plant.outputs)}}


def aligned_of(name: str, table: dict[str, Array]) -> tuple[Plant, Aligned, Array]:
    """Plant, aligned recording and noise floor of a table."""
    plant = plant_of(name)
    aligned = align(recording_from_table(table, plant), plant)
    return plant, aligned, noise_floor(aligned)


def as_from_a_terminal() -> None:
    """What a shell starts in the background, these tests among it, is deaf to Ctrl-C."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
