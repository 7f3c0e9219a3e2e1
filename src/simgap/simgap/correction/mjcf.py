"""Changes written into an MJCF: in its own text where every element is found there, else as MuJoCo writes the model."""

from __future__ import annotations

import xml.parsers.expat
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from simgap.correction.changes import ATTRIBUTES, OBJECTS, Change, differences
from simgap.correction.text import Edit, Element, elements_of, number_text, rewritten
from simgap.data.channels import model_names
from simgap.data.errors import GapInputError
from simgap.data.plant import load_model, load_spec

_ANGLES = ("range", "springref")
_SPEC_NAMES = {"solreffriction": "solref_friction", "solimpfriction": "solimp_friction", "solreflimit": "solref_limit"}
"""MJCF attribute -> attribute of MjSpec where they differ."""
_INERTIAL = ("mass", "ipos", "inertia")


@dataclass(frozen=True)
class Written:
    """What became of the changes: whether the file keeps the text of the model, and which did not get into it."""

    kept_text: bool
    left_out: tuple[Change, ...]


def write_mjcf(model: Path, changes: Sequence[Change], out: Path) -> Written:
    """Write the model with the changes; the file is read back and compared.

    Raises:
        GapInputError: the model cannot be read, is not the one that the changes began from, or ``out`` cannot be
            written or read back.
    """
    nominal = load_model(model)
    _check_start(nominal, changes, model)
    left: tuple[Change, ...] = tuple(changes)
    kept_text = False
    for write in (_write_text, _write_spec):
        if not write(model, nominal, changes, out):
            continue
        if moved := _moved(nominal, load_model(out), changes):
            write(model, nominal, [*changes, *moved], out)
        left, kept_text = _missing(load_model(out), changes), write is _write_text
        if not left:
            break
    return Written(kept_text, left)


def _moved(nominal: mujoco.MjModel, new: mujoco.MjModel, changes: Sequence[Change]) -> list[Change]:
    """What moved along with the changes, to be held where it was: the compiler works some numbers out from others, as
    the rest length of a tendon from those of its joints.
    """
    known = {c.place for c in changes}
    return [
        replace(c, value=c.nominal)
        for c in differences(nominal, new)
        if c.place not in known and not np.allclose(c.nominal, c.value, rtol=2e-5, atol=1e-9)
    ]


def _write_text(model: Path, nominal: mujoco.MjModel, changes: Sequence[Change], out: Path) -> bool:
    """Write the model's own text with the changes, where it holds every element by name."""
    text = _edited(model, nominal, changes)
    if text is not None:
        _write(out, text)
    return text is not None


def _write_spec(model: Path, nominal: mujoco.MjModel, changes: Sequence[Change], out: Path) -> bool:
    """Write the model as MuJoCo does."""
    spec = load_spec(model)
    spec.compile()
    for change in changes:
        _set_in_spec(spec, nominal, change)
    try:
        spec.compile()
    except ValueError as error:
        raise GapInputError(f"{out}: MuJoCo refuses the corrected model ({' '.join(str(error).split())})") from error
    _write(out, spec.to_xml().encode())
    return True


def _write(out: Path, text: bytes) -> None:
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_bytes(text)
    except OSError as error:
        raise GapInputError(f"{out}: cannot be written ({error.strerror})") from error


def _check_start(model: mujoco.MjModel, changes: Sequence[Change], path: Path) -> None:
    """Whether the changes began from this model."""
    for change in changes:
        found = _value(model, change)
        if found is None:
            raise GapInputError(f"{path}: has no {change.element} {change.name!r}; is it the model that was diagnosed?")
        limited = change.attribute != "forcerange" or model.actuator_forcelimited[change.index]
        if limited and not np.allclose(found, change.nominal, rtol=1e-3, atol=1e-9):
            raise GapInputError(
                f"{path}: {change.attribute} of {change.element} {change.name!r} is {number_text(found)}, and the "
                f"diagnosis began from {number_text(change.nominal)}; is it the model that was diagnosed?"
            )


def _value(model: mujoco.MjModel, change: Change) -> tuple[float, ...] | None:
    """The numbers of the attribute in a model, or None where it has no such element."""
    if change.element == "option":
        values = np.atleast_1d(getattr(model.opt, change.attribute))
    else:
        names = model_names(model, OBJECTS[change.element])
        if change.index >= len(names) or names[change.index] != change.name:
            return None
        attribute = next(a for a in ATTRIBUTES if (a.element, a.name) == (change.element, change.attribute))
        row = attribute.row(model, change.index)
        if row is None:
            return None
        values = np.atleast_1d(getattr(model, attribute.field)[row])
    return tuple(float(v) for v in values[: len(change.nominal)])


def _missing(model: mujoco.MjModel, changes: Sequence[Change]) -> tuple[Change, ...]:
    """Changes that a model does not have."""
    return tuple(
        c
        for c in changes
        if (found := _value(model, c)) is None or not np.allclose(found, c.value, rtol=2e-5, atol=1e-9)
    )


# --- The text of the model


def _find(elements: Sequence[Element], change: Change) -> Element | None:
    """The one element that a change is about, or None where the text holds none or several."""
    above = {"tendon": "tendon", "actuator": "actuator"}.get(change.element, "worldbody")
    tags = {"tendon": ("spatial", "fixed"), "actuator": None}.get(change.element, (change.element,))
    found = [
        e
        for e in elements
        if above in e.path and (tags is None or e.tag in tags) and e.attributes.get("name") == change.name
    ]
    return found[0] if len(found) == 1 else None


def _edited(path: Path, nominal: mujoco.MjModel, changes: Sequence[Change]) -> bytes | None:
    """The model's text with the changes, or None where it does not hold every element by name."""
    text = path.read_bytes()
    try:
        elements = elements_of(text)
    except xml.parsers.expat.ExpatError:
        return None
    root = elements[0]
    if root.tag != "mujoco" or any(e.tag in ("include", "attach", "replicate") for e in elements):
        return None
    degrees = bool(load_spec(path).compiler.degree)
    edits: dict[int, Edit] = {}
    for change in changes:
        if change.element == "option":
            element = next((e for e in elements if e.tag == "option" and len(e.path) == 1), None)
            where = root if element is None else element
            edit = edits.setdefault(where.start, Edit())
            if element is None:
                edit.behind += f'\n  <option {change.attribute}="{number_text(change.value)}"/>'
            else:
                edit.attributes[change.attribute] = number_text(change.value)
            continue
        element = _find(elements, change)
        if element is None:
            return None
        if change.attribute in _INERTIAL:
            target = element.children.get("inertial", element)
            edit = edits.setdefault(target.start, Edit())
            numbers = _inertial(nominal, change.index, [c for c in changes if _same(c, change)])
            if "inertial" not in element.children:
                edit.behind = "\n<inertial " + " ".join(f'{k}="{v}"' for k, v in numbers.items()) + "/>"
            else:
                edit.attributes |= {**numbers, "fullinertia": None}
            continue
        _edit_element(edits.setdefault(element.start, Edit()), element, change, nominal, changes, degrees)
    for start in sorted(edits, reverse=True):
        changed = rewritten(text, start, edits[start])
        if changed is None:
            return None
        text = changed
    return text


def _same(a: Change, b: Change) -> bool:
    return (a.element, a.index) == (b.element, b.index)


def _inertial(model: mujoco.MjModel, body: int, changes: Sequence[Change]) -> dict[str, str]:
    """Attributes of an `inertial` that says all of a body's mass and where it lies."""
    new = {c.attribute: c.value for c in changes}
    return {
        "pos": number_text(new.get("ipos", tuple(model.body_ipos[body]))),
        "quat": number_text(tuple(model.body_iquat[body])),
        "mass": number_text(new.get("mass", (float(model.body_mass[body]),))),
        "diaginertia": number_text(new.get("inertia", tuple(model.body_inertia[body]))),
    }


def _edit_element(
    edit: Edit,
    element: Element,
    change: Change,
    nominal: mujoco.MjModel,
    changes: Sequence[Change],
    degrees: bool,
) -> None:
    if change.attribute in ("gainprm", "biasprm"):
        _edit_gains(edit, element, change, nominal, changes)
        return
    values: Sequence[float] = change.value
    if degrees and change.attribute in _ANGLES and change.element == "joint" and change.unit == "rad":
        values = np.degrees(values).tolist()
    if change.attribute in ("priority", "limited"):
        edit.attributes[change.attribute] = str(int(values[0])) if change.attribute == "priority" else _word(values[0])
        return
    edit.attributes[change.attribute] = number_text(values)
    if change.attribute == "range":
        edit.attributes["limited"] = "true"
    if change.attribute == "forcerange":
        edit.attributes["forcelimited"] = "true"
    if change.attribute == "delay":
        # Between two time steps a delay is interpolated; by itself MuJoCo rounds it up to the next one.
        edit.attributes |= {"nsample": str(_samples(nominal, change.value[0])), "interp": "linear"}
    if change.attribute in ("pos", "quat") and "fromto" not in element.attributes:
        for other in ("euler", "axisangle", "xyaxes", "zaxis") if change.attribute == "quat" else ():
            edit.attributes[other] = None


def _samples(model: mujoco.MjModel, delay: float) -> int:
    """Length of the buffer of a delay [s]; long enough for a time step a quarter as long, too."""
    return int(np.ceil(4.0 * delay / model.opt.timestep)) + 2


def _word(value: float) -> str:
    return "true" if value else "false"


def _edit_gains(
    edit: Edit, element: Element, change: Change, nominal: mujoco.MjModel, changes: Sequence[Change]
) -> None:
    """Gains of an actuator: by kp and kv where it is a `position` that still is one, else as a `general`."""
    new = {c.attribute: c.value for c in changes if _same(c, change)}
    gain = new.get("gainprm", tuple(nominal.actuator_gainprm[change.index, :3]))
    bias = new.get("biasprm", tuple(nominal.actuator_biasprm[change.index, :3]))
    plain = gain[1:] == (0.0, 0.0) and bias[0] == 0.0
    if element.tag == "position" and plain and np.isclose(gain[0], -bias[1], rtol=1e-9):
        edit.attributes |= {"kp": number_text(gain[:1]), "kv": number_text([-bias[2]]), "dampratio": None}
    elif element.tag == "velocity" and plain and bias[1] == 0.0 and np.isclose(gain[0], -bias[2], rtol=1e-9):
        edit.attributes |= {"kv": number_text(gain[:1])}
    else:
        edit.tag = "general"
        edit.attributes |= {
            "gaintype": "fixed",
            "gainprm": number_text(gain),
            "kp": None,
            "kv": None,
            "dampratio": None,
        }
        if any(bias):
            edit.attributes |= {"biastype": "affine", "biasprm": number_text(bias)}


# --- MuJoCo's own writing


def _set_in_spec(spec: mujoco.MjSpec, nominal: mujoco.MjModel, change: Change) -> None:
    if change.element == "option":
        value = change.value if len(change.value) > 1 else change.value[0]
        setattr(spec.option, change.attribute, value)
        return
    lists = {
        "joint": spec.joints,
        "tendon": spec.tendons,
        "actuator": spec.actuators,
        "body": spec.bodies,
        "geom": spec.geoms,
    }
    element: Any = next(e for e in lists[change.element] if e.id == change.index)
    values: Any = list(change.value)
    if change.attribute in ("gainprm", "biasprm"):
        getattr(element, change.attribute)[: len(values)] = values
        element.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        if any(nominal.actuator_biasprm[change.index]) or change.attribute == "biasprm":
            element.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        return
    if change.element == "body":
        element.explicitinertial = True
        body = change.index
        if not element.mass:
            element.mass, element.ipos = float(nominal.body_mass[body]), nominal.body_ipos[body]
        element.fullinertia = [np.nan] * 6
        element.iquat = nominal.body_iquat[body]
        if change.attribute != "inertia" and not np.any(element.inertia):
            element.inertia = nominal.body_inertia[body]
    if change.attribute in _ANGLES and change.element == "joint" and change.unit == "rad" and spec.compiler.degree:
        values = np.degrees(values).tolist()
    if change.attribute == "range":
        element.limited = 1
    if change.attribute == "forcerange":
        element.forcelimited = 1
    if change.attribute == "delay":
        element.nsample, element.interp = _samples(nominal, change.value[0]), 1
    name = _SPEC_NAMES.get(change.attribute, change.attribute)
    if change.attribute in ("priority", "limited"):
        values = [int(values[0])]
    current = np.array(getattr(element, name))
    if current.ndim and len(values) < len(current):
        # Damping and stiffness have terms of higher order behind the linear one.
        values = [*values, *current[len(values) :]]
    setattr(element, name, values if current.ndim else values[0])
