"""The device in real time: on a pseudo-terminal or a TCP port, with a socket on which it can be broken on purpose."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import pty
import select
import socket
import time
import tty
from collections.abc import Callable
from pathlib import Path
from typing import Any

from nermo_description.parameter_files import write_yaml
from nermo_hw.device.device import Device
from nermo_hw.device.fault_injection import FaultError
from nermo_hw.types import LineError

IDLE_NS = 5_000_000
"""The longest sleep: loops and watchdogs go on while nobody talks."""
CATCH_UP_NS = 1_000_000
"""What is caught up between two looks at the line: whoever waits on a busy machine is answered first."""
LARGEST_READ = 4096
LARGEST_REQUEST = 65_536
"""Bytes of one request on the control socket."""


class Emulator:
    """Serves one device until `stop`.

    link: where the pseudo-terminal shall be found, a symbolic link; None: no pseudo-terminal. tcp: host and port to
    listen at, as a Wi-Fi microcontroller does; port 0 takes a free one. control: path of the Unix socket for `Control`.
    store: file that non-volatile registers are written to when they change.

    Raises LineError where a path or a port cannot be taken.
    """

    def __init__(
        self,
        device: Device,
        link: Path | None = None,
        tcp: tuple[str, int] | None = None,
        control: Path | None = None,
        store: Path | None = None,
    ) -> None:
        self.device = device
        device.largest_catch_up = CATCH_UP_NS
        self._store, self._stored = store, device.stored()
        self._link, self._control_path = link, control
        self._running = True
        self._plug_in_at: int | None = None
        self._master = self._slave = -1
        self._listener: socket.socket | None = None
        self._client: socket.socket | None = None
        self._control: socket.socket | None = None
        self._control_clients: dict[socket.socket, bytes] = {}
        self._wake_read, self._wake_write = os.pipe()
        try:
            if control is not None:
                self._control = _listen_at(control)
            if link is not None:
                self._plug_in()
            if tcp is not None:
                self._listener = socket.create_server(tcp)
        except OSError as error:
            self.close()
            place = error.filename or (f"{tcp[0]}:{tcp[1]}" if tcp and self._listener is None else control or link)
            raise LineError(f"{place} cannot be taken: {error.strerror or error}") from error

    @property
    def port(self) -> int:
        """The TCP port."""
        assert self._listener is not None, "there is a TCP port"
        return int(self._listener.getsockname()[1])

    def stop(self) -> None:
        """Ends `run`, from any thread or signal handler."""
        self._running = False
        with contextlib.suppress(OSError):
            os.write(self._wake_write, b"\0")

    def run(self) -> None:
        """Serves until `stop`, then leaves nothing behind."""
        try:
            while self._running:
                self._turn()
        finally:
            self.close()

    def close(self) -> None:
        """Gives everything back."""
        self.device.close()
        self._unplug()
        if self._control is not None and self._control_path is not None:
            self._control_path.unlink(missing_ok=True)
        for sock in (self._listener, self._client, self._control, *self._control_clients):
            if sock is not None:
                sock.close()
        self._listener = self._client = self._control = None
        self._control_clients.clear()
        for end in (self._wake_read, self._wake_write):
            with contextlib.suppress(OSError):
                os.close(end)

    # One turn

    def _turn(self) -> None:
        readable = self._wait()
        now = time.monotonic_ns()
        if self._plug_in_at is not None and now >= self._plug_in_at:
            self._plug_in_at = None
            self._plug_in()
        for end in readable:
            if end == self._master:
                self._hear(_read_terminal(end), now)
            elif end is self._listener:
                self._accept()
            elif end is self._client:
                self._hear_client(now)
            elif end is self._control:
                assert self._control is not None, "it is readable"
                self._control_clients[self._control.accept()[0]] = b""
            elif isinstance(end, socket.socket):
                self._hear_control(end)
        out = self.device.collect(time.monotonic_ns())
        if out:
            self._say(out)
        if self._store is not None and (stored := self.device.stored()) != self._stored:
            self._stored = stored
            write_yaml(stored, self._store)

    def _wait(self) -> list[Any]:
        """Sleeps until something comes, is due, or for `IDLE_NS`; not at all while there is time to catch up."""
        now = time.monotonic_ns()
        due = self.device.next_output()
        until = now + IDLE_NS if due is None else min(due, now + IDLE_NS)
        if now - self.device.time >= CATCH_UP_NS:
            until = now
        ends: list[Any] = [self._wake_read, *self._control_clients]
        ends += [end for end in (self._listener, self._client, self._control) if end is not None]
        if self._master >= 0:
            ends.append(self._master)
        return select.select(ends, [], [], max(until - now, 0) * 1e-9)[0]

    def _hear(self, data: bytes, now: int) -> None:
        if data:
            self.device.receive(data, now)

    def _say(self, data: bytes) -> None:
        if self._master >= 0:
            with contextlib.suppress(BlockingIOError):  # nobody reads: a UART would not wait either
                os.write(self._master, data)
        if self._client is not None:
            try:
                self._client.sendall(data)
            except OSError:
                self._client.close()
                self._client = None

    # Pseudo-terminal

    def _plug_in(self) -> None:
        assert self._link is not None, "there is a pseudo-terminal"
        self._master, self._slave = pty.openpty()
        # The slave stays open here, so that a host that leaves is no hang-up and can come back.
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        temporary = self._link.with_name(f".{self._link.name}.{os.getpid()}")
        self._link.parent.mkdir(parents=True, exist_ok=True)
        temporary.unlink(missing_ok=True)
        temporary.symlink_to(os.ttyname(self._slave))
        temporary.replace(self._link)

    def _unplug(self) -> None:
        if self._master < 0:
            return
        if self._link is not None and self._link.is_symlink():
            with contextlib.suppress(OSError):
                if os.readlink(self._link) == os.ttyname(self._slave):
                    self._link.unlink()
        os.close(self._master)
        os.close(self._slave)
        self._master = self._slave = -1

    # TCP

    def _accept(self) -> None:
        assert self._listener is not None, "it is readable"
        client, _ = self._listener.accept()
        if self._client is not None:  # one host at a time, and the newest knows that the older one is gone
            self._client.close()
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client = client

    def _hear_client(self, now: int) -> None:
        assert self._client is not None, "it is readable"
        try:
            data = self._client.recv(LARGEST_READ)
        except OSError:
            data = b""
        if not data:
            self._client.close()
            self._client = None
        self._hear(data, now)

    # Control

    def _hear_control(self, client: socket.socket) -> None:
        try:
            data = client.recv(LARGEST_READ)
        except OSError:
            data = b""
        text = self._control_clients[client] + data
        *lines, rest = text.split(b"\n")
        for line in lines:
            with contextlib.suppress(OSError):
                client.sendall(json.dumps(self._obey(line)).encode() + b"\n")
        if not data or len(rest) > LARGEST_REQUEST:
            del self._control_clients[client]
            client.close()
        else:
            self._control_clients[client] = rest

    def _obey(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
            word = request.pop("do")
            if word not in self._words:
                raise FaultError(f"{word!r} is unknown: known are {', '.join(self._words)}")
            self.device.advance(time.monotonic_ns())
            return {"ok": True, "result": self._words[word](self, **request)}
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            return {"ok": False, "error": f"{type(error).__name__}: {error}"}

    def _unplug_for(self, seconds: float) -> None:
        if self._link is None:
            raise FaultError("there is no cable to pull: the device is on TCP")
        self._unplug()
        self._plug_in_at = time.monotonic_ns() + round(float(seconds) * 1e9)

    def _points(self) -> list[tuple[int, list[float | None]]]:
        points, self.device.points = self.device.points, []
        self.device.trace = True
        return [(p.time, [None if v != v else v for v in p.targets.tolist()]) for p in points]

    _words: dict[str, Callable[..., Any]] = {  # noqa: RUF012
        "state": lambda self: self.device.state(),
        "line_fault": lambda self, name, value: self.device.line_faults.set(name, value),
        "silent_servos": lambda self, names: self.device.set_silent_servos(names),
        "silent_boards": lambda self, names: self.device.set_silent_boards(names),
        "frozen": lambda self, names: self.device.set_frozen(names),
        "unreadable": lambda self, names: self.device.set_unreadable(names),
        "angle_error": lambda self, servo, angle: self.device.set_angle_error(servo, angle),
        "brown_out": lambda self: self.device.brown_out(),
        "charge": lambda self, value: self.device.set_charge(value),
        "extra_current": lambda self, servo, current: self.device.set_extra_current(servo, current),
        "move_by_hand": lambda self, servo, position: self.device.move_by_hand(servo, position),
        "unplug": lambda self, seconds: self._unplug_for(seconds),
        "points": lambda self: self._points(),
    }


class Control:
    """The other end of an emulator's control socket. Raises LineError where there is none.

    Words: `state`; `line_fault` (name, value: see `LineFaults`); `silent_servos` (names); `silent_boards` (names);
    `frozen` (names of servos, imu, battery: readings that do not change any more); `unreadable` (names: those say that
    they have no reading); `angle_error` (servo, angle: its reading is so far off); `brown_out`; `charge` (value);
    `extra_current` (servo, current); `move_by_hand` (servo, position); `unplug` (seconds); `points`: what the boards
    were told since the last call, as (monotonic time [ns], targets [rad]).
    """

    def __init__(self, path: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.connect(str(path))
        except OSError as error:
            self._socket.close()
            raise LineError(f"no emulator listens at {path}: {error.strerror}") from error
        self._file = self._socket.makefile("rwb")

    def do(self, word: str, **arguments: Any) -> Any:
        """Has one word obeyed. Raises FaultError for what the emulator refuses, LineError where it is gone."""
        try:
            self._file.write(json.dumps({"do": word, **arguments}).encode() + b"\n")
            self._file.flush()
            line = self._file.readline()
        except OSError as error:
            raise LineError(f"the emulator is gone: {error}") from error
        if not line:
            raise LineError("the emulator is gone")
        answer = json.loads(line)
        if not answer["ok"]:
            raise FaultError(answer["error"])
        return answer["result"]

    def close(self) -> None:
        """Leaves."""
        self._file.close()
        self._socket.close()


def control_path(link: Path) -> Path:
    """Where the control socket of the emulator with that pseudo-terminal is."""
    return link.with_name(f"{link.name}.control")


def _listen_at(path: Path) -> socket.socket:
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    with contextlib.suppress(FileNotFoundError):
        probe = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()  # of an emulator that was killed
        else:
            listener.close()
            raise OSError(errno.EADDRINUSE, "another emulator is there", str(path))
        finally:
            probe.close()
    path.parent.mkdir(parents=True, exist_ok=True)
    listener.bind(str(path))
    path.chmod(0o600)
    listener.listen()
    return listener


def _read_terminal(master: int) -> bytes:
    try:
        return os.read(master, LARGEST_READ)
    except OSError:
        return b""
