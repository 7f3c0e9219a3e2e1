"""Finding and opening the port that leads to the robot."""

from __future__ import annotations

import contextlib
import errno
import re
from typing import Any

import serial
from serial.tools import list_ports

from nermo_hw.types import LineError

_USB = re.compile(r"usb:([0-9a-fA-F]{4}):([0-9a-fA-F]{4})(?::(.+))?")


def find_port(name: str) -> str:
    """What pyserial opens for a name: a device path, a URL such as `socket://host:port`, or a USB id.

    name: `/dev/ttyUSB0`, `COM3`, any URL of pyserial, or `usb:VID:PID[:SERIAL]` in hexadecimal, as in `usb:0403:6010`.

    Raises LineError for a malformed USB id, or one that is not plugged in or is so more than once.
    """
    if not name.startswith("usb:"):
        return name
    match = _USB.fullmatch(name)
    if match is None:
        raise LineError(f"port {name!r}: a USB id is usb:VID:PID or usb:VID:PID:SERIAL, as in usb:0403:6010")
    vendor, product, number = int(match[1], 16), int(match[2], 16), match[3]
    there = [
        port.device
        for port in list_ports.comports()
        if (port.vid, port.pid) == (vendor, product) and number in (None, port.serial_number)
    ]
    if len(there) == 1:
        return str(there[0])
    if not there:
        raise LineError(f"port {name}: nothing with this USB id is plugged in")
    raise LineError(f"port {name}: this USB id is there {len(there)} times ({', '.join(there)}); add the serial number")


def open_port(name: str, timeout: float, baud: int) -> Any:
    """A port, opened for nobody else, with nothing waiting in it.

    timeout: of one read [s]. baud: [bit/s], where the port has such a thing.

    Raises LineError, which says why.
    """
    path = find_port(name)
    try:
        options = {} if "://" in path else {"exclusive": True}
        port = serial.serial_for_url(path, baudrate=baud, timeout=timeout, write_timeout=1.0, **options)
    except (OSError, ValueError) as error:  # SerialException is an OSError
        if getattr(error, "errno", None) == errno.ENOENT:
            raise LineError(f"port {name} is not there (yet)") from error
        raise LineError(f"port {name} cannot be opened: {_reason(error)}") from error
    with contextlib.suppress(OSError, ValueError, AttributeError, NotImplementedError):
        port.set_low_latency_mode(True)  # USB adapters hold data back for 16 ms otherwise; a pseudo-terminal has none
    with contextlib.suppress(OSError):
        port.reset_input_buffer()
    return port


def _reason(error: Exception) -> str:
    cause = getattr(error, "strerror", None) or str(error)
    return " ".join(str(cause).split())
