"""How small a fault a recording could show: by part, and honest about what it cannot."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from robots import aligned_of, plant_of, simulate

from simgap.console import size_of
from simgap.data.recording import recording_from_table
from simgap.effects.library import effect_classes
from simgap.preparation.check import check
from simgap.preparation.detectability import Detectable, advice, detectability

Rows = dict[tuple[str, str], Detectable]


@cache
def _rows(name: str, seconds: float = 12.0, noise: float = 2e-4, still: bool = False) -> Rows:
    table = simulate(name, seconds, noise=noise)
    if still:
        resting = 0.3 + noise * np.random.default_rng(0).standard_normal(len(table["t"]))
        table |= {"q1": resting, "u1": np.full_like(resting, 0.3)}
    return {(row.effect, row.site): row for row in detectability(*aligned_of(name, table), threads=1)}


def test_a_recording_that_moves_shows_friction_gain_and_delay_by_part() -> None:
    rows = _rows("arm")
    for effect, site in (
        ("coulomb_friction", "elbow"),
        ("coulomb_friction", "shoulder"),
        ("viscous_friction", "elbow"),
        ("servo_gain", "elbow_servo"),
        ("servo_delay", "shoulder_servo"),
        ("mass", "fore"),
    ):
        assert rows[effect, site].smallest is not None, (effect, site)
    friction = rows["coulomb_friction", "elbow"]
    # The servo pulls with about 3 N m; a hundredth of that shows.
    assert friction.unit == "N m" and friction.smallest is not None and 1e-4 < friction.smallest < 0.05
    assert friction.sensor == "q1" and 0.0 <= friction.segment[0] < friction.segment[1] <= 12.0


@pytest.mark.parametrize(("factor", "told"), [(1.00042, "x 1.00042"), (1.1234, "x 1.12"), (0.98765, "x 0.988")])
def test_a_factor_that_hardly_differs_from_one_is_not_told_as_one(factor: float, told: str) -> None:
    assert size_of(Detectable("servo_gain", "elbow", "factor", "1", factor, None, "q1", (0.0, 1.0))) == told


def test_a_fault_of_the_smallest_size_is_about_what_it_takes() -> None:
    """Friction of the size that would be found moves windows by some noise floors: not by none, and not by hundreds."""
    from simgap.inference.residual import Residuals
    from simgap.simulation.replay import Replayer
    from simgap.simulation.variant import Variant
    from simgap.simulation.windows import cut

    row = _rows("arm")["coulomb_friction", "elbow"]
    assert row.smallest is not None
    plant, aligned, floor = aligned_of("arm", simulate("arm", 12.0))
    replayer = Replayer(plant, aligned, cut(aligned), floor, 1)
    nominal, worse = Variant.nominal(plant), Variant.nominal(plant)
    worse.model.dof_frictionloss[1] += row.smallest
    residuals = Residuals.build(replayer, nominal)
    change = residuals.of([nominal, worse])
    size = float(np.sqrt(np.mean(np.sum((change[1] - change[0]) ** 2, axis=(1, 2)))))
    assert 0.3 < size < 30.0


def test_ten_times_the_noise_hides_more() -> None:
    quiet, loud = _rows("arm"), _rows("arm", noise=2e-3)
    for key in (("coulomb_friction", "elbow"), ("servo_gain", "shoulder_servo"), ("servo_delay", "elbow_servo")):
        small, large = quiet[key].smallest, loud[key].smallest
        assert small is not None
        # Of a factor, its distance from 1.
        about = 1.0 if quiet[key].unit == "1" else 0.0
        assert large is None or abs(large - about) > 2.0 * abs(small - about), key


def test_a_joint_that_stands_still_shows_nothing_of_itself() -> None:
    """But for what holds it while its neighbour moves."""
    rows, moving = _rows("arm", still=True), _rows("arm")
    for effect in ("servo_delay", "servo_dead_band", "servo_backlash", "servo_offset"):
        assert rows[effect, "elbow_servo"].smallest is None, effect
        assert moving[effect, "elbow_servo"].smallest is not None, effect
    held, moved = (of["joint_stiffness", "elbow"].smallest for of in (rows, moving))
    assert moved is not None and (held is None or held > 5.0 * moved)
    assert rows["coulomb_friction", "shoulder"].smallest is not None


@pytest.mark.parametrize("name", ["pendulum", "leg"])
def test_every_effect_that_can_act_there_has_its_row_once(name: str) -> None:
    rows = _rows(name, 6.0)
    assert {effect for effect, _ in rows} <= set(effect_classes())
    assert ("ground_friction" in {effect for effect, _ in rows}) == (name == "leg")
    for row in rows.values():
        assert row.rival is None or row.smallest is not None
        assert row.smallest is None or np.isfinite(row.smallest)


def test_what_is_alike_is_named() -> None:
    assert _rows("pendulum")["coulomb_friction", "hinge"].rival == "stribeck_friction@hinge"


def test_check_says_what_nobody_could_find() -> None:
    plant, table = plant_of("arm"), simulate("arm", 8.0)
    rng = np.random.default_rng(0)
    still = {c: 0.3 + 2e-4 * rng.standard_normal(len(table["t"])) for c in ("q0", "q1")}
    rest = {c: np.full(len(table["t"]), 0.3) for c in ("u0", "u1")}
    found = check([recording_from_table({**table, **still, **rest}, plant)], plant, detect=True)
    assert found.verdict == "poor" and found.detectability == []
    assert any("no effect could be found" in line for line in found.warnings)
    assert check([recording_from_table(table, plant)], plant).detectability is None


def test_advice_names_what_would_show_more() -> None:
    def row(effect: str, site: str, smallest: float | None, rival: str | None = None) -> Detectable:
        return Detectable(effect, site, "p", "1", smallest, rival, "q", (0.0, 1.0))

    said = advice(
        [
            row("servo_torque_limit", "elbow_servo", None),
            row("servo_delay", "a", 0.1, "servo_delay@b"),
            row("servo_delay", "b", 0.1, "servo_delay@a"),
            row("coulomb_friction", "elbow", 0.1, "stribeck_friction@elbow"),
        ]
    )
    assert said == [
        "load the servo until it gives way, to see servo_torque_limit (elbow_servo)",
        "move a and b one after the other, to tell which of the two is to blame",
        "turn round slowly, to tell the laws of friction apart (elbow)",
    ]
