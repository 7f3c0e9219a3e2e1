"""The verdict in plain words: where the gap sits, what causes it, how far it shrinks."""

from __future__ import annotations

import inspect
from typing import Any

from simgap.effects.library import effect_classes
from simgap.report.figures import subsystem_shares

Report = dict[str, Any]

TITLES = {
    "no_gap": "No gap worth an explanation",
    "calibration": "Numbers of the model within their tolerances explain it",
    "effect": "One cause found",
    "ambiguous": "Several causes explain it equally well",
    "partial": "The causes that were found explain most of it",
    "unknown": "No cause explains a good share of it",
}
_GOOD_SHARE = 0.5
"""Of an unknown gap: what explains more than that is named in the title, and that it is not settled."""
_PHASES = {
    "standstill": "at standstill",
    "reversal": "when the motion changes direction",
    "moving": "while it moves",
    "swing": "in the swing of the leg",
    "stance": "in stance",
    "touch-down": "at touch-down",
    "all legs down": "while all feet stand",
    "one leg up": "while one leg swings",
    "two or more legs up": "while two or more legs swing",
    "all": "throughout",
}


def title(report: Report) -> str:
    """A headline."""
    if report["verdict"] == "effect" and len(report["effects"]) > 1:
        return f"{len(report['effects'])} causes found together"
    if report["verdict"] == "ambiguous" and (sure := _settled(report)):
        return f"{_capital(' and '.join(plain(_key(e)) for e in sure))}, and a further cause that is not settled"
    names = _capital(" and ".join(plain(_key(e)) for e in report["effects"]))
    if report["verdict"] == "partial" and names:
        one = len(report["effects"]) == 1
        return f"{names} explain{'s' if one else ''} most of it, {percent(_left(report))} stays unexplained"
    before = (report.get("corrects") or {}).get("explained", 0.0)
    if report["verdict"] == "partial" and before >= _GOOD_SHARE:
        return f"What the model was corrected for explains {percent(before)} of the gap, the rest has no name"
    if report["verdict"] == "partial":
        return f"Numbers of the model explain most of it, {percent(_left(report))} stays unexplained"
    if report["verdict"] == "unknown" and names and _left(report) < _GOOD_SHARE:
        return f"Not settled: {names[:1].lower() + names[1:]} explains it best"
    return TITLES[report["verdict"]]


def sentences(report: Report) -> list[str]:
    """Where, what, and what nobody looked at; how far in short windows and running free; what is left; limits."""
    parts = (where, what, unfinished, corrected, how_far, free, longer, agreed, left, beside, limits)
    return [text for part in parts if (text := part(report))]


def where(report: Report) -> str:
    """Which subsystem, which phase."""
    shares = subsystem_shares(report)
    if not shares or report["gap"]["before"] < 1.3:
        return "The twin predicts every channel about as well as repeating the experiment would."
    name = next(iter(shares))
    rows = [r for r in report["where"] if r["subsystem"] == name]
    phases: dict[str, float] = {}
    for r in rows:
        phases[r["phase"]] = phases.get(r["phase"], 0.0) + r["share"]
    main = max(phases, key=lambda p: phases[p])
    when = _PHASES.get(main, main.replace("_", " "))
    second = [n for n, s in list(shares.items())[1:3] if s > 0.15]
    rest = f"; {' and '.join(second)} come{'s' if len(second) == 1 else ''} next" if second else ""
    return f"The gap shows most at {name}, with {percent(shares[name])} of it, mostly {when}{rest}."


def what(report: Report) -> str:
    """Which effect of which size, or why none can be named."""
    verdict = report["verdict"]
    if verdict == "no_gap" and report.get("reference"):
        return "Nothing has changed since the robot was well that would show in this recording."
    if verdict == "no_gap":
        return "No known effect predicts the held-out data better than the tolerances of the model already do."
    if verdict == "calibration":
        numbers = "; ".join(_number(row) for row in report["calibration"][:3]) or "many by a little each"
        return f"No part has to behave otherwise: numbers of the model are a little off, {numbers}."
    text = " and ".join(_effect(e) for e in report["effects"])
    if verdict == "unknown":
        reasons = report.get("reasons") or ["a structured residual remains"]
        if text:
            # The page lists all doubts; the first is enough beside the cause.
            return f"What explains most is {text}. It is not settled: {reasons[0]}."
        return f"The cause is not settled: {'; '.join(reasons)}."
    if verdict == "partial" and not text:
        moved = "; ".join(_number(row) for row in report["calibration"][:3])
        numbers = f" Numbers of the model that moved: {moved}." if moved else ""
        return f"No cause earns its place; what is left is explained by nothing that is known.{numbers}"
    if verdict == "partial":
        return (
            f"Most of it is caused by {text}; {percent(_left(report))} of the gap's power is explained by nothing that "
            "is known."
        )
    if verdict != "ambiguous":
        return f"It is caused by {text}."
    rivals = [p for group in report["equivalent"][:1] for p in group[1:]]
    alike = ", ".join(plain(r) for r in rivals) or "others"
    sure = _settled(report)
    if not sure:
        return f"It looks like {text}, but this recording cannot tell that apart from {alike}."
    found = " and ".join(_effect(e) for e in sure)
    beside = " and ".join(_effect(e) for e in report["effects"] if e not in sure)
    if not rivals:
        return f"It is caused by {found}. Beside it {beside} may act: this recording cannot tell whether it does."
    return f"It is caused by {found}. Beside it there is {beside}, which this recording cannot tell apart from {alike}."


def corrected(report: Report) -> str:
    """What the correction of the model is worth in this recording, of one that was corrected."""
    found = report.get("corrects")
    if not found:
        return ""
    if found["gain"] <= 0.0:
        return "The model as it was before it was corrected predicts this recording no worse."
    gap = found["gap"]
    return (
        f"What an earlier diagnosis found is in the model by now: it takes the gap from {gap['before']:.1f} to "
        f"{gap['nuisances_only']:.1f} times the noise floor here, numbers fitted, "
        f"{percent(found['explained'])} of what is above it, and a further cause is judged beside that."
    )


def _settled(report: Report) -> list[dict[str, Any]]:
    """Effects of an ambiguous verdict that all contenders have: one of the others is what is not told apart."""
    contenders = {key for group in report["equivalent"][:1] for key in group}
    if any(" + " in key for key in contenders):
        return []
    sure = [effect for effect in report["effects"] if _key(effect) not in contenders]
    return sure if len(sure) < len(report["effects"]) else []


def _key(effect: dict[str, Any]) -> str:
    return f"{effect['name']}@{effect['site']}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _effect(effect: dict[str, Any]) -> str:
    parts = []
    for name, p in list(effect["parameters"].items())[:3]:
        unit = "" if p["unit"] in ("", "1") else f" {p['unit']}"
        low, high = p["ci90"]
        parts.append(
            f"{name.replace('_', ' ')} {number(p['value'])}{unit}, 90 % between {number(low)} and {number(high)}"
        )
    return f"{plain(_key(effect))} ({'; '.join(parts)})"


def how_far(report: Report) -> str:
    """How the held-out gap shrinks."""
    gap, well = report["gap"], report.get("reference")
    unit, best = (
        ("what the model misses of the healthy robot", "nothing is new")
        if well
        else ("the noise floor", "is as good as repeating it")
    )
    if report["verdict"] == "no_gap":
        return f"The gap on held-out data is {gap['before']:.1f} times {unit}; 1 {'means that ' if well else ''}{best}."
    low, high = gap["ci90"]
    # A change for the worse is said as such.
    change = f"shrinks by {percent(gap['shrink'])}" if gap["shrink"] >= 0 else f"grows by {percent(-gap['shrink'])}"
    text = (
        f"On data that was not used to fit, the gap {change} (90 % between {percent(low)} and {percent(high)}): "
        f"from {gap['before']:.1f} to {gap['after']:.1f} times {unit}, where 1 "
        + ("means that nothing is new" if well else "is as good as repeating the experiment")
    )
    return text + (", which is the best that anything known does." if report["verdict"] == "unknown" else ".")


def free(report: Report) -> str:
    """What a user of the corrected model gets: the error of whole runs, in the channel that shows most of the gap."""
    first, last = report["waterfall"][0]["free_running"], report["waterfall"][-1]["free_running"]
    loud = [row["channel"] for row in report["where"] if first.get(row["channel"]) is not None] or list(first)
    if report["verdict"] == "no_gap" or not loud or first[loud[0]] is None:
        return ""
    name, rows = loud[0], report["free_running"]
    unit, stretch = rows[0]["unit"].get(name, ""), rows[0]["stretch_s"]
    if last.get(name) is None or first[name] != first[name] or last[name] != last[name]:
        return f"Running free, a simulation breaks down; {name} cannot be compared over whole runs."
    mine = [r for r in rows if r["model"] == "diagnosed"]
    if stretch:
        how = f"over {stretch:g} s, after which chaos tells"
    elif all(r["cut_short"] for r in mine):
        how = f"for the first {max(r['duration_s'] for r in mine):.3g} s of a run"
    else:
        how = "from the start of a run to its end"
    seen = " (runs that were also fitted)" if all(r["fitted_on_it"] for r in mine) else ""
    change = "falls" if last[name] <= first[name] else "grows"
    return (
        f"Running free {how}{seen}, the error at {name} {change} from {amount(first[name], unit)} to "
        f"{amount(last[name], unit)}."
    )


def longer(report: Report) -> str:
    """That the numbers are those of long windows, where they are."""
    found = report.get("long_windows")
    if not found:
        return ""
    wider = found["prior_wider"]
    freer = f", and what no drawing holds may be {wider:g} times as far off as usual" if wider > 1.0 else ""
    return (
        f"Sizes and numbers are those of windows of {found['horizon_s']:.3g} s{freer}: runs that a fit has not seen "
        f"are {found['gain']:.0f} nats likelier with them. Which cause acts was decided in short windows."
    )


def left(report: Report) -> str:
    """What is left and what it goes with."""
    return "" if report["verdict"] == "no_gap" else str(report["remainder"]["sentence"])


def agreed(report: Report) -> str:
    """Whether runs, or halves of the recording, say the same."""
    return str(report["agreement"]["sentence"]) if report.get("agreement") else ""


def beside(report: Report) -> str:
    """The best further cause that was looked at and is not named; none that gained nothing."""
    row = report.get("rejected")
    if not row or row["gap_gain"] <= 0.0 or not report["effects"]:
        return ""
    names = " and ".join(plain(key) for key in row["effects"])
    return (
        f"Beside it {names} would gain most, {row['gap_gain']:.0f} nats where {row['asked']:.0f} and a good share of "
        "what is left are asked of a further cause, and is not named."
    )


def unfinished(report: Report) -> str:
    """What nobody looked at: no answer is surer than the search was long."""
    text = str(report.get("unfinished", ""))
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def limits(report: Report) -> str:
    """Nominal numbers that sit at the end of what their tolerances allow: whatever the verdict, a user must know."""
    rows = [row for row in report["calibration"] if row["at_limit"]]
    if not rows:
        return ""
    names = "; ".join(_number(row) for row in rows[:4])
    more = f"; and {len(rows) - 4} more" if len(rows) > 4 else ""
    return f"At the limit of what its tolerance allows, and perhaps beyond: {names}{more}."


def _left(report: Report) -> float:
    return float(report["remainder"]["share"])


def _number(row: dict[str, Any]) -> str:
    """One nominal number that moved, in words."""
    name = f"{row['name']} of {row['site']}" if row["site"] else row["name"]
    unit = "" if row["unit"] in ("", "1") else f" {row['unit']}"
    return f"{name.replace('_', ' ')} {number(row['value'])}{unit} instead of {number(row['nominal'])}"


def amount(value: float | None, unit: str) -> str:
    """A value with its unit; angles and lengths in thousandths where they are small."""
    if value is None or value != value:
        return "broke down"
    small = unit in ("rad", "m", "rad/s", "m/s") and abs(value) < 0.1
    text = f"{1e3 * value:.3g} m{unit}" if small else f"{value:.3g} {unit}"
    return text.removesuffix(" 1")


def plain(key: str) -> str:
    """name@site in words."""
    return ", ".join(_part(part) for part in key.split(" + "))


def _part(part: str) -> str:
    if "@" not in part:
        return part
    name, site = part.split("@", 1)
    return f"{name.replace('_', ' ')} {'everywhere' if site == 'all' else 'at ' + site.replace('_', ' ')}"


def meaning(name: str) -> str:
    """What an effect is, the first paragraph of its own description; empty for a user's effect."""
    found = effect_classes().get(name)
    return " ".join((inspect.getdoc(found) or "").split("\n\n")[0].split()).replace("`", "") if found else ""


def percent(share: float) -> str:
    """A share as a percentage."""
    return f"{100 * share:.0f} %" if abs(share) < 0.985 or abs(share) > 0.9995 else f"{100 * share:.1f} %"


def number(value: float) -> str:
    """Three digits."""
    return f"{value:.3g}"
