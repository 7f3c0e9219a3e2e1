"""The tables of docs/sbcp.md, made from the code: `python -m nermo_hw.sbcp.data_sheet` prints them."""

from __future__ import annotations

from collections.abc import Iterable

from nermo_hw.sbcp import boards, pwm_board
from nermo_hw.sbcp.boards import SERVO_BOARDS
from nermo_hw.sbcp.packet import DeviceClass, Instruction, Status
from nermo_hw.sbcp.register_tables import REGISTERS, STANDARD
from nermo_hw.sbcp.registers import Kind, Register
from nermo_hw.types import Fault


def tables() -> dict[str, str]:
    """Markdown of each table by its title."""
    own = {
        device: [register for register in registers if register not in STANDARD]
        for device, registers in REGISTERS.items()
    }
    result = {
        "Classes": _table(("class", "device"), [(f"0x{c:02X}", _words(c.name)) for c in DeviceClass]),
        "Instructions": _table(("code", "instruction"), [(f"0x{i:02X}", i.name) for i in Instruction]),
        "Statuses": _table(("code", "status"), [(f"0x{s:02X}", s.name) for s in Status]),
        "Faults": _table(("bit", "fault"), [(f"0x{f.value:02X}", str(f.name)) for f in Fault]),
        "Servo boards": _table(
            ("ID", *(f"channel {number}" for number in range(boards.CHANNELS)), "leg"),
            [
                (str(number), *(name or "-" for name in names), boards.LEG_OF_BOARD[number])
                for number, names in SERVO_BOARDS.items()
            ],
        ),
        "PWM board": _table(
            ("channel", "servo"), [(str(channel), name) for channel, name in enumerate(pwm_board.SERVOS)]
        ),
        "States of a PWM board": _table(("state", ""), [(str(s.value), s.name) for s in pwm_board.State]),
        "Standard registers": _registers(STANDARD),
        **{f"Registers of a {_words(DeviceClass(device).name)}": _registers(own[device]) for device in own},
    }
    return result


def _registers(registers: tuple[Register, ...] | list[Register]) -> str:
    rows = []
    for r in registers:
        upper = r.kind.largest if r.upper is None else r.upper
        written = "" if r.access.value == "read only" or r.kind is Kind.TEXT else f"{r.lower} to {upper}"
        rows.append(
            (f"0x{r.address:02X}", r.name, r.kind.name, r.access.value, str(r.default), written, r.unit, r.description)
        )
    return _table(("address", "name", "type", "access", "default", "range", "unit", "meaning"), rows)


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _words(name: str) -> str:
    return name.lower().replace("_", " ")


if __name__ == "__main__":
    for title, text in tables().items():
        print(f"### {title}\n\n{text}\n")
