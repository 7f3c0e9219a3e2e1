"""The answer beside a recording, so that nobody reads it by chance, and whether a diagnosis agrees with it."""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nermo_gap.blind.mice.faults import UNKNOWN, Fault
from nermo_gap.blind.mice.places import part, parts_at, sites_of
from simgap.data.errors import GapInputError

SEALED = "answer.sealed"


@dataclass(frozen=True)
class Answer:
    """What is wrong with a hidden mouse; see `Fault`."""

    robot: str
    number: int
    kind: str
    parts: tuple[str, ...]
    says: str
    value: float
    unit: str

    @classmethod
    def of(cls, robot: str, number: int, fault: Fault) -> Answer:
        """That of a mouse."""
        return cls(robot, number, fault.kind, fault.parts, fault.says, fault.value, fault.unit)

    def sentence(self) -> str:
        """In words."""
        if self.kind == "none":
            return "nothing was wrong with this mouse"
        if not self.says:
            return f"{self.kind.replace('_', ' ')} at {', '.join(self.parts)}, for which the library has no word"
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.kind.replace('_', ' ')}: {self.says} {self.value:.3g}{unit} at {', '.join(self.parts)}"


def seal(answer: Answer, folder: Path) -> str:
    """Write the answer where no eye reads it by chance; returns the seal, a digest that `open_seal` checks."""
    plain = json.dumps(vars(answer)).encode()
    digest = hashlib.sha256(plain).hexdigest()
    text = {"seal": digest, "answer": base64.b64encode(zlib.compress(plain)).decode()}
    (folder / SEALED).write_text(json.dumps(text, indent=2) + "\n", encoding="utf-8")
    return digest[:12]


def open_seal(folder: Path) -> Answer:
    """The answer beside a recording.

    Raises:
        GapInputError: there is none, or it was changed.
    """
    path = folder / SEALED
    try:
        text = json.loads(path.read_text(encoding="utf-8"))
        plain = zlib.decompress(base64.b64decode(text["answer"]))
        data = json.loads(plain)
        answer = Answer(**(data | {"parts": tuple(data["parts"])}))
    except OSError as error:
        raise GapInputError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, KeyError, TypeError, zlib.error) as error:
        raise GapInputError(f"{path}: is no sealed answer") from error
    if hashlib.sha256(plain).hexdigest() != text["seal"]:
        raise GapInputError(f"{path}: the seal is broken; record the mouse anew")
    return answer


def judge(answer: Answer, report: dict[str, Any]) -> str:
    """How a diagnosis did: `right`, `right part`, `near`, `false alarm`, `missed` or `wrong`.

    Right is the fault's own effect at all of its parts and no other, or nothing where nothing is wrong. The right part
    is another effect at the same parts; near is one that shares some of them, or that is not the only one named. Of
    what the library has no word for, it is right to say so.
    """
    found = [(str(e["name"]), str(e["site"])) for e in report["effects"]]
    if answer.kind in UNKNOWN:
        nothing = report["verdict"] in ("no_gap", "calibration")
        said = report["verdict"] == "unknown" or (report["verdict"] == "partial" and not found)
        return "right" if said else "missed" if nothing else "wrong"
    if answer.kind == "none":
        return "false alarm" if report["verdict"] in ("effect", "ambiguous", "partial") and found else "right"
    if not found or report["verdict"] in ("no_gap", "calibration"):
        return "missed"
    if len(found) == 1 and found[0][1] in sites_of(answer.robot, answer.parts):
        return "right" if found[0][0] == answer.says and report["verdict"] == "effect" else "right part"
    truth = {part(name) for name in answer.parts}
    return "near" if any(parts_at(answer.robot, site) & truth for _, site in found) else "wrong"
