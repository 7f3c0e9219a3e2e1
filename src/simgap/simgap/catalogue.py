"""The library of effects as a list to read: what each is, where it acts, and its numbers."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np

from simgap.blind.robots import MAPS, MODELS
from simgap.data.mapping import parse_map
from simgap.data.plant import Plant, build_plant
from simgap.effects.base import Context, Effect
from simgap.effects.library import effect_classes
from simgap.simulation.scales import Scales

_SITES = {
    "servo": "an actuator",
    "link": "all commands",
    "friction": "a joint",
    "tendon": "a tendon",
    "joint": "a joint",
    "mount": "the body by which a robot stands fixed",
    "body": "a body",
    "contact": "a geom, or the world",
    "sensor": "an output of the map",
}
"""Module of an effect -> where it acts."""


@dataclass(frozen=True)
class Entry:
    """One effect: its name, its site, a sentence, and its parameters with units."""

    name: str
    site: str
    sentence: str
    parameters: str


def catalogue() -> list[Entry]:
    """All effects by name."""
    found: dict[str, list[Effect]] = {}
    for context in _contexts():
        for name, kind in effect_classes().items():
            found.setdefault(name, []).extend(kind.candidates(context))
    entries = []
    for name, kind in sorted(effect_classes().items()):
        sentence = " ".join((inspect.getdoc(kind) or "").split("\n\n")[0].split()).replace("`", "")
        site = _SITES[kind.__module__.split(".")[-1]]
        entries.append(Entry(name, site, sentence, _parameters(found.get(name, []))))
    return entries


def as_markdown() -> str:
    """All effects as a page of the documentation."""
    rows = [f"| `{e.name}` | {e.site} | {e.sentence} | {e.parameters} |" for e in catalogue()]
    head = [
        "# All effects",
        "",
        "What a diagnosis can name, as `simgap effects` lists it. An effect of your own is a class in a Python file,",
        "for `--effects` ([how](../gap.md)). This page is written by `simgap effects --markdown`.",
        "",
        "| effect | acts at | what it is | parameters and units |",
        "|---|---|---|---|",
    ]
    return "\n".join([*head, *rows]) + "\n"


def _parameters(effects: list[Effect]) -> str:
    """Names with all units that they have, by form where an effect has several."""
    units: dict[tuple[str, str], dict[str, None]] = {}
    # In a group of few joints every joint has a value of its own, named after it.
    single = [effect for effect in effects if len(effect.site.targets) < 2]
    for effect in single or effects:
        for p in effect.parameters:
            units.setdefault((effect.form, p.name), {})[p.unit] = None
    by_form: dict[str, list[str]] = {}
    for (form, name), of in units.items():
        by_form.setdefault(form, []).append(f"{name} [{', '.join(u for u in of if u) or '1'}]")
    return "; ".join((f"{form}: " if form else "") + ", ".join(names) for form, names in by_form.items())


def _contexts() -> Iterator[Context]:
    """Small robots that between them have a place for every effect, moved by about one of everything."""
    for name, xml in MODELS.items():
        plant = build_plant(mujoco.MjSpec.from_string(xml), parse_map(dict(MAPS[name])))
        # Of several servos, the first has a thermometer.
        yield Context(plant, _ones(plant), {}, True, True, frozenset([0] if plant.model.nu > 1 else []))
    model = """<mujoco><worldbody><geom name="floor" type="plane" size="1 1 .1"/>
      <body name="trunk" pos="0 0 .3"><freejoint/><geom name="foot_left" size=".05" pos="0 .1 -.2"/>
      <geom name="foot_right" size=".05" pos="0 -.1 -.2"/><site name="imu"/>
      <body name="tail"><joint name="tail" axis="0 1 0" stiffness="1" damping=".1"/><geom size=".02" pos=".1 0 0"/>
      </body></body></worldbody><actuator><position name="tail_servo" joint="tail" kp="5"/></actuator>
      <sensor><gyro name="gyro" site="imu"/></sensor></mujoco>"""
    mapping: dict[str, object] = {
        "time": {"column": "t", "unit": "s"},
        "inputs": [{"column": "u", "unit": "rad", "actuator": "tail_servo", "kind": "position"}],
        "outputs": [{"column": a, "unit": "rad/s", "sensor": "gyro", "component": a} for a in "xyz"],
    }
    plant = build_plant(mujoco.MjSpec.from_string(model), parse_map(mapping))
    yield Context(plant, _ones(plant), switched=True, swaying=True)


def _ones(plant: Plant) -> Scales:
    model, ni, no = plant.model, len(plant.inputs), len(plant.outputs)
    dof, levels = np.ones(model.nv), np.array([0.6, 0.8, 1.0])
    return Scales(
        torque=dof,
        speed=dof,
        inertia=dof,
        low=-dof,
        high=dof,
        force=np.tile(levels, (model.nu, 1)),
        tendon_force=np.ones(model.ntendon),
        input_rms=np.ones(ni),
        input_rate=np.tile(levels, (ni, 1)),
        input_update=np.full(ni, 0.01),
        output_rms=np.ones(no),
        output_extreme=np.ones(no),
    )
