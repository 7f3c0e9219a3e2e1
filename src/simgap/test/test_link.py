"""Links that lose and delay, against many simulated ones; and effects that grow with time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from robots import aligned_of, simulate

from simgap.analysis.diagnose import diagnose
from simgap.analysis.options import Options
from simgap.blind.cases import Case, Injected, robot_of
from simgap.blind.recordings import realise
from simgap.data.mapping import parse_map
from simgap.data.plant import build_plant
from simgap.data.recording import recording_from_table
from simgap.effects.base import Context, Effect
from simgap.effects.growing import Growing
from simgap.effects.library import enumerate_effects
from simgap.inference.fit import Fitter
from simgap.inference.hypothesis import Hypothesis
from simgap.inference.residual import Residuals
from simgap.inference.select import Selector
from simgap.inference.selection import Selection
from simgap.inference.stochastic_link import Chance
from simgap.simulation.lateness import Lateness
from simgap.simulation.replay import Replayer
from simgap.simulation.scales import measure_scales
from simgap.simulation.signal_path import shape_inputs
from simgap.simulation.variant import Variant
from simgap.simulation.windows import cut

Array = NDArray[np.float64]


def _effect(name: str, seconds: float = 6.0) -> tuple[Replayer, Effect]:
    plant, aligned, floor = aligned_of("pendulum", simulate("pendulum", seconds))
    replayer = Replayer(plant, aligned, cut(aligned), floor, 1)
    context = Context(plant, measure_scales(replayer, Variant.nominal(plant)))
    return replayer, enumerate_effects(context, only=(name,))[0]


def _acting(name: str, value: float) -> tuple[Array, Array, float]:
    """(recorded command, command that acts on average, period)."""
    replayer, effect = _effect(name)
    variant = Variant.nominal(replayer.plant)
    effect.apply(variant, (value,))
    return (
        replayer.aligned.inputs[:, 0],
        shape_inputs(replayer.aligned, [variant.inputs])[0, :, 0],
        replayer.aligned.period,
    )


def test_loss_is_the_mean_of_lossy_links() -> None:
    told, acting, _ = _acting("link_loss", 0.6)
    rng, runs = np.random.default_rng(0), np.empty((3000, len(told)))
    held = np.full(len(runs), told[0])
    for k, u in enumerate(told):
        held = np.where(rng.random(len(runs)) < 0.6, held, u)
        runs[:, k] = held
    error = np.abs(acting - runs.mean(axis=0))
    assert error.max() < 5 * (runs.std(axis=0) / np.sqrt(len(runs))).max()
    assert np.abs(told - acting).max() > 10 * error.max()


def test_jitter_is_the_mean_of_links_whose_newest_command_acts() -> None:
    told, acting, period = _acting("link_jitter", 0.03)
    rng, runs = np.random.default_rng(0), np.empty((3000, len(told)))
    rows = np.arange(len(told))
    for i in range(len(runs)):
        # Half a period after each update, the newest of those that have come by then.
        arrived = np.ceil(np.maximum(rng.exponential(0.03 / period, len(told)) - 0.5, 0.0)).astype(int) + rows
        newest = np.zeros(2 * len(told) + 400, int)
        np.maximum.at(newest, np.minimum(arrived, len(newest) - 1), rows)
        runs[i] = told[np.maximum.accumulate(newest)[: len(told)]]
    error = np.abs(acting - runs.mean(axis=0))
    assert error.max() < 5 * (runs.std(axis=0) / np.sqrt(len(runs))).max()
    assert np.abs(told - acting).max() > 10 * error.max()


@pytest.mark.parametrize("loss", [0.3, 0.8])
def test_a_loss_is_forgotten_with_the_next_command_that_arrives(loss: float) -> None:
    law = Lateness(loss, 0.0)
    np.testing.assert_allclose(law.ages(), (1 - loss) * loss ** np.arange(len(law.ages())), atol=1e-5)
    np.testing.assert_allclose(law.memory(6), loss ** np.arange(6), atol=0.06)


def test_a_link_that_does_nothing_is_neutral() -> None:
    ramp = np.arange(10.0)[:, None]
    mean, deviation = Lateness(0.0, 0.0).moments(ramp, 2)
    np.testing.assert_allclose(mean, ramp)
    np.testing.assert_allclose(deviation, 0.0, atol=1e-9)


def _lossy(table: dict[str, Array]) -> dict[str, Array]:
    """Half of the commands are lost."""
    kept = np.random.default_rng(5).random(len(table["u"])) > 0.5
    kept[0] = True
    return {"u": table["u"][np.maximum.accumulate(np.where(kept, np.arange(len(kept)), 0))]}


def _pushed(table: dict[str, Array]) -> dict[str, Array]:
    """Something that no library knows: commands are bent where they are large, and shake."""
    t = 0.005 * np.arange(len(table["u"]))
    return {"u": table["u"] + 0.05 * np.sin(2.0 * np.pi * 3.1 * t) * (table["u"] > 0)}


@pytest.mark.parametrize(("signal", "random"), [(_lossy, True), (_pushed, False)])
def test_chance_is_told_from_what_no_effect_explains(
    signal: Callable[[dict[str, Array]], dict[str, Array]], random: bool
) -> None:
    plant, aligned, floor = aligned_of("pendulum", simulate("pendulum", 6.0, signal=signal))
    replayer = Replayer(plant, aligned, cut(aligned), floor, 1)
    nominal = Variant.nominal(plant)
    effects = enumerate_effects(Context(plant, measure_scales(replayer, nominal)), only=("link_loss",))
    selector = Selector(Fitter(Residuals.build(replayer, nominal), []), effects)
    reference = selector.scores.scored(selector.fitter.cross_validate(selector.fitter.fit_nuisances()))
    selection = Selection(reference, reference.gap, reference)
    Chance(selector).reconsider(selection)
    if not random:
        assert selection.best is reference
        return
    best = selection.best
    assert best.key == "link_loss@all"
    assert abs(best.fit.x[0] - 0.5) < 3 * np.sqrt(best.fit.covariance[0, 0]) + 0.05
    # What is left is as large as noise and chance make it.
    assert selector.scores.typical(reference.fit.held) > 5 and selector.scores.typical(best.fit.held) < 1.3
    assert selection.gains[0][1] > 0


@pytest.mark.long
def test_a_push_that_comes_and_goes_is_not_taken_for_a_lossy_link() -> None:
    """A link that loses nine commands of ten would explain it, were three nominal numbers further off than they are."""
    places = ("cart", "push", "slide", "x")
    push = Injected("periodic_push", "joint", "slide", ("slide",), "strong", 0.7593798736558561, False, places)
    case = realise(Case("017", "cart_pole", "unknown", (52817364, 17), 15.0, [push]))
    assert [f.key for f in case.faults] == ["periodic_push@slide"]
    robot = robot_of(case.robot)
    plant = build_plant(robot.spec(), parse_map(robot.mapping))
    options = Options(only=("link_loss", "link_jitter"), baselines=False, threads=1)
    found = diagnose([recording_from_table(case.columns, plant)], plant, options)
    assert found.report["verdict"] == "unknown"


def test_growth_makes_the_model_change_over_the_recording() -> None:
    replayer, friction = _effect("coulomb_friction", 8.0)
    fitter = Fitter(Residuals.build(replayer, Variant.nominal(replayer.plant)), [])
    grown, none = Growing(friction, 8.0), np.zeros(0)
    plain, steady, growing = (
        fitter.replay(Hypothesis((effect,)), [(np.array(x), none)])[0]
        for effect, x in ((friction, [0.1]), (grown, [0.1, 0.0]), (grown, [0.1, 0.02]))
    )
    np.testing.assert_array_equal(plain, steady)
    moved = np.abs(growing - plain).mean(axis=(1, 2))
    assert moved[0] > 3 * moved[len(moved) // 2] and moved[-1] > 3 * moved[len(moved) // 2]
    # In a part of the windows it is what it is in all of them.
    select = np.array([0, 5, 7])
    some = fitter.replay(Hypothesis((grown,)), [(np.array([0.1, 0.02]), none)], select)[0]
    np.testing.assert_array_equal(some, growing[select])
