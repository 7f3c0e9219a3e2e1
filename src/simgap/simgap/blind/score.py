"""Scores a blind check: every rate with its interval, the obvious alternatives beside it, and the confusion matrix."""

from __future__ import annotations

import hashlib
import json
import platform
from collections import Counter
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, ClassVar

import mujoco
import numpy as np
from scipy.stats import binomtest

from simgap.blind.make import BlindError, read_manifest
from simgap.blind.reliability import reliability, table
from simgap.blind.run import results_of

Row = dict[str, Any]
Metric = dict[str, Any]

Range = tuple[float | None, float | None]
"""(lowest, highest); None where there is no limit."""

AIMS: dict[str, tuple[Range, Range]] = {
    "top1_effect_and_site": ((0.95, None), (0.80, None)),
    "equivalence_class": ((0.98, None), (0.90, None)),
    "localisation": ((0.99, None), (0.95, None)),
    "parameter_error": ((None, 0.05), (None, 0.15)),
    "heldout_shrink": ((0.90, None), (0.70, None)),
    "false_alarms": ((None, 0.01), (None, 0.05)),
    "unknown_abstention": ((0.95, None), (0.80, None)),
    "exact_pairs": ((0.85, None), (0.60, None)),
    "interval_coverage": ((0.88, 0.92), (0.80, 0.95)),
    "interval_coverage_with_pairs": ((0.88, 0.92), (0.80, 0.95)),
    "time_to_verdict_s": ((None, 60.0), (None, 300.0)),
}
"""Metric: aim, and the floor under which the diagnosis does not count as solved."""
TITLES = {
    "top1_effect_and_site": "single: effect and site named alone",
    "equivalence_class": "single: in the class that is named",
    "localisation": "single: the right part of the robot",
    "parameter_error": "single: error of the parameter (median, relative)",
    "heldout_shrink": "single, pair: held-out gap above the noise floor that is removed (median)",
    "false_alarms": "none: an effect is claimed",
    "unknown_abstention": "unknown: says so",
    "exact_pairs": "pair: both effects and sites",
    "interval_coverage": "single: 90 % interval holds the truth",
    "interval_coverage_with_pairs": "single, pair: 90 % interval holds the truth",
    "time_to_verdict_s": "time to verdict (median)",
}


def score(folder: Path, answers: Path, results: Path) -> dict[str, Any]:
    """Compare results with the sealed answers.

    Raises:
        BlindError: answers missing, or not those whose hashes were published; or results of another check.
    """
    manifest = read_manifest(folder)
    truth = read_answers(manifest, answers)
    found = results_of(manifest, results)
    rows = [judged(truth[i], found[i]) for i in sorted(found) if i in truth]
    if not rows:
        raise BlindError(f"{results}: holds no result of this check")
    models = _Models(folder)
    return {
        "schema": "nermo_gap/blind_score/1",
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "command": "simgap blind score",
        "seed": _seed(answers),
        "robot": sorted({r["robot"] for r in rows}),
        "versions": {"mujoco": mujoco.__version__, "python": platform.python_version()},
        "made": len(truth),
        "scored": len(rows),
        "status": dict(Counter(r["status"] for r in rows)),
        "isolated_by_landlock": sum(bool(r["isolated"]) for r in rows),
        **metrics(rows),
        "alternatives": {
            "best_in_sample": _best_in_sample(rows),
            "fit_everything": _fit_everything(rows, models),
        },
        "by_level": _by(rows, lambda r: r["level"]),
        "by_effect": _by(rows, lambda r: r["truth"][0].split("@")[0] if r["truth"] else None),
        "by_robot": _by(rows, lambda r: r["robot"]),
        "verdicts": {k: dict(Counter(r["verdict"] for r in rows if r["kind"] == k)) for k in _KINDS},
        "confusion": confusion(rows),
        "reliability": reliability(rows),
        "cases": rows,
    }


HEALTHY = ("no_gap", "calibration")
"""Verdicts on a robot without a fault: its numbers are 5 to 10 % off, which may show or not."""
_KINDS = ("none", "single", "pair", "unknown")


def read_answers(manifest: dict[str, Any], answers: Path) -> dict[str, dict[str, Any]]:
    """The sealed answers by case, each checked against its published hash."""
    found = {}
    for case in manifest["cases"]:
        path = answers / f"{case['id']}.json"
        try:
            text = path.read_text(encoding="utf-8")
        except OSError as error:
            raise BlindError(f"{path} cannot be read: {error.strerror}") from error
        if hashlib.sha256(text.encode()).hexdigest() != case["answer_sha256"]:
            raise BlindError(f"{path}: not the answer that was sealed (its SHA-256 differs from the published one)")
        found[case["id"]] = json.loads(text)
    return found


def _seed(answers: Path) -> int | None:
    try:
        return int(json.loads((answers / "answers.json").read_text(encoding="utf-8"))["seed"])
    except (OSError, ValueError, KeyError):
        return None


def judged(truth: dict[str, Any], found: Row) -> Row:
    """One case: what was true, what was said, and whether that is right."""
    faults = truth["faults"]
    keys = [f"{f['name']}@{f['site']}" for f in faults]
    effects = found.get("effects") or []
    named = [f"{e['name']}@{e['site']}" for e in effects]
    verdict = found.get("verdict", "none given")
    asserted = verdict in ("effect", "ambiguous", "partial")
    alike = {n for group in found.get("equivalent") or [] for part in group for n in part.split(" + ")} | set(named)
    gap = found.get("gap") or {}
    row: Row = {
        "id": truth["id"],
        "robot": truth["robot"],
        "kind": truth["kind"],
        "truth": keys,
        "level": faults[0]["level"] if faults else None,
        "sizes": [f["size"] for f in faults],
        "status": found.get("status"),
        "verdict": verdict,
        "found": named,
        "equivalent": found.get("equivalent") or [],
        "gap_before": gap.get("before"),
        "gap_after": gap.get("after"),
        "shrink": gap.get("shrink"),
        "shrink_above_floor": _above_floor(gap),
        "effect_on_recording": truth.get("effect_on_recording"),
        "baselines": found.get("baselines") or {},
        "wall_s": found.get("wall_s"),
        "isolated": (found.get("isolation") or {}).get("landlock", False),
        "reasons": found.get("reasons") or [],
        "error": found.get("error"),
        "sure": (found.get("probabilities") or {}).get(verdict),
    }
    if truth["kind"] in ("single", "pair"):
        held = [_parameter(fault, effects)["covered"] for fault in faults]
        row["intervals"] = [h for h in held if h is not None]
    match truth["kind"]:
        case "none":
            row["correct"] = verdict in HEALTHY
        case "unknown":
            row["correct"] = verdict == "unknown" or (verdict == "partial" and not named)
        case "single":
            row["top1"] = asserted and named == keys
            row["in_class"] = row["correct"] = asserted and keys[0] in alike
            row["located"] = _located(faults[0], effects, found)
            row |= _parameter(faults[0], effects)
        case "pair":
            row["exact"] = asserted and set(named) == set(keys)
            row["correct"] = row["in_class"] = asserted and set(keys) <= alike
    return row


def _above_floor(gap: dict[str, Any]) -> float | None:
    if not gap:
        return None
    before, after = max(gap["before"] - 1.0, 0.05), max(gap["after"] - 1.0, 0.0)
    return float(1.0 - after / before)


def _located(fault: dict[str, Any], effects: list[dict[str, Any]], found: Row) -> bool:
    """Whether the part of the robot is right: of an effect, or, without one, of the largest share of the gap."""
    places = set(fault["places"])
    if effects:
        return any(e["site"] in places for e in effects)
    where = found.get("where") or []
    return bool(where) and bool({where[0]["channel"], where[0]["subsystem"]} & places)


def _parameter(fault: dict[str, Any], effects: list[dict[str, Any]]) -> Row:
    """Relative error of the largest parameter, and whether its interval holds the truth, where the effect was named."""
    key = (fault["name"], fault["site"])
    effect = next((e for e in effects if (e["name"], e["site"]) == key), None)
    shared = {n: v for n, v in fault["parameters"].items() if effect and n in effect["parameters"]}
    if effect is None or not shared:
        return {"parameter_error": None, "covered": None}
    name = max(shared, key=lambda n: abs(shared[n]))
    value, said = shared[name], effect["parameters"][name]
    low, high = said["ci90"]
    return {"parameter_error": abs(said["value"] - value) / max(abs(value), 1e-12), "covered": low <= value <= high}


def metrics(rows: Sequence[Row]) -> dict[str, Metric]:
    """All metrics of a list of judged cases."""
    single = [r for r in rows if r["kind"] == "single"]
    pairs = [r for r in rows if r["kind"] == "pair"]
    return {
        "top1_effect_and_site": rate([r["top1"] for r in single]),
        "equivalence_class": rate([r["in_class"] for r in single]),
        "localisation": rate([r["located"] for r in single]),
        "parameter_error": median([r["parameter_error"] for r in single]),
        "heldout_shrink": median([r["shrink_above_floor"] for r in (*single, *pairs)]),
        "false_alarms": rate([r["verdict"] not in HEALTHY for r in rows if r["kind"] == "none"]),
        "unknown_abstention": rate([r["correct"] for r in rows if r["kind"] == "unknown"]),
        "exact_pairs": rate([r["exact"] for r in pairs]),
        "pairs_in_class": rate([r["in_class"] for r in pairs]),
        "interval_coverage": rate([r["covered"] for r in single if r["covered"] is not None]),
        "interval_coverage_with_pairs": rate([held for r in (*single, *pairs) for held in r["intervals"]]),
        "time_to_verdict_s": median([r["wall_s"] for r in rows]),
    }


def rate(hits: Sequence[bool]) -> Metric:
    """A share with its 90 % binomial interval (Clopper and Pearson)."""
    if not hits:
        return {"value": None, "ci90": None, "n": 0}
    interval = binomtest(sum(map(bool, hits)), len(hits)).proportion_ci(0.9)
    return {
        "value": sum(map(bool, hits)) / len(hits),
        "ci90": [float(interval.low), float(interval.high)],
        "n": len(hits),
    }


def median(values: Sequence[float | None]) -> Metric:
    """A median with its 90 % interval from the order statistics."""
    kept = sorted(float(v) for v in values if v is not None and np.isfinite(v))
    if not kept:
        return {"value": None, "ci90": None, "n": 0}
    n = len(kept)
    half = 1.645 * 0.5 * np.sqrt(n)
    low, high = int(max(np.floor(n / 2 - half), 0)), int(min(np.ceil(n / 2 + half), n - 1))
    return {"value": float(np.median(kept)), "ci90": [kept[low], kept[high]], "n": n}


def _best_in_sample(rows: Sequence[Row]) -> dict[str, Metric]:
    """The single effect with the smallest in-sample error: it always names one and never doubts."""
    said = [(r, r["baselines"].get("best_in_sample") or {}) for r in rows]
    single = [(r, b) for r, b in said if r["kind"] == "single"]
    return {
        "top1_effect_and_site": rate([b.get("effect") == r["truth"][0] for r, b in single]),
        "false_alarms": rate([bool(b.get("effect")) for r, b in said if r["kind"] == "none"]),
        "unknown_abstention": rate([not b.get("effect") for r, b in said if r["kind"] == "unknown"]),
        "heldout_shrink": median([_shrink_to(r, b.get("gap")) for r, b in said if r["kind"] in ("single", "pair")]),
    }


def _fit_everything(rows: Sequence[Row], models: _Models) -> dict[str, Metric]:
    """All numbers of the model at once: it names what it moved most, and claims all it moved by two deviations."""
    said = [(r, r["baselines"].get("fit_everything") or {}) for r in rows]
    said = [(r, b) for r, b in said if b]
    named = [(r, b, models.key(r, _most(b["parameters"]))) for r, b in said]
    return {
        "top1_effect_and_site": rate([k == r["truth"][0] for r, _, k in named if r["kind"] == "single"]),
        "false_alarms": rate([_claims(b) for r, b in said if r["kind"] == "none"]),
        "unknown_abstention": rate([not _claims(b) for r, b in said if r["kind"] == "unknown"]),
        "heldout_shrink": median([_shrink_to(r, b.get("gap")) for r, b in said if r["kind"] in ("single", "pair")]),
    }


def _claims(baseline: dict[str, Any]) -> bool:
    return any(abs(v) > 2.0 for v in baseline["parameters"].values())


def _most(parameters: dict[str, float]) -> str:
    return max(parameters, key=lambda n: abs(parameters[n])) if parameters else ""


def _shrink_to(row: Row, gap: float | None) -> float | None:
    if gap is None or row["gap_before"] is None:
        return None
    return _above_floor({"before": row["gap_before"], "after": gap})


class _Models:
    """Translates what fit-everything calls a number of the model into name@site."""

    _JOINT: ClassVar = {"damping": "viscous_friction", "armature": "armature", "friction": "coulomb_friction"}
    _NAMED: ClassVar = {"mass": "mass", "com": "com_shift", "inertia": "inertia", "gain": "servo_gain"}

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def key(self, row: Row, parameter: str) -> str | None:
        """name@site, or None for a number that is no effect's."""
        words = parameter.split()
        if len(words) < 2:
            return None
        if words[0] in self._NAMED:
            return f"{self._NAMED[words[0]]}@{words[1]}"
        if words[0] in self._JOINT and words[1].isdigit():
            path = self._folder / "data" / row["id"] / "model.xml"
            try:
                model = mujoco.MjModel.from_xml_path(str(path))
            except ValueError as error:
                raise BlindError(f"{path} cannot be read: {error}") from error
            if int(words[1]) < model.nv:
                joint = model.joint(int(model.dof_jntid[int(words[1])])).name
                return f"{self._JOINT[words[0]]}@{joint}"
        return None


def _by(rows: Sequence[Row], group: Callable[[Row], str | None]) -> dict[str, Metric]:
    """Share of right verdicts in each group."""
    names = sorted({g for g in map(group, rows) if g})
    return {n: rate([r["correct"] for r in rows if group(r) == n]) for n in names}


def confusion(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """{true effect: {named effect or verdict: cases}} of cases without, with one and with an unknown effect."""
    matrix: dict[str, Counter[str]] = {}
    for row in rows:
        if row["kind"] == "pair":
            continue
        true = row["truth"][0].split("@")[0] if row["truth"] else "none"
        true = f"({true})" if row["kind"] == "unknown" else true
        matrix.setdefault(true, Counter())[_said(row)] += 1
    return {k: dict(v.most_common()) for k, v in sorted(matrix.items())}


def _said(row: Row) -> str:
    """What a confusion matrix calls the answer: the true effect where it is in the named class, else what was named."""
    if row["status"] != "done":
        return str(row["status"])
    if row["verdict"] in (*HEALTHY, "unknown"):
        return str(row["verdict"]).replace("_", " ")
    true = row["truth"][0] if row["truth"] else ""
    if row["found"] == [true]:
        return true.split("@")[0]
    names = " + ".join(sorted({f.split("@")[0] for f in row["found"]}))
    if row.get("in_class"):
        return f"{names} (class holds the truth)"
    return f"{names} (elsewhere)" if row["kind"] == "single" and names == true.split("@")[0] else names


def markdown(scored: dict[str, Any]) -> str:
    """Tables for docs/gap_blind.md."""
    lines = [
        f"{scored['scored']} of {scored['made']} cases, seed {scored['seed']}, {scored['created'][:10]}; "
        f"{scored['isolated_by_landlock']} diagnosed behind Landlock.",
        "",
        "| what | ours | 90 % | n | aim | floor | best single effect in sample | fit everything |",
        "|---|---|---|---|---|---|---|---|",
    ]
    others = scored["alternatives"]
    for name, (aim, floor) in AIMS.items():
        beside = [cell(others[o].get(name, {}).get("value"), name) for o in ("best_in_sample", "fit_everything")]
        own = scored[name]
        interval = " to ".join(cell(v, name) for v in own["ci90"]) if own["ci90"] else "–"
        row = [TITLES[name], cell(own["value"], name), interval, str(own["n"])]
        row += [between(aim, name), between(floor, name), *beside]
        lines.append("| " + " | ".join(row) + " |")
    for title, key in (("size", "by_level"), ("robot", "by_robot"), ("effect", "by_effect")):
        lines += ["", f"| {title} | right verdicts | 90 % | n |", "|---|---|---|---|"]
        for name, m in scored[key].items():
            lines.append(f"| {name} | {cell(m['value'])} | {' to '.join(map(cell, m['ci90']))} | {m['n']} |")
    lines += [
        "",
        "Confusion (names in brackets: effects that the library lacks).",
        "",
        "| truth | answers |",
        "|---|---|",
    ]
    for true, answers in scored["confusion"].items():
        lines.append(f"| {true} | {', '.join(f'{n} × {a}' for a, n in answers.items())} |")
    lines += ["", "How sure, and how right:", "", *table(scored.get("reliability", []))]
    wrong = [r for r in scored["cases"] if not r["correct"]]
    lines += ["", "What misses:", "", "| case | robot | truth | size | verdict | named |", "|---|---|---|---|---|---|"]
    for r in wrong:
        true, named = " + ".join(r["truth"]) or "nothing", " + ".join(r["found"]) or "–"
        verdict = r["verdict"] if r["status"] == "done" else r["status"]
        lines.append(f"| {r['id']} | {r['robot']} | {true} | {r['level'] or '–'} | {verdict} | {named} |")
    return "\n".join(lines) + "\n"


def between(limits: Range, name: str) -> str:
    """A range of a metric for a table."""
    low, high = limits
    if low is not None and high is not None:
        return f"{cell(low, name)} to {cell(high, name)}"
    return f"≥ {cell(low, name)}" if high is None else f"≤ {cell(high, name)}"


def cell(value: float | None, name: str = "") -> str:
    """A value of a metric for a table."""
    if value is None:
        return "–"
    return f"{value:.0f} s" if name.endswith("_s") else f"{100 * value:.0f} %"
