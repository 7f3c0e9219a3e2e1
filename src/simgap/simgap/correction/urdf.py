"""What a URDF has words for, written into one: friction, damping and stops of joints, masses of links."""

from __future__ import annotations

import xml.parsers.expat
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simgap.correction.changes import Change, Correction
from simgap.correction.text import Edit, Element, elements_of, number_text, rewritten
from simgap.data.errors import GapInputError, nearest

Array = NDArray[np.float64]

_DYNAMICS = {"damping": "damping", "frictionloss": "friction"}
"""Attribute of an MJCF joint -> of a URDF's `dynamics`."""
_AXES = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_AT = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


@dataclass(frozen=True)
class WrittenUrdf:
    """What became of a correction: changes that stand in the URDF, and what does not, each with its number and why."""

    written: tuple[Change, ...]
    notes: tuple[str, ...]


@dataclass
class _Draft:
    text: bytes
    edits: dict[int, Edit] = field(default_factory=dict)

    def edit(self, element: Element) -> Edit:
        return self.edits.setdefault(element.start, Edit())

    def set(self, parent: Element, tag: str, attributes: dict[str, str]) -> None:
        """Attributes of a child, which is made where there is none."""
        child = parent.children.get(tag)
        if child is not None:
            self.edit(child).attributes |= attributes
            return
        words = "".join(f' {k}="{v}"' for k, v in attributes.items())
        edit, line = self.edit(parent), self.text.rfind(b"\n", 0, parent.start) + 1
        before = self.text[line : parent.start].decode()
        indent = before if not before.strip() else ""
        if f"<{tag} " in edit.behind:
            edit.behind = edit.behind.replace(f"<{tag} ", f"<{tag}{words} ")
        else:
            edit.behind += f"\n{indent}  <{tag}{words} />"


def write_urdf(urdf: Path, found: Correction, out: Path) -> WrittenUrdf:
    """Write the URDF with what of the correction it has words for; joints and links go by their names in the model.

    Its comments and layout stay. A link is changed only where mass, centre of mass and moments are those that the
    diagnosis began from, since a model may hold several links as one body, or in other frames.

    Raises:
        GapInputError: the URDF cannot be read, holds none of the joints and bodies, or ``out`` cannot be written.
    """
    try:
        draft = _Draft(urdf.read_bytes())
        elements = elements_of(draft.text)
    except OSError as error:
        raise GapInputError(f"{urdf}: cannot be read ({error.strerror})") from error
    except xml.parsers.expat.ExpatError as error:
        raise GapInputError(f"{urdf}: is not XML ({error})") from error
    if elements[0].tag != "robot":
        raise GapInputError(f"{urdf}: {elements[0].tag}: a URDF begins with robot; for an MJCF use --model")
    if any(e.tag.startswith("xacro:") for e in elements):
        raise GapInputError(f"{urdf}: is a xacro file; expand it first: xacro {urdf} -o robot.urdf")
    named = {
        kind: {e.attributes.get("name", ""): e for e in elements if e.path == ("robot",) and e.tag == kind}
        for kind in ("joint", "link")
    }
    _check_names(urdf, found.changes, named)
    written, notes = [], []
    for change in found.changes:
        why = _put(draft, change, found.changes, named)
        if why:
            notes.append(f"{change.sentence} ({why})")
        else:
            written.append(change)
    notes += [f"{signal.sentence} (no URDF has words for it)" for signal in found.signals]
    text: bytes | None = draft.text
    for start in sorted(draft.edits, reverse=True):
        text = rewritten(text, start, draft.edits[start]) if text is not None else None
    if text is None:
        raise GapInputError(f"{urdf}: an element that has to change holds nothing (<joint .../>); give it its children")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_bytes(text)
    except OSError as error:
        raise GapInputError(f"{out}: cannot be written ({error.strerror})") from error
    return WrittenUrdf(tuple(written), tuple(notes))


def _check_names(urdf: Path, changes: Sequence[Change], named: dict[str, dict[str, Element]]) -> None:
    """Whether the URDF is of this robot at all."""
    asked = [(c, named["joint" if c.element == "joint" else "link"]) for c in changes if c.element in ("joint", "body")]
    if asked and not any(c.name in names for c, names in asked):
        change, names = asked[0]
        kind = "joint" if change.element == "joint" else "link"
        raise GapInputError(f"{urdf}: has no {kind} {change.name!r}; {nearest(change.name, names, kind)}")


def _put(draft: _Draft, change: Change, changes: Sequence[Change], named: dict[str, dict[str, Element]]) -> str:
    """Enter a change; returns why that is not possible, or nothing."""
    if change.element == "joint" and change.attribute in (*_DYNAMICS, "range"):
        joint = named["joint"].get(change.name)
        if joint is None:
            return "the URDF has no such joint"
        if change.attribute == "range":
            return _put_range(draft, joint, change)
        draft.set(joint, "dynamics", {_DYNAMICS[change.attribute]: number_text(change.value)})
        return ""
    if change.element == "body" and change.attribute in ("mass", "ipos", "inertia"):
        link = named["link"].get(change.name)
        if link is None or "inertial" not in link.children:
            return "the URDF has no such link with an inertial"
        return _put_inertial(draft, link.children["inertial"], change, changes)
    return "no URDF has words for it"


def _put_range(draft: _Draft, joint: Element, change: Change) -> str:
    if joint.attributes.get("type") not in ("revolute", "prismatic") or "limit" not in joint.children:
        return f"a joint of type {joint.attributes.get('type')} has no limits in a URDF"
    low, high = change.value
    draft.set(joint, "limit", {"lower": number_text([low]), "upper": number_text([high])})
    return ""


def _put_inertial(draft: _Draft, inertial: Element, change: Change, changes: Sequence[Change]) -> str:
    mass = float(inertial.children["mass"].attributes["value"])
    origin = inertial.children["origin"].attributes if "origin" in inertial.children else {}
    place = np.array([float(v) for v in origin.get("xyz", "0 0 0").split()])
    moments = inertial.children["inertia"].attributes
    tensor = np.zeros((3, 3))
    for name, (i, j) in zip(_AXES, _AT, strict=True):
        tensor[i, j] = tensor[j, i] = float(moments.get(name, 0.0))
    values, axes = np.linalg.eigh(tensor)
    for other in changes:
        if (other.element, other.index) != (change.element, change.index):
            continue
        began = np.array(other.nominal)
        same = {"mass": np.array([mass]), "ipos": place, "inertia": values}.get(other.attribute)
        compared = np.sort(began) if other.attribute == "inertia" else began
        if same is not None and not np.allclose(same, compared, rtol=1e-3, atol=1e-6 if len(began) == 3 else 0.0):
            return f"the URDF's link has another {_word(other.attribute)}: {number_text(same.tolist())}"
    if change.attribute == "mass":
        draft.edit(inertial.children["mass"]).attributes["value"] = number_text(change.value)
    elif change.attribute == "ipos":
        draft.set(inertial, "origin", {"xyz": number_text(change.value)})
    else:
        # About the same axes, in the order of size on both sides.
        order = np.argsort(change.nominal)
        new = axes @ np.diag(np.array(change.value)[order]) @ axes.T
        draft.edit(inertial.children["inertia"]).attributes |= {
            name: number_text([float(new[i, j])]) for name, (i, j) in zip(_AXES, _AT, strict=True)
        }
    return ""


def _word(attribute: str) -> str:
    return {"ipos": "centre of mass [m]", "inertia": "moments [kg m^2]", "mass": "mass [kg]"}[attribute]
