"""The engine: recorded inputs through many variants of the model at once, in short windows that start at the robot.

One mujoco.batch.Batch holds a simulation for each (variant, window) pair; the loop over time steps is in Python and
vectorised over the simulations. During the warm-up all measured coordinates follow the measurement, so that what is
not measured (contacts, tendons, servo states) settles; then the simulation runs free over the scored horizon.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import batch as mjbatch
from numpy.typing import NDArray

from simgap.data.align import Aligned
from simgap.data.plant import Plant
from simgap.data.supply import measured_supply
from simgap.simulation.drive import Drive, Follow
from simgap.simulation.extra_laws import (
    LoadFriction,
    Ripple,
    ServoStep,
    Switch,
    needs_friction_step,
    needs_past,
    needs_step,
)
from simgap.simulation.heat import Heat
from simgap.simulation.models import Fields, Models, tilts
from simgap.simulation.mounted import RINGS_ON, MountedBatch
from simgap.simulation.observe import observe
from simgap.simulation.signal_path import inverse_outputs, read_outputs, shape_inputs
from simgap.simulation.state import MeasuredState, measured_state
from simgap.simulation.variant import InputPath, MountPath, OutputPath, Variant
from simgap.simulation.windows import Windows

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

LATE = 0.1
"""[s] before a window from which coordinates whose drive has a memory are held too."""
ELSEWHERE = (0.1, 0.01)
"""[rad], [m] by which a hinge and a slide that nothing measures are tried elsewhere."""
_MAX_BYTES = 150e6
_MAX_SIMS = 1500
_FATAL = tuple(int(getattr(mujoco.mjtWarning, f"mjWARN_{w}")) for w in ("INERTIA", "BADQPOS", "BADQVEL", "BADQACC"))


@dataclass(frozen=True)
class _Row:
    """What one variant needs to run: the model fields in which it differs and indices of its shared signals."""

    fields: Fields
    inputs: int
    state: int


@dataclass(frozen=True)
class _Prepared:
    """Variants, what each of them needs, and the signals that they share."""

    variants: Sequence[Variant]
    rows: Sequence[_Row]
    inputs: Array
    """(npath, n, ni), as `shape_inputs` makes them."""
    states: Sequence[MeasuredState]


@dataclass(frozen=True)
class _Pairs:
    """Which variant runs in which window (n,), and how far from the measurement it starts, see `run_pairs`."""

    variant: Ints
    window: Ints
    shift: Array | None = None
    rate_shift: Array | None = None

    def part(self, which: Ints) -> _Pairs:
        """Some of them."""
        shift, rate_shift = (None if s is None else s[which] for s in (self.shift, self.rate_shift))
        return _Pairs(self.variant[which], self.window[which], shift, rate_shift)


@dataclass(frozen=True)
class _Simulations:
    """Pairs under way, one simulation of the batch each."""

    batch: mjbatch.Batch
    variants: Sequence[Variant]
    """Of each."""
    pairs: _Pairs
    drive: Drive
    follow: Follow
    history: Array
    """(n, steps, nsensordata), filled as they run."""
    failed: NDArray[np.bool_]
    """Those that broke down so far."""
    left: Array | None
    """Share of its torque that heat leaves each servo, in the rows from the origin on (n, rows, nu)."""


class Replayer:
    """Replays windows of one recording.

    Results depend on nothing but the arguments: the same pairs give the same bits at any number of threads.
    """

    def __init__(
        self, plant: Plant, aligned: Aligned, windows: Windows, floor: Array, threads: int | None = None
    ) -> None:
        self.plant, self.aligned, self.windows, self.floor = plant, aligned, windows, floor
        self.threads = threads or min(os.cpu_count() or 1, 8)
        self._models = Models(plant, self.threads)
        self._inputs: dict[bytes, Array] = {}
        self._states: dict[bytes, MeasuredState] = {}
        self.simulated_seconds = 0.0
        dt, period = float(plant.model.opt.timestep), aligned.period
        self._dt = dt
        self._lead_steps = round(windows.warm_up * period / dt)
        self._late_from = windows.warm_up - LATE / period
        self._times = (windows.warm_up + windows.sample).astype(np.float64) * period
        self._steps = int(np.ceil(self._times[-1] / dt)) + 2
        self._run_start = np.zeros(len(windows), np.int64)
        self._run_stop = np.zeros(len(windows), np.int64)
        self._setup = np.zeros(len(windows), np.int64)
        for run in aligned.runs:
            inside = (windows.start >= run.start) & (windows.start < run.stop)
            self._run_start[inside], self._run_stop[inside], self._setup[inside] = run.start, run.stop, run.setup
        self.state = self._measured(Variant.nominal(plant).outputs)
        self._always_on = bool(aligned.enabled.all())
        self.supply = measured_supply(aligned, plant.map)
        self.heat = Heat(plant, aligned)
        self._start: Array | None = None
        if not self.state.complete(plant.model):
            self._start = self._observe()

    # -- what is asked for ---------------------------------------------------------------------------------------

    def run(self, variants: Sequence[Variant], select: Ints | None = None, which: Ints | None = None) -> Array:
        """Outputs of every variant in every (selected) window, (nv, nw, ns, no); NaN where a simulation broke down.

        With ``which`` (np, nw), row p takes variant ``which[p, w]`` in window w; outputs are then (np, nw, ns, no).
        """
        chosen = np.arange(len(self.windows)) if select is None else np.asarray(select)
        if which is None:
            which = np.repeat(np.arange(len(variants))[:, None], len(chosen), axis=1)
        flat = self.run_pairs(variants, which.ravel(), np.tile(chosen, len(which)))
        return flat.reshape(*which.shape, *flat.shape[1:])

    def run_pairs(
        self,
        variants: Sequence[Variant],
        which: Ints,
        window: Ints,
        shift: Array | None = None,
        rate_shift: Array | None = None,
    ) -> Array:
        """Outputs (n, ns, no) of n (variant, window) pairs.

        ``shift`` and ``rate_shift`` (n, state.size) are added to the measured coordinates and rates where a window
        starts; a measured base comes last, as position, rotation about its own axes, and twist.
        """
        variants, which = self._set_up(variants, which, window)
        prepared, pairs = self._prepare(variants), _Pairs(which, window, shift, rate_shift)
        out = np.empty((len(which), len(self.windows.sample), len(self.plant.outputs)))
        per_sim = 8.0 * self._steps * (self.plant.model.nsensordata + self.plant.model.nu + self.plant.model.nv)
        size = int(np.clip(_MAX_BYTES / per_sim, 16, _MAX_SIMS))
        # Which way a pair runs depends on its variant alone, so that its company changes no bit.
        ways = np.array([_way(v, self._always_on) for v in variants])[which]
        for way in np.unique(ways):
            chosen = np.flatnonzero(ways == way)
            for first in range(0, len(chosen), size):
                part = chosen[first : first + size]
                with quiet_mujoco():
                    out[part] = self._chunk(prepared, pairs.part(part), way)
        self.simulated_seconds += len(which) * self._steps * self._dt
        return out

    def probe(self, variant: Variant, fields: Sequence[str]) -> dict[str, Array]:
        """Fields of MjData over the scored part of all windows, {field: (samples, size)}."""
        kept: dict[str, list[Array]] = {f: [] for f in fields}
        window = np.arange(len(self.windows))
        variants, which = self._set_up([variant], np.zeros(len(self.windows), np.int64), window)
        with quiet_mujoco():
            way = _REMEMBERS + (_TILTS if tilts(variant) else 0)
            self._chunk(self._prepare(variants), _Pairs(which, window), way, kept)
        return {f: np.nan_to_num(np.concatenate(v)) for f, v in kept.items()}

    def _set_up(self, variants: Sequence[Variant], which: Ints, window: Ints) -> tuple[Sequence[Variant], Ints]:
        """Variants as each window's run has them, where runs differ, and which of these a pair takes."""
        if not self._setup.any():
            return variants, which
        used, mine = np.unique(self._setup, return_inverse=True)
        made = [variant.set_up(self.plant.setups[k]) for variant in variants for k in used]
        return made, len(used) * which + mine[window]

    # -- preparation ---------------------------------------------------------------------------------------------

    def _measured(self, path: OutputPath) -> MeasuredState:
        key = path.key()
        if key not in self._states:
            if len(self._states) > 200:
                self._states.clear()
            outputs = None if path.is_static_neutral() else inverse_outputs(self.aligned, path)
            self._states[key] = measured_state(self.plant, self.aligned, self.floor, outputs)
        return self._states[key]

    def _prepare(self, variants: Sequence[Variant]) -> _Prepared:
        input_keys: dict[bytes, int] = {}
        state_keys: dict[bytes, int] = {}
        paths: list[InputPath] = []
        states: list[MeasuredState] = []
        rows: list[_Row] = []
        for variant in variants:
            key = variant.inputs.key()
            if key not in input_keys:
                input_keys[key] = len(paths)
                paths.append(variant.inputs)
            out_key = variant.outputs.key()
            if out_key not in state_keys:
                state_keys[out_key] = len(states)
                states.append(self._measured(variant.outputs))
            rows.append(_Row(self._models.differences(variant), input_keys[key], state_keys[out_key]))
        return _Prepared(variants, rows, shape_inputs(self.aligned, paths), states)

    # -- the loop ------------------------------------------------------------------------------------------------

    def _chunk(
        self, prepared: _Prepared, pairs: _Pairs, way: int, probe: dict[str, list[Array]] | None = None
    ) -> Array:
        rows, which, window = prepared.rows, pairs.variant, pairs.window
        batch = self._models.batch([row.fields for row in rows], which, way >= _TILTS)
        batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        if self._start is not None:
            self._models.begin(batch, self._start[window])
        mine = [prepared.variants[v] for v in which]
        paths = np.array([rows[v].inputs for v in which])
        origin = self.windows.start[window] - self.windows.warm_up
        drive = Drive(self.plant, mine, paths, prepared.inputs, origin, self._dt, self.aligned.period)
        drive.limits(self._run_start[window], self._run_stop[window])
        states = np.array([rows[v].state for v in which])
        starts = self._run_start[window]
        follow = Follow(prepared.states, states, drive.origin, batch, late_from=self._late_from, starts=starts)
        history = np.empty((len(which), self._steps, self.plant.model.nsensordata))
        left = self._left_by_heat(prepared, which, origin)
        sims = _Simulations(batch, mine, pairs, drive, follow, history, np.zeros(len(which), bool), left)
        mounted = isinstance(batch, MountedBatch)
        if mounted:
            self._tilt(sims, batch)
        if way % _TILTS != _ROLLS:
            self._step_through(sims, mounted or way % _TILTS == _REMEMBERS or self._settles(batch), probe)
        else:
            self._roll_out(sims, mounted or self._settles(batch))
        warned = batch.warning[:, :, 1].astype(np.int64)
        failed = sims.failed | (warned[:, list(_FATAL)] > 0).any(axis=1)
        outputs = read_outputs(history, mine, self._times, self._dt)
        outputs[failed] = np.nan
        return outputs

    def _left_by_heat(self, prepared: _Prepared, which: Ints, origin: Ints) -> Array | None:
        """See `_Simulations`; None where no servo of these variants loses torque as it warms."""
        found: Array | None = None
        ahead = np.arange(int(self._steps * self._dt / self.aligned.period) + 1)
        rows = np.minimum(origin[:, None] + ahead, len(self.aligned.time) - 1)
        for v in np.unique(which):
            row = prepared.rows[v]
            share = self.heat.left(prepared.variants[v], prepared.inputs[row.inputs], prepared.states[row.state])
            if share is not None:
                found = np.ones((len(which), len(ahead), share.shape[1])) if found is None else found
                found[which == v] = share[rows[which == v]]
        return found

    def _tilt(self, sims: _Simulations, batch: MountedBatch) -> None:
        """Bring mounts to where they are as the warm-up begins, from what the robot did before it."""
        early = round(RINGS_ON / self._dt)
        for k in range(-early, 0):
            position = k * self._dt / self.aligned.period
            sims.follow.apply(position, None, None)
            batch.ctrl[:], batch.qfrc_applied[:] = sims.drive.at(position)
            if k == -early:
                batch.balance()
            _try(batch.step, sims.failed)

    def _roll_out(self, sims: _Simulations, warm: bool) -> None:
        """The free run in one call, for variants whose inputs do not depend on the state."""
        batch, drive, follow, history, failed = sims.batch, sims.drive, sims.follow, sims.history, sims.failed
        lead, period = self._lead_steps, self.aligned.period
        positions = np.arange(self._steps, dtype=np.float64) * (self._dt / period)
        if warm:
            ctrl, forces = batch.bind("ctrl"), batch.bind("qfrc_applied")
            control, applied = drive.at(positions[:lead])
            for k in range(lead):
                follow.apply(k * self._dt / period, None, None)
                ctrl[:], forces[:] = control[:, k], applied[:, k]
                _try(batch.step, failed)
        follow.apply(lead * self._dt / period, sims.pairs.shift, sims.pairs.rate_shift)
        control = np.concatenate(drive.at(positions[lead:]), axis=-1)
        kinds = int(mujoco.mjtState.mjSTATE_CTRL) | int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)
        found = {"sensordata": np.empty((len(history), self._steps - lead, history.shape[2]))}
        _try(lambda: batch.rollout(self._steps - lead, control, kinds, ("sensordata",), out=found), failed)
        history[:, lead:] = found["sensordata"]
        history[:, :lead] = history[:, lead : lead + 1]

    def _settles(self, batch: mjbatch.Batch) -> bool:
        """Whether something needs the warm-up; not where all coordinates are measured and nothing has a memory."""
        memory = self.plant.model.na > 0 or batch.bind("history").shape[-1] > 0
        return memory or not self.state.complete(self.plant.model)

    def _step_through(self, sims: _Simulations, warm: bool, probe: dict[str, list[Array]] | None) -> None:
        """Warm-up and free run step by step, with servos and frictions that look at the state.

        Where nothing has a memory (not ``warm``), one step is enough to know the forces.
        """
        batch, mine, drive, follow, history = sims.batch, sims.variants, sims.drive, sims.follow, sims.history
        servo = ServoStep(self.plant, mine, self._dt)
        friction = any(needs_friction_step(v) for v in mine)
        law = LoadFriction(mine) if friction else None
        ripple = Ripple(self.plant, mine) if friction else None
        loss = batch.expand("dof_frictionloss") if friction else None
        base_loss = None if loss is None else loss.copy()
        force = batch.bind("qfrc_actuator") if friction else None
        sensors, ctrl, given = (batch.bind(field) for field in ("sensordata", "ctrl", "qfrc_applied"))
        if servo.active:
            servo.bind(batch)
        switch = None if self._always_on else Switch(batch, self.aligned.enabled, drive.origin)
        first = 0 if warm else max(self._lead_steps - 1, 0)
        positions = np.arange(self._steps, dtype=np.float64) * self._dt / self.aligned.period
        controls, efforts = drive.at(positions)
        for k in range(first, self._steps):
            position = float(positions[k])
            if k <= self._lead_steps:
                last = k == self._lead_steps
                follow.apply(position, *((sims.pairs.shift, sims.pairs.rate_shift) if last else (None, None)))
            control, applied = controls[:, k], efforts[:, k]
            if servo.active:
                supply, left = self.supply, None
                row = np.minimum(drive.origin + int(position), len(self.aligned.time) - 1)
                if supply is not None:
                    supply = supply[row]
                if sims.left is not None:
                    left = sims.left[:, int(position)]
                control, extra = servo.step(control, supply, left)
                applied = applied + (extra if switch is None else extra * switch.on(position)[:, None])
            if switch is not None:
                switch.at(position)
            ctrl[:], given[:] = control, applied
            if law is not None and loss is not None and base_loss is not None and force is not None:
                loss[:] = law.at(base_loss, batch.qvel, force + applied)
            if ripple is not None and len(ripple.dofs):
                given[:, ripple.dofs] += ripple.at(batch.qpos)
            _try(batch.step, sims.failed)
            history[:, k] = sensors
            if probe is not None and k > self._lead_steps:
                for field, values in probe.items():
                    values.append(np.array(batch.bind(field)))
        history[:, :first] = history[:, first : first + 1]

    # -- coordinates that are not measured -----------------------------------------------------------------------

    def unseen(self) -> Ints:
        """Hinges and slides (nu,) whose position no live channel measures."""
        model = self.plant.model
        single = np.isin(model.jnt_type, [mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE])
        return np.flatnonzero(single & ~np.isin(model.jnt_qposadr, self.state.qpos))

    def guesswork(self) -> float:
        """How far a typical window [noise floors] depends on where unseen joints are taken to be at first.

        The nominal model is run from where it is found to be, and from where it would be found if these joints began
        each run-in `ELSEWHERE` away: 0 where all are measured, little where springs or servos bring them back.
        """
        model, here, joints = self.plant.model, self._start, self.unseen()
        if here is None or not len(joints):
            return 0.0
        moved = np.zeros(model.nq)
        moved[model.jnt_qposadr[joints]] = np.where(
            model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_HINGE, ELSEWHERE[0], ELSEWHERE[1]
        )
        nominal, live = [Variant.nominal(self.plant)], self.aligned.live
        found = self.run(nominal)[0]
        try:
            self._start = self._observe(moved=moved)
            away = (self.run(nominal)[0] - found)[..., live] / self.floor[live]
        finally:
            self._start = here
        size = np.sqrt((away**2).mean(axis=(1, 2)))
        return float(np.median(np.where(np.isfinite(size), size, np.inf)))

    def _observe(self, moved: Array | None = None) -> Array:
        """State rows (nw, nstate) at the start of each warm-up, see `observe`."""
        nominal = Variant.nominal(self.plant)
        nominal.mounts = MountPath.neutral(self.plant)
        prepared = self._prepare([nominal])
        begin = self.windows.start - self.windows.warm_up
        return observe(self.aligned, nominal, self._models, prepared.inputs, prepared.states, begin, moved)


_ROLLS, _LOOKS, _REMEMBERS, _TILTS = 0, 1, 2, 4
"""Ways in which a variant runs: in one call, step by step, step by step with its past; and any of these on mounts."""


def _way(variant: Variant, always_on: bool = True) -> int:
    """How a variant must run: its servos or frictions look at the state or are switched, or its past matters."""
    if tilts(variant):
        return _TILTS + _on_firm_ground(variant, always_on)
    return _on_firm_ground(variant, always_on)


def _on_firm_ground(variant: Variant, always_on: bool) -> int:
    if needs_past(variant) or variant.outputs.late.any():
        return _REMEMBERS
    if not always_on or needs_step(variant):
        return _LOOKS
    return _ROLLS


def _try(call: Callable[[], object], failed: NDArray[np.bool_]) -> None:
    try:
        call()
    except mjbatch.SimulationError as error:
        failed[error.ids] = True


@contextlib.contextmanager
def quiet_mujoco() -> Iterator[None]:
    """Keep MuJoCo from logging simulations that break down: they are counted, and some candidates are meant to fail."""
    config = mujoco.MjLogConfig.get()
    console, file = config.logto_console, config.logto_file
    config.logto_console = config.logto_file = False
    config.set()
    try:
        yield
    finally:
        config.logto_console, config.logto_file = console, file
        config.set()
