"""Experiments that a mouse may be asked to do next, as command files for `nermo play`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nermo_control.gait.knowledge_base import GaitParameters
from nermo_control.types import ControlCommand, Posture, SpineModes
from nermo_description.parameter_files import write_yaml
from nermo_description.parameters import LEGS, RobotParameters
from nermo_sim.loop import Loop, schedule
from simgap.analysis.experiment import SETTLE, Experiment
from simgap.data.align import Aligned
from simgap.data.plant import Plant

Array = NDArray[np.float64]

LENGTH = 5.0
"""[s] of an experiment after settling."""
STAND_FIRST = 2.0
"""[s] of the stand at a file's beginning: a crouched mouse is up by then."""
EVERY = 0.02
"""[s] between two entries of a command file."""
TROTS = (("slowly", 0.06, 0.7), ("quickly", 0.06, 1.3))
"""How a trot is called, its speed [m/s], and its gait frequency as a share of the usual one."""
SWEEP = 0.25
"""[rad] of a lifted leg's hip, to both sides."""
LIFTED = 1.8
"""[s] from the command to lift a leg until it is up."""


@dataclass(frozen=True)
class MouseMenu:
    """Hold, squat, sway, a spine chirp, single legs lifted and swept, and a trot at two frequencies.

    Lifts and trots are what the mouse's own controller tells the servos of the nominal twin, played open loop: what is
    compared is what the body makes of the same commands. A push is not among them: nobody measures its force.
    """

    robot: RobotParameters

    def experiments(self, plant: Plant, aligned: Aligned, about: Sequence[int]) -> Sequence[Experiment]:
        """See core.experiment.Menu."""
        period = aligned.period
        knees = {f"{leg}_knee": -0.35 for leg in LEGS}
        # Front hips turn back where rear hips do too: the body sways over its feet.
        hips = {f"{leg}_hip": 0.2 for leg in LEGS}
        menu = [
            self._made(plant, period, "hold", "stand still on all four legs", {}),
            self._made(plant, period, "squat", "squat on all four legs, slowly and quickly at once", knees),
            self._made(plant, period, "sway", "sway forth and back over the feet, slowly and quickly", hips),
            self._chirp(plant, period),
        ]
        for name, speed, share in TROTS:
            frequency = share * GaitParameters().default_gait_frequency
            walk = ControlCommand(0, forward_velocity=speed, gait="trot", gait_frequency=frequency)
            menu.append(self._driven(plant, period, f"trot {name}", f"trot {name}, at {frequency:.2g} Hz", walk))
        names = [plant.inputs[i].name for i in about]
        concerned = [leg for leg in LEGS if any(n.startswith(leg) for n in names)]
        for leg in concerned[:2] or ("front_left", "rear_right"):
            what = f"lift the {leg.replace('_', ' ')} leg and sweep it forth and back"
            balance = SpineModes(balance_compensation=True)
            up = ControlCommand(0, posture=Posture[f"LIFT_{leg.upper()}"], spine_modes=balance)
            lift = self._driven(plant, period, f"lift {leg}", what, up)
            t = period * np.arange(len(lift.inputs)) - SETTLE - LIFTED
            hip = [c.name for c in plant.inputs].index(f"{leg}_hip")
            lift.inputs[:, hip] += SWEEP * np.sin(2.0 * np.pi * 0.7 * np.maximum(t, 0.0))
            menu.append(lift)
        return menu

    def _driven(self, plant: Plant, period: float, name: str, what: str, command: ControlCommand) -> Experiment:
        """What the controller makes of a command that is given after standing for a while."""
        script = schedule([(0.0, ControlCommand(0, posture=Posture.STAND)), (SETTLE, command)])
        recording = Loop.build(self.robot, GaitParameters()).run(script, SETTLE + LENGTH)
        servos, commands = list(self.robot.servos), np.asarray(recording.commands, float)
        rows = np.searchsorted(
            recording.time, period * np.arange(round((SETTLE + LENGTH) / period)) + recording.time[0]
        )
        inputs = commands[np.minimum(rows, len(commands) - 1)][:, [servos.index(c.name) for c in plant.inputs]]
        return Experiment(name, what, period, inputs)

    def _chirp(self, plant: Plant, period: float) -> Experiment:
        """The spine's servos from 0.3 Hz to 3 Hz."""
        t = np.maximum(period * np.arange(round((SETTLE + LENGTH) / period)) - SETTLE, 0.0)
        wave = np.sin(2.0 * np.pi * (0.3 * t + 0.5 * (3.0 - 0.3) / LENGTH * t**2))
        spine = {servo: 0.35 for servo in self.robot.servos if servo.startswith("spine")}
        return self._made(plant, period, "spine chirp", "bend the spine, ever faster, from 0.3 Hz to 3 Hz", spine, wave)

    def _made(
        self, plant: Plant, period: float, name: str, what: str, sizes: dict[str, float], wave: Array | None = None
    ) -> Experiment:
        """Servos that move by ``sizes`` [rad] as ``wave`` says; slowly and quickly at once where it is not given."""
        count = round((SETTLE + LENGTH) / period)
        t = np.maximum(period * np.arange(count) - SETTLE, 0.0)
        if wave is None:
            wave = 0.7 * np.sin(2 * np.pi * 0.5 * t) + 0.3 * np.sin(2 * np.pi * 2.3 * t)
        wave = np.clip(t / 0.5, 0.0, 1.0) * wave
        inputs = np.empty((count, len(plant.inputs)))
        for i, channel in enumerate(plant.inputs):
            servo = self.robot.servos[channel.name]
            size = sizes.get(channel.name, 0.0)
            # What bends one way only, and knees, move to one side of neutral.
            one_way = size < 0.0 or channel.name == "spine_vertical"
            shape = 0.5 * np.clip(t / 0.5, 0.0, 1.0) * (1.0 + wave) if one_way else wave
            inputs[:, i] = np.clip(servo.neutral + size * shape, servo.lower, servo.upper)
        return Experiment(name, what, period, inputs)

    def write(self, experiment: Experiment, plant: Plant, stem: Path) -> Path:
        """Write a command file for `nermo play`; the mouse comes to a stand first."""
        path = stem.with_suffix(".yaml")
        path.parent.mkdir(parents=True, exist_ok=True)
        stride = max(round(EVERY / experiment.period), 1)
        names = [c.name for c in plant.inputs]
        commands = [
            {
                "at": round(STAND_FIRST + k * experiment.period, 4),
                "servos": {n: round(float(v), 5) for n, v in zip(names, row, strict=True)},
            }
            for k, row in list(enumerate(experiment.inputs))[::stride]
        ]
        stand = {"at": 0.0, "posture": "stand"}
        write_yaml({"description": experiment.description, "commands": [stand, *commands]}, path)
        return path
