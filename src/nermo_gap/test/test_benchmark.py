"""The development benchmark: a truth of its own, and a score that counts right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from nermo_gap.benchmark import robots
from nermo_gap.benchmark.faults import FAULTS, UNKNOWN
from nermo_gap.benchmark.run import LAYOUT, make_case, score
from nermo_gap.benchmark.truth import PERIOD, Truth, build, record
from nermo_gap.core.isolability import angle_matrix

Array = NDArray[np.float64]


def test_the_truth_shares_no_code_with_the_library() -> None:
    folder = Path(robots.__file__).parent
    for name in ("truth.py", "faults.py", "robots.py"):
        assert "nermo_gap.core" not in "".join(
            line for line in (folder / name).read_text().splitlines() if line.startswith(("import", "from"))
        )


def _record(truth: Truth, seconds: float = 4.0, seed: int = 3) -> Array:
    n = int(seconds / PERIOD)
    commands = robots.commands("arm", seed, n, PERIOD)
    told = np.stack([commands["u0"], commands["u1"]], 1)
    return record(truth, told, LAYOUT["arm"]["read"], 0.0, np.random.default_rng(0))[1]


def _arm(play: dict[str, float] | None = None, spread: tuple[float, float] = (0.0, 0.0)) -> Truth:
    return build(robots.ARM, np.random.default_rng(1), play, spread)


@pytest.mark.parametrize("fault", [f for f in (*FAULTS, *UNKNOWN) if f.kind in ("joint", "body", "actuator", "servo")])
def test_every_fault_changes_the_motion_more_when_it_is_stronger(fault) -> None:  # type: ignore[no-untyped-def]
    healthy = _record(_arm())
    sizes = []
    for size in (fault.sizes[0], fault.sizes[2]):
        truth = _arm()
        fault.inject(truth, LAYOUT["arm"][fault.kind][1], size)
        sizes.append(float(np.abs(_record(truth) - healthy).mean()))
    assert 0 <= sizes[0] < sizes[1] and sizes[1] > 1e-3


def test_a_play_joint_lags_at_reversals() -> None:
    tight, loose = _record(_arm({"elbow": 0.002})), _record(_arm({"elbow": 0.1}))
    healthy = _record(_arm())
    assert np.abs(tight - healthy)[:, 1].mean() < 0.2 * np.abs(loose - healthy)[:, 1].mean()
    assert np.abs(loose - healthy)[:, 1].max() < 0.3


def test_numbers_are_off_by_five_to_ten_percent() -> None:
    exact, off = _arm(), _arm(spread=(0.05, 0.10))
    ratio = off.kp / exact.kp
    assert ((np.abs(ratio - 1) >= 0.05 - 1e-9) & (np.abs(ratio - 1) <= 0.10 + 1e-9)).all()


def test_cases_depend_on_number_and_seed_alone() -> None:
    assert [make_case(n, 5, 10.0) for n in range(20)] == [make_case(n, 5, 10.0) for n in range(20)]
    kinds = {make_case(n, 5, 10.0)["kind"] for n in range(60)}
    assert kinds == {"none", "single", "unknown"}


def test_score_counts() -> None:
    gap = {"nuisances_only": 5.0}
    right = {"kind": "single", "fault": "mass", "truth_site": "fore", "verdict": "effect", "found": ["mass@fore"],
             "equivalent": [], "gap": gap}  # fmt: skip
    alias = right | {"found": ["inertia@fore"], "verdict": "ambiguous", "equivalent": [["inertia@fore", "mass@fore"]]}
    wrong = right | {"found": ["armature@elbow"]}
    none = {"kind": "none", "verdict": "no_gap"}
    counted = score([right, alias, wrong, none, none | {"verdict": "effect"}])
    assert counted["top1"]["value"] == pytest.approx(1 / 3) and counted["top1"]["n"] == 3
    assert counted["class"]["value"] == pytest.approx(2 / 3)
    assert counted["false_alarms"]["value"] == pytest.approx(0.5)
    assert counted["abstention_on_unknown"]["n"] == 0


def test_angles_are_between_lines() -> None:
    one, two = np.array([1.0, 0.0]), np.array([1.0, 1.0])
    angles = angle_matrix([one, -2 * one, two, 0 * one])
    np.testing.assert_allclose(angles[0], [0, 0, 45, 90], atol=1e-6)
