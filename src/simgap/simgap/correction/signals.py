"""What happens to commands and readings that MJCF has no words for. Needs NumPy and MuJoCo only.

`simgap apply` copies this file, with the numbers of a diagnosis, beside the corrected model.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Signals:
    """Stands between your controller and `mj_step`, and between the simulation's sensors and your controller.

    Call ``step(data, command)`` in place of ``data.ctrl[:] = command`` before every `mj_step`, with the command of each
    actuator in the unit of its control (of one whose ``controller`` is in ``signals``, the position it is told).

    ``signals`` are dictionaries with ``where``, ``name``, ``quantity`` and ``value``:

    - ``controller``: ``kp``, ``kd`` of the robot's own controller in front of a motor;
    - ``command``: ``scale``, ``offset``, ``delay`` [s], ``rate_limit`` (per second), ``play`` (full width), and of the
      link ``loss`` (probability that an update does not arrive), ``jitter`` (updates come late by up to this [s]) with
      ``update`` [s] between two updates;
    - ``servo``: ``dead_band`` (half width; outside it the servo answers with its whole error),
      ``dead_band_in_part`` (with what exceeds the band), ``backlash`` (full width; here a play of the command),
      ``compliance`` (of the drive, per torque at the joint; here only how far it gives at rest, not that it rings, with
      the damping ratio ``ringing``),
      ``heat_loss`` (the servo loses torque by 1 / (1 + heat_loss * heat), where heat, 0 after `reset`, follows
      (torque / ``heat_reference``)^2 within ``heat_time`` [s]), ``temperature_loss`` (torque goes with a temperature
      that was measured: a simulation has none, so it does nothing here),
      ``sag`` (all servos lose torque by 1 / (1 + sag * load), load 1 at ``sag_reference``), ``follows_voltage`` (torque
      goes with a voltage that was measured: a simulation has none, so it does nothing here);
    - ``joint``: ``stribeck`` (friction near standstill beyond the model's) with ``stribeck_speed``,
      ``load_friction`` (share of the transmitted torque), ``ripple`` (a torque that goes to and fro with the joint's
      position, once in ``ripple_period``, and rises through zero at ``ripple_origin``; ``data.qfrc_applied`` of such a
      joint is set by this class);
    - ``mount`` (of the body that stands on it): ``compliance`` (here only how far it tilts under the weight on it, as
      gravity that leans; not that it rings, with the damping ratio ``ringing`` and an ``inertia`` of its own);
    - ``sensor``: ``scale``, ``bias``, ``delay`` [s], ``lag`` [s] (a filter of first order), ``limit``.
    """

    def __init__(self, model: mujoco.MjModel, signals: Sequence[dict[str, Any]], seed: int = 0) -> None:
        self._model, self._rng, n = model, np.random.default_rng(seed), model.nu
        self._friction = model.dof_frictionloss.copy()
        self._of: dict[tuple[str, str], dict[str, float]] = {}
        for signal in signals:
            self._of.setdefault((signal["where"], signal["name"]), {})[signal["quantity"]] = float(signal["value"])
        names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_ACTUATOR, a) or f"actuator_{a}" for a in range(n)]
        self._command = [self._of.get(("command", name), {}) for name in names]
        self._servo = [self._of.get(("servo", name), {}) for name in names]
        self._gains = [self._of.get(("controller", name), {}) for name in names]
        self._supply = self._of.get(("servo", "all"), {})
        self._mounts = [(model.body(name).id, of) for (where, name), of in self._of.items() if where == "mount"]
        self._down = model.opt.gravity.copy()
        self._joints = [(i, self._of.get(("joint", model.joint(i).name), {})) for i in range(model.njnt)]
        self.reset()

    def reset(self) -> None:
        """Forget what has been sent, for a new run."""
        n = self._model.nu
        self._under_way: list[deque[tuple[float, float]]] = [deque() for _ in range(n)]
        self._acting, self._centre, self._limited = (np.full(n, np.nan) for _ in range(3))
        self._next_update = np.full(n, -np.inf)
        self._readings: dict[str, deque[tuple[float, float]]] = {}
        self._filters: dict[str, tuple[float, float]] = {}
        self._heat = np.zeros(n)

    def step(self, data: mujoco.MjData, command: Sequence[float] | Array) -> None:
        """Set ``data.ctrl``, and the joints' friction and ripple, for the coming `mj_step`."""
        model = self._model
        control = np.array([self._arrived(a, float(u), data.time) for a, u in enumerate(command)])
        limited = model.actuator_ctrllimited.astype(bool)
        low, high = model.actuator_ctrlrange.T
        own = np.array([bool(g) for g in self._gains], bool)
        control = np.where(limited & ~own, np.clip(control, low, high), control)
        for a in range(model.nu):
            control[a] = self._remember(a, float(control[a]))
            control[a] = self._through_dead_band(a, float(control[a]), data)
            control[a] = self._through_drive(a, float(control[a]), data)
            if self._gains[a]:
                control[a] = self._closed_loop(a, float(control[a]), data)
        if self._supply or any("heat_loss" in of for of in self._servo):
            control = self._weaken(control, data)
        data.ctrl[:] = control
        self._rub(data)
        self._tilt(data)

    def measure(self, time: float, values: dict[str, float]) -> dict[str, float]:
        """What the sensors would read at ``time`` [s] where the simulation has ``values``, both by name."""
        read = {}
        for name, value in values.items():
            of = self._of.get(("sensor", name), {})
            past = self._readings.setdefault(name, deque())
            past.append((time, self._filtered(name, of.get("lag", 0.0), time, value)))
            while len(past) > 1 and past[1][0] <= time - of.get("delay", 0.0) + 1e-9:
                past.popleft()
            limit = of.get("limit", np.inf)
            read[name] = float(np.clip(of.get("scale", 1.0) * past[0][1] + of.get("bias", 0.0), -limit, limit))
        return read

    def _filtered(self, name: str, lag: float, time: float, value: float) -> float:
        """A value behind a filter of first order."""
        if lag <= 0.0:
            return value
        before, last = self._filters.get(name, (time, value))
        found = value + lag / (lag + time - before) * (last - value)
        self._filters[name] = time, found
        return found

    def _arrived(self, a: int, command: float, time: float) -> float:
        """The command that acts in the coming step: scaled, and as late as the link and the servo make it."""
        of = self._command[a]
        command = of.get("scale", 1.0) * command + of.get("offset", 0.0)
        if "loss" in of or "jitter" in of:
            return self._by_chance(a, command, time)
        # Of two commands that share a step acts the mean.
        past, back = self._under_way[a], max(of.get("delay", 0.0), 0.0) / self._model.opt.timestep
        past.append((time, command))
        while len(past) > int(back) + 2:
            past.popleft()
        newest = len(past) - 1
        before, after = (past[max(newest - int(back) - k, 0)][1] for k in (1, 0))
        share = back - int(back)
        return float(share * before + (1.0 - share) * after)

    def _by_chance(self, a: int, command: float, time: float) -> float:
        """The last command that a link has let through by now."""
        of = self._command[a]
        if time + 1e-9 >= self._next_update[a]:
            self._next_update[a] = time + of.get("update", 0.0)
            if self._rng.random() >= of.get("loss", 0.0):
                late = max(of.get("delay", 0.0), 0.0) + of.get("jitter", 0.0) * self._rng.random()
                # What was sent earlier and arrives later undoes nothing.
                while self._under_way[a] and self._under_way[a][-1][0] >= time + late:
                    self._under_way[a].pop()
                self._under_way[a].append((time + late, command))
        if np.isnan(self._acting[a]):
            self._acting[a] = command
        while self._under_way[a] and self._under_way[a][0][0] <= time + 1e-9:
            self._acting[a] = self._under_way[a].popleft()[1]
        return float(self._acting[a])

    def _remember(self, a: int, command: float) -> float:
        """Play and rate limit."""
        half = 0.5 * (self._command[a].get("play", 0.0) + self._servo[a].get("backlash", 0.0))
        if np.isnan(self._centre[a]):
            self._centre[a] = self._limited[a] = command
        self._centre[a] = np.clip(self._centre[a], command - half, command + half)
        reach = self._command[a].get("rate_limit", np.inf) * self._model.opt.timestep
        self._limited[a] = np.clip(self._centre[a], self._limited[a] - reach, self._limited[a] + reach)
        return float(self._limited[a])

    def _through_dead_band(self, a: int, command: float, data: mujoco.MjData) -> float:
        of = self._servo[a]
        band = of.get("dead_band", of.get("dead_band_in_part", 0.0))
        if not band:
            return command
        rest = self._rest(a, data)
        error = command - rest
        if abs(error) <= band:
            return rest
        return command if "dead_band" in of else float(rest + error - np.sign(error) * band)

    def _through_drive(self, a: int, command: float, data: mujoco.MjData) -> float:
        """What a servo gives through a drive that yields: motor and drive are two springs in a row."""
        give, model = self._servo[a].get("compliance", 0.0), self._model
        if not give:
            return command
        own, rest = self._gains[a], self._rest(a, data)
        stiffness = own.get("kp", 0.0) if own else -model.actuator_biasprm[a, 1] * model.actuator_gear[a, 0] ** 2
        return float(rest + (command - rest) / (1.0 + stiffness * give))

    def _rest(self, a: int, data: mujoco.MjData) -> float:
        """The command at which a servo, or a motor's own controller, gives no torque where it is."""
        model, length = self._model, data.actuator_length[a]
        if self._gains[a]:
            return float(length / model.actuator_gear[a, 0])
        return float(-model.actuator_biasprm[a, 1] / model.actuator_gainprm[a, 0] * length)

    def _closed_loop(self, a: int, target: float, data: mujoco.MjData) -> float:
        """Control of a motor that holds a position: torque kp (u - q) - kd dq/dt at the joint."""
        gear, gain = self._model.actuator_gear[a, 0], self._model.actuator_gainprm[a, 0]
        angle, rate = data.actuator_length[a] / gear, data.actuator_velocity[a] / gear
        torque = self._gains[a].get("kp", 0.0) * (target - angle) - self._gains[a].get("kd", 0.0) * rate
        return float(torque / (gear * gain))

    def _weaken(self, control: Array, data: mujoco.MjData) -> Array:
        """What heat, and then a supply that sags, leave of the servos' torque."""
        model = self._model
        gain, bias = model.actuator_gainprm[:, 0], model.actuator_biasprm
        asked = gain * control + bias[:, 0] + bias[:, 1] * data.actuator_length + bias[:, 2] * data.actuator_velocity
        limited = model.actuator_forcelimited.astype(bool)
        force = np.where(limited, np.clip(asked, *model.actuator_forcerange.T), asked)
        for a, of in enumerate(self._servo):
            if "heat_loss" in of:
                kept = np.exp(-model.opt.timestep / of["heat_time"])
                warm = 1.0 + of["heat_loss"] * self._heat[a]
                self._heat[a] = kept * self._heat[a] + (1.0 - kept) * (force[a] / of["heat_reference"]) ** 2
                force[a] /= warm
        load = np.abs(force * model.actuator_gear[:, 0]).sum() / self._supply.get("sag_reference", 1.0)
        lost = asked - force / (1.0 + self._supply.get("sag", 0.0) * load)
        result: Array = control - np.divide(lost, gain, out=np.zeros_like(lost), where=gain != 0)
        return result

    def _tilt(self, data: mujoco.MjData) -> None:
        for body, of in self._mounts:
            lever = data.subtree_com[body] - data.xpos[body]
            weight = self._model.body_subtreemass[body] * self._down
            tilt = of.get("compliance", 0.0) * np.cross(lever, weight)
            self._model.opt.gravity[:] = self._down - np.cross(tilt, self._down)

    def _rub(self, data: mujoco.MjData) -> None:
        for joint, of in self._joints:
            if of:
                dof = self._model.jnt_dofadr[joint]
                slow = of.get("stribeck_speed", 1.0)
                near = of.get("stribeck", 0.0) * np.exp(-((data.qvel[dof] / slow) ** 2))
                load = of.get("load_friction", 0.0) * abs(data.qfrc_actuator[dof])
                self._model.dof_frictionloss[dof] = max(self._friction[dof] + near + load, 0.0)
                if "ripple" in of:
                    turned = data.qpos[self._model.jnt_qposadr[joint]] - of.get("ripple_origin", 0.0)
                    wave = np.sin(2.0 * np.pi * turned / of.get("ripple_period", 1.0))
                    data.qfrc_applied[dof] = of["ripple"] * wave
