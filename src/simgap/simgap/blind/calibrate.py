"""Which law error and sparsity make the probabilities of a scored check mean what they say.

Each diagnosis tells what its probabilities rest on (`evidence`), so they are weighed anew without a single replay. The
best pair is that of the highest mean log score: the log of the probability given to the truth, which rewards being
right and punishes being sure and wrong.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simgap.blind.make import BlindError, read_manifest
from simgap.blind.score import read_answers
from simgap.inference.calibrated import calibrated
from simgap.inference.decision import Evidence

Array = NDArray[np.float64]

LAW_ERRORS = (0.005, 0.01, 0.02, 0.03, 0.04, 0.06, 0.08, 0.12, 0.2)
SPARSITIES = (0.0, 0.5, 1.0, 1.5, 2.0)
LEAST = 1e-3
"""Probability below which a wrong answer is not punished further: one mistake must not decide."""
_KINDS = ("none", "single", "pair")


@dataclass(frozen=True)
class Case:
    """A diagnosis with its truth: the evidence, and which hypotheses name the truth, (nh,)."""

    evidence: Evidence
    right: NDArray[np.bool_]

    def log_score(self, law_error: float, sparsity: float) -> float:
        """Log of the probability that the truth gets."""
        weight = self.evidence.weights(law_error, sparsity)
        return float(np.log(max(float(weight[self.right].sum()), LEAST)))


def read(folder: Path, answers: Path, results: Path) -> list[Case]:
    """Cases of a check whose diagnoses were kept; those without evidence, or whose truth the library lacks, left out.

    Raises:
        BlindError: no diagnosis was kept, or the answers are not the sealed ones.
    """
    truths, found = read_answers(read_manifest(folder), answers), []
    for name, truth in sorted(truths.items()):
        path = results / f"{name}.json"
        if truth["kind"] not in _KINDS or not path.is_file():
            continue
        told = json.loads(path.read_text(encoding="utf-8")).get("evidence")
        if told is not None:
            found.append(case(told, [f"{f['name']}@{f['site']}" for f in truth["faults"]]))
    if not found:
        raise BlindError(f"{results}: holds no diagnosis with evidence; diagnose with --keep")
    return found


def case(told: dict[str, Any], truth: Sequence[str]) -> Case:
    """A case from the key `evidence` of a diagnosis and the true effects (name@site)."""
    evidence = Evidence.of(told)
    named = [any(set(one) == set(truth) for one in answer) for answer in told["effects"]]
    return Case(evidence, np.array([named[a] for a in evidence.answers], bool))


def propose(cases: Sequence[Case]) -> dict[str, Any]:
    """Mean log score of every pair of numbers; the best, with its standard error, and that of the numbers in use."""
    rows: list[dict[str, Any]] = []
    for law_error in LAW_ERRORS:
        for sparsity in SPARSITIES:
            scores = [c.log_score(law_error, sparsity) for c in cases]
            rows.append({"law_error": law_error, "sparsity": sparsity, "log_score": float(np.mean(scores))})
    best = max(rows, key=lambda row: float(row["log_score"]))
    used = calibrated()
    now = np.array([c.log_score(used.law_error, used.sparsity) for c in cases])
    then = np.array([c.log_score(best["law_error"], best["sparsity"]) for c in cases])
    error = float(np.std(then - now, ddof=1) / np.sqrt(len(cases))) if len(cases) > 1 else float("nan")
    return {
        "cases": len(cases),
        "in_use": {"law_error": used.law_error, "sparsity": used.sparsity, "log_score": float(now.mean())},
        "best": best | {"gain": float((then - now).mean()), "standard_error": error},
        "grid": rows,
    }
