"""What is to be small. Each part is a ratio to the thesis's parameters: 1 is as good as these, less is better."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from nermo_description.results import CommandError

if TYPE_CHECKING:
    from nermo_sim.optimize.rollout import Metrics


@dataclass(frozen=True, slots=True)
class Part:
    """A cost by itself, or one of a mix."""

    meaning: str
    ratio: Callable[[Metrics, Metrics], float]
    """Of a rollout's metrics and the baseline's; less is better."""


PARTS = {
    "speed": Part("time for a metre", lambda run, baseline: baseline["speed_m_s"] / run["speed_m_s"]),
    "roll": Part("deviation of roll", lambda run, baseline: run["roll_sd_deg"] / baseline["roll_sd_deg"]),
    "cot": Part("cost of transport", lambda run, baseline: run["cost_of_transport"] / baseline["cost_of_transport"]),
}
LIMIT_CYCLE = "limit-cycle"
COSTS = {name: part.meaning for name, part in PARTS.items()} | {
    "mix": "a weighted mean of these",
    LIMIT_CYCLE: "cheetah_cub's own",
}
"""What each word of --cost means."""
WORST = 10.0
"""No part is worse than this, and a fall is as bad."""
SLOWNESS = 20.0
"""Weight of what is missing to the least speed, as a share of the baseline: 10 % cost as much as 2 baselines."""


def parts(metrics: Metrics, baseline: Metrics) -> dict[str, float]:
    """Each part's ratio to the baseline."""
    if metrics["fell"] or metrics["speed_m_s"] <= 0.0:
        return dict.fromkeys(PARTS, WORST)
    return {name: min(part.ratio(metrics, baseline), WORST) for name, part in PARTS.items()}


@dataclass(frozen=True, slots=True)
class Objective:
    """A weighted mean of the parts, and a penalty below the least speed (a mouse that stands does not roll)."""

    weights: Mapping[str, float]
    least_speed: float = 0.9
    """Share of the baseline's speed."""

    def __call__(self, metrics: Metrics, baseline: Metrics) -> float:
        """The cost; 1 for the baseline itself."""
        found = parts(metrics, baseline)
        cost = sum(weight * found[name] for name, weight in self.weights.items()) / sum(self.weights.values())
        missing = self.least_speed - metrics["speed_m_s"] / baseline["speed_m_s"]
        return float(cost + SLOWNESS * max(0.0, missing))


def weights_of(cost: str, text: str = "") -> dict[str, float]:
    """Weights of a cost; of a mix as in "speed=1,roll=2,cot=0.5", all alike where nothing is said.

    Raises CommandError (status 2).
    """
    if cost not in COSTS or cost == LIMIT_CYCLE:
        raise CommandError(f"--cost {cost!r} is unknown: choose among {', '.join(COSTS)}", status=2)
    if cost != "mix":
        if text:
            raise CommandError(f"--weights belong to --cost mix, not to {cost}", status=2)
        return {cost: 1.0}
    if not text:
        return dict.fromkeys(PARTS, 1.0)
    weights: dict[str, float] = {}
    for entry in text.split(","):
        name, _, number = (part.strip() for part in entry.partition("="))
        try:
            value = float(number)
        except ValueError:
            value = -1.0
        if name not in PARTS or name in weights or not 0.0 <= value <= 1e3:
            raise CommandError(
                f"--weights {entry.strip()!r}: wanted NAME=NUMBER, each of {', '.join(PARTS)} at most once, 0 to 1000",
                status=2,
            )
        weights[name] = value
    if sum(weights.values()) <= 0.0:
        raise CommandError("--weights: at least one must be above 0", status=2)
    return weights
