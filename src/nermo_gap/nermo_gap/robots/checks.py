"""What to do about a diagnosis of the mouse: a check by hand for each cause, and the commands to type next."""

from __future__ import annotations

import math
import re
from typing import Any

from nermo_gap.robots.sites import by_site

Report = dict[str, Any]
Values = dict[str, float]

CHECKS = {
    "servo_gain": "swap the servo of the {where} with its neighbour and record again: if the {share} move "
    "along, replace the servo; if not, look at its cable and plug",
    "servo_torque_limit": "hang a weight on the {where} until it yields: it should hold {torque}",
    "servo_delay": "compare the stamps of command and answer at the {where}: they should lie {time} apart; look at the "
    "bus and its baud rate",
    "link_latency": "compare the stamps of command and answer: all servos act {time} late; look at the link",
    "servo_offset": "command the {where} to neutral and hold a set square to it: it stands {angle} off; put the horn "
    "back on its shaft",
    "servo_rate_limit": "measure the supply under load: the {where} is slower than its data sheet says",
    "servo_dead_band": "command the {where} in steps of a degree, and see from which on it follows",
    "servo_backlash": "hold the horn of the {where} and turn it to and fro by hand: feel for {angle} of play",
    "joint_elasticity": "hold the horn of the {where} with its servo on and press: it gives and springs back; tighten "
    "its screws, look for cracks",
    "thermal_drift": "feel the servos of the {where}; let them cool for ten minutes and record again: a gap that "
    "is back only after a while is heat; look for what they work against all the time",
    "torque_ripple": "without power, turn the {where} slowly by hand: feel for steps; look at the teeth of its gear",
    "soft_mount": "press the stand of the {where} by hand: it gives; clamp it tighter, or put it on something stiffer",
    "coulomb_friction": "without power, turn the {where} by hand: it sticks; free its cable guide",
    "viscous_friction": "without power, swing the {where} by hand: it is damped; look at its grease",
    "joint_stiffness": "bend the {where} with a spring scale: it should be {share} {softer} than its drawing says; "
    "look for cracks, check the material",
    "joint_rest_angle": "take the load off the {where}: it rests {angle} from where it should; look for a bent joint",
    "joint_damping": "pluck the {where} and count how often it swings: its damping is not as modelled",
    "joint_range": "turn the {where} by hand to both ends: something is in the way, or a stop is gone",
    "tendon_slack": "{tighten} the {where} cable by {length}",
    "tendon_friction": "pull the {where} cable through its guide by hand: it rubs",
    "tendon_detached": "look at both ends of the {where} cable: one has come off",
    "mass": "weigh the {where}: it should be {mass} {heavier} than modelled",
    "com_shift": "weigh front against rear, and left against right: the mass of the {where} sits {shift}; look for a "
    "battery that has moved",
    "inertia": "look how the parts in the {where} are spread: its inertia is {share} off",
    "ground_friction": "{clean} the {where}; the friction is {share} off",
    "foot_compliance": "press the {where} against a table: the sole is not as hard as modelled",
    "ground_slope": "put a spirit level on the floor",
    "gravity_lean": "put a spirit level on the floor, and see that the tracker's z points up",
    "sensor_bias": "calibrate the zero of the {where}",
    "sensor_scale": "calibrate the scale of the {where}",
}
"""By the effect's name: what to check by hand. In braces: where it sits, and how much was found, in words."""
UNKNOWN = "look at the {where} for {effect}"


def check(effect: str, site: str, values: Values | None = None) -> str:
    """The check that fits a cause; ``values`` as the diagnosis found them, or None of a rival's, which nobody knows."""
    text = CHECKS.get(effect, UNKNOWN).format(
        where=_PLACES.get(site, site.removeprefix("all_")).replace("_", " "),
        effect=effect.replace("_", " "),
        **_amounts(values or {}),
    )
    return text if values else re.split("[:;]", text)[0].removesuffix(f" by {_SOME}")


_PLACES = {"all": "mouse"} | {f"spine_{end}": f"{end} spine" for end in ("left", "right", "lumbar")}
_SOME = "?"


def _amounts(values: Values) -> dict[str, str]:
    """How much, in the words of `CHECKS`; a question mark where a value is not known."""

    def told(names: tuple[str, ...], scale: float, unit: str) -> str:
        value = next((abs(values[n]) for n in names if n in values), None)
        return _SOME if value is None else f"{scale * value:.3g} {unit}"

    factor = next((v for n, v in values.items() if n.endswith("factor")), None)
    less = factor is not None and factor < 1.0
    words = {"x": ("forward", "back"), "y": ("left", "right"), "z": ("up", "down")}
    shifts = [f"{1e3 * abs(v):.0f} mm {words[n][v < 0.0]}" for n, v in values.items() if n in words and abs(v) > 5e-4]
    return {
        "share": _SOME if factor is None else f"{100.0 * abs(factor - 1.0):.0f} %",
        "softer": "softer" if less else "stiffer",
        "clean": "clean" if less or factor is None else "look for glue on",
        "angle": told(("offset", "shift", "width"), math.degrees(1.0), "degrees"),
        "time": told(("delay", "latency"), 1e3, "ms"),
        "torque": told(("limit",), 1e3, "mN m"),
        "length": told(("slack",), 1e3, "mm"),
        "mass": told(("change",), 1e3, "g"),
        "tighten": "loosen" if values.get("slack", 0.0) < 0.0 else "tighten",
        "heavier": "lighter" if values.get("change", 0.0) < 0.0 else "heavier",
        "shift": " and ".join(shifts) or _SOME,
    }


def what_to_do(report: Report, folder: str, recordings: list[str]) -> dict[str, Any]:
    """``what_to_do`` of a report: {checks: rows of cause, where, check and how sure; commands: what to type next}.

    ``folder``: where diagnosis.json will be.
    """
    rows = []
    for effect in report["effects"]:
        key = f"{effect['name']}@{effect['site']}"
        rows += [_row(report, str(effect["name"]), site, values, key) for site, values in by_site(effect)]
    named = {(row["effect"], row["site"]) for row in rows} | {(e["name"], e["site"]) for e in report["effects"]}
    for group in report["equivalent"]:
        for key in group:
            name, _, site = str(key).split(" ")[0].partition("@")
            if " + " not in key and site and (name, site) not in named:
                named.add((name, site))
                rows.append(_row(report, name, site, None, f"{name}@{site}"))
    return {"checks": rows, "commands": _commands(report, folder, recordings)}


def _row(report: Report, name: str, site: str, values: Values | None, key: str) -> dict[str, Any]:
    sure = sum(float(p) for causes, p in report["probabilities"].items() if key in causes.split(" + "))
    return {"effect": name, "site": site, "check": check(name, site, values), "probability": sure or None}


def _commands(report: Report, folder: str, recordings: list[str]) -> list[str]:
    told = " ".join(recordings)
    if report["verdict"] in ("no_gap", "calibration"):
        return [f"nermo gap diagnose NEW_RECORDINGS --reference {told}"]
    again = f"nermo gap diagnose NEW_RECORDINGS --robot {report.get('robot_file', report['robot'])}"
    if report["verdict"] == "effect":
        return [
            f"nermo gap predict {folder}/diagnosis.json --quick",
            f"nermo gap apply {folder}/diagnosis.json --out my_robot.yaml",
            again,
        ]
    together = f"nermo gap diagnose {told} NEW_RECORDINGS"
    if report.get("next_experiment"):
        return ["nermo up --record NEW_RECORDINGS", f"nermo play {folder}/next_experiment.yaml", together]
    return [again, together]
