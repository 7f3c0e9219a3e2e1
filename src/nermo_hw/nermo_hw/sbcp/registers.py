"""Tables of registers that a master reads and writes (C 5.3.1.3)."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum, StrEnum

from nermo_hw.sbcp.packet import Status

Value = int | str


class Kind(Enum):
    """Type of a register; the value is its layout."""

    U8 = "<B"
    U16 = "<H"
    U32 = "<I"
    TEXT = "<16s"
    """ASCII, filled up with zeros."""

    @property
    def size(self) -> int:
        """[bytes]"""
        return struct.calcsize(self.value)

    @property
    def largest(self) -> int:
        """Largest number."""
        return int(256**self.size - 1)


class Access(StrEnum):
    """What a master may do."""

    READ_ONLY = "read only"
    READ_WRITE = "read, write"
    STORED = "read, write, non-volatile"


class RegisterError(ValueError):
    """An instruction about a register was refused; `status` says why."""

    def __init__(self, status: Status, text: str) -> None:
        super().__init__(text)
        self.status = status


@dataclass(frozen=True, slots=True)
class Register:
    """One row of a table."""

    address: int
    name: str
    kind: Kind
    access: Access
    description: str
    default: Value = 0
    lower: int = 0
    upper: int | None = None
    """Largest number that may be written; None: what the kind holds."""
    unit: str = ""

    def encode(self, value: Value) -> bytes:
        """A value as it goes over the line. Raises struct.error where the kind does not hold it."""
        return struct.pack(self.kind.value, value.encode("ascii") if isinstance(value, str) else value)

    def decode(self, data: bytes) -> Value:
        """Raises RegisterError for a wrong size or text that is not ASCII."""
        if len(data) != self.kind.size:
            raise RegisterError(Status.WRONG_SIZE, f"register {self.name}: {len(data)} bytes, it has {self.kind.size}")
        (raw,) = struct.unpack(self.kind.value, data)
        if not isinstance(raw, bytes):
            return int(raw)
        text = raw.rstrip(b"\0")
        if not all(0x20 <= byte < 0x7F for byte in text):
            raise RegisterError(Status.OUT_OF_RANGE, f"register {self.name} = {text!r}: must be printable ASCII")
        return text.decode("ascii")

    def check(self, value: Value) -> None:
        """Raises RegisterError where the value does not fit."""
        if self.kind is Kind.TEXT:
            fits = isinstance(value, str) and value.isascii() and value.isprintable() and len(value) <= self.kind.size
            allowed = f"printable ASCII of up to {self.kind.size} characters"
        else:
            upper = self.kind.largest if self.upper is None else self.upper
            fits = isinstance(value, int) and self.lower <= value <= upper
            allowed = f"{self.lower} to {upper} {self.unit}".rstrip()
        if not fits:
            raise RegisterError(Status.OUT_OF_RANGE, f"register {self.name} = {value!r}: must be {allowed}")


class RegisterTable:
    """The registers of one device and their values.

    stored: non-volatile values from before, by name; others start with their defaults.
    """

    def __init__(self, registers: Iterable[Register], stored: Mapping[str, Value] | None = None) -> None:
        self._by_address = {register.address: register for register in registers}
        self._by_name = {register.name: register for register in self._by_address.values()}
        self._stored = dict(stored or {})
        self._values: dict[str, Value] = {}
        self.restart()

    def __getitem__(self, name: str) -> Value:
        """Value of a register. Raises KeyError."""
        return self._values[name]

    def __setitem__(self, name: str, value: Value) -> None:
        """Sets a register from the device's side, whatever its access."""
        register = self._by_name[name]
        self._values[name] = value
        if register.access is Access.STORED:
            self._stored[name] = value

    def number(self, name: str) -> int:
        """Value of a register that is no text."""
        return int(self._values[name])

    @property
    def stored(self) -> dict[str, Value]:
        """Non-volatile values that were written."""
        return dict(self._stored)

    def restart(self) -> None:
        """As after a power reset: everything but the non-volatile values is as by default."""
        self._values = {name: self._stored.get(name, r.default) for name, r in self._by_name.items()}

    def get(self, address: int) -> bytes:
        """Answer to GET. Raises RegisterError for an unknown address."""
        register = self._find(address)
        return register.encode(self._values[register.name])

    def set(self, address: int, data: bytes) -> Register:
        """What SET does; returns the register. Raises RegisterError, and then nothing has changed."""
        register = self._find(address)
        if register.access is Access.READ_ONLY:
            raise RegisterError(Status.READ_ONLY, f"register {register.name} is read only")
        value = register.decode(data)
        register.check(value)
        self[register.name] = value
        return register

    def _find(self, address: int) -> Register:
        if address not in self._by_address:
            raise RegisterError(Status.UNKNOWN_REGISTER, f"there is no register 0x{address:02X}")
        return self._by_address[address]
