"""From recordings to the competition's outcome: what is compared, what may be off, and which causes are looked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from simgap.analysis import self_contact, torque_balance
from simgap.analysis.borders import Border, borders, hints
from simgap.analysis.comparison import Comparison, compare
from simgap.analysis.input_checks import check_map, check_replay
from simgap.analysis.options import Options
from simgap.analysis.rate_reports import Rate, rate_hints, rate_reports, rate_warnings
from simgap.analysis.ripples import waves
from simgap.analysis.stages import Checked, leading, located
from simgap.analysis.torque_balance import Balance
from simgap.data.align import Aligned, align
from simgap.data.corrected import as_read_by
from simgap.data.excitation import still_joints
from simgap.data.noise_floor import noise_floor, noise_warning
from simgap.data.plant import Plant
from simgap.data.recording import Recording, concatenate
from simgap.effects.base import Context
from simgap.effects.library import enumerate_effects
from simgap.inference.budget import SEARCH, Budget, OutOfTimeError
from simgap.inference.effort import Effort
from simgap.inference.fit import Fitter
from simgap.inference.healthy import Healthy
from simgap.inference.nuisance import Nuisance
from simgap.inference.residual import Residuals
from simgap.inference.select import Selector
from simgap.inference.selection import Selection
from simgap.inference.stochastic_link import Chance
from simgap.simulation.horizon import forgets, usable_horizon
from simgap.simulation.integration import finer
from simgap.simulation.replay import Replayer
from simgap.simulation.state import measured_state
from simgap.simulation.variant import Variant
from simgap.simulation.windows import HORIZON, HORIZON_HEAVY, affordable, at_limit, cut, light, longer

Array = NDArray[np.float64]

HEAVY = Effort(hopeful=20, survivors=5, finalists=3, leaders=1, rounds=1, partners=4, max_effects=2, sought=60)
"""Of models that are not `light`, which take a hundred times longer to replay than a pendulum."""


@dataclass
class Search:
    """A competition with what it was held on.

    Attributes:
        floor: (no,) noise floor of the outputs; where the robot was seen well, what the model missed of it then.
        near, rates, balances: what single parts say by themselves.
        warnings: in sentences.
        beside: the healthy robot, where recordings of it were given.
    """

    plant: Plant
    aligned: Aligned
    floor: Array
    fitter: Fitter
    selector: Selector
    selection: Selection
    near: list[Border]
    rates: list[Rate]
    balances: list[Balance]
    warnings: list[str]
    beside: Comparison | None = None


def search(
    recordings: Sequence[Recording], plant: Plant, options: Options, budget: Budget, well: Sequence[Healthy] = ()
) -> Search:
    """Hold the competition of causes, beside what explains the robot when it was ``well``, the best first.

    Raises:
        GapInputError: the recordings cannot be used, or contradict the map.
    """
    recording, given = concatenate(list(recordings)), plant
    aligned = align(recording, plant)
    floor = np.maximum(noise_floor(aligned), [options.resolution.get(o.name, 0.0) for o in plant.outputs])
    warnings = [*plant.warnings, *aligned.warnings]
    if bare := noise_warning(aligned, floor, [o.name for o in plant.outputs]):
        warnings.append(bare)
    state = measured_state(plant, aligned, floor)
    warnings += [*check_map(plant, aligned, state), *self_contact.warnings(plant, state)]
    warnings += [
        f"joint {name} hardly moves: this recording says nothing about it"
        for name in still_joints(plant, aligned, floor)
    ]
    options.tell(Checked.of(aligned, plant, warnings))
    options.say("where", 0.0)
    plant = finer(self_contact.without_needless_contacts(plant, state), options.finer)
    moved, size = aligned.outputs.std(axis=0), np.sqrt((aligned.inputs**2).mean(axis=0))

    def nuisances_of(plant: Plant) -> list[Nuisance]:
        return options.nuisances(plant, moved, size, aligned.period)

    def replay(nominal: Variant, floor: Array) -> Replayer:
        return _replayer(nominal.plant, aligned, floor, nominal, options)

    beside = None
    if well:
        options.say("what was constant", 0.0)
        beside = compare(well, floor, replay, nuisances_of, budget)
        replayer, nominal = beside.replayer, beside.healthy.base
        plant, floor = nominal.plant, replayer.floor
        nuisances = [beside.healthy.narrowed(n) for n in nuisances_of(plant)]
    else:
        nominal, nuisances = Variant.nominal(plant), nuisances_of(plant)
        replayer = replay(nominal, floor)
    windows = replayer.windows
    replayed, context = replayer.run([nominal])[0], Context.of(replayer, nominal, options.groups)
    context.waves = waves(replayer, replayed, context.scales)
    effects = enumerate_effects(context, options.extra_effects, options.only)
    if options.keep is not None:
        effects = [effect for effect in effects if options.keep(effect)]
    check_replay(plant, aligned.outputs[windows.rows()], replayed)
    residuals = Residuals.build(replayer, nominal)
    fitter = Fitter(residuals, nuisances, nominal)
    before = None
    if options.corrects is not None and not well:
        first = finer(self_contact.without_needless_contacts(options.corrects, state), options.finer)
        read = align(as_read_by(options.corrects, recording, given), first)
        same = Replayer(first, read, replayer.windows, floor, options.threads)
        # What of a window is its start's error, or its measured inputs', is judged by the better model for both.
        before = Fitter(replace(residuals, replayer=same), nuisances_of(first), Variant.nominal(first))
    effort = options.effort or (Effort() if light(plant.model) else HEAVY)
    near, rates = borders(plant, aligned, floor), rate_reports(plant, aligned)
    warnings += rate_warnings(rates)
    balanced = torque_balance.balances(plant, aligned, state)
    spoken = [*torque_balance.hints(balanced, context.switched), *hints(near), *rate_hints(rates)]
    if options.staged:
        options.tell(located(fitter, options.phases, len(effects), spoken))
    selector = Selector(
        fitter,
        effects,
        options.seed,
        options.progress,
        effort,
        budget,
        spoken,
        (lambda found: options.tell(leading(selector.scores, found))) if options.staged else None,
        options.left,
        before,
    )
    selection = selector.run()
    if not budget.left_out:
        try:
            with budget.until(SEARCH):
                Chance(selector).reconsider(selection, thorough=light(plant.model))
        except OutOfTimeError:
            budget.ended("chance")
    if beside is not None:
        beside.settle(selector.scores, selection)
        warnings += beside.warnings
    return Search(plant, aligned, floor, fitter, selector, selection, near, rates, balanced, warnings, beside)


def _replayer(plant: Plant, aligned: Aligned, floor: Array, nominal: Variant, options: Options) -> Replayer:
    """A replayer of windows as long as this robot lets them be, or of those that were chosen."""
    if options.cut is not None:
        return Replayer(plant, aligned, options.cut(aligned), floor, options.threads)
    most = options.max_windows or affordable(plant.model)
    longest = options.horizon or (HORIZON if light(plant.model) else HORIZON_HEAVY)
    avoided = at_limit(aligned, floor)
    made = Replayer(plant, aligned, cut(aligned, longest, options.warm_up, most, avoided), floor, options.threads)
    horizon = usable_horizon(made, nominal)
    if horizon > 0.9 * longest:
        further = longer(aligned, options.warm_up)
        if options.horizon or longest < HORIZON or further <= longest or not forgets(made, nominal):
            return made
        # Twice the seconds, for a steady error shows once in each.
        windows = cut(aligned, further, options.warm_up, round(2.0 * most * longest / further), avoided)
        return Replayer(plant, aligned, windows, floor, options.threads)
    # As many seconds of motion in shorter windows.
    windows = cut(aligned, horizon, options.warm_up, round(most * longest / horizon), avoided)
    return Replayer(plant, aligned, windows, floor, options.threads)
