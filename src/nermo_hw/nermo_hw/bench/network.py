"""Two machines on one: network namespaces joined by a wire that delays, loses, reorders and cuts IP packets.

    python -m nermo_hw.bench.network

No rights are needed where the kernel lets users make namespaces. Each namespace has a TUN interface; this process
carries the packets from one to the other in its own time. `tc netem`, which not every kernel has, is not needed.
"""

from __future__ import annotations

import ctypes
import fcntl
import heapq
import os
import queue
import random
import select
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from nermo_hw.bench.json_lines import Child, serve

ROBOT_IP, WORKSTATION_IP = "10.77.0.1", "10.77.0.2"
ADDRESSES = {"robot": ROBOT_IP, "workstation": WORKSTATION_IP}
_CLONE_NEWUSER, _CLONE_NEWNET = 0x10000000, 0x40000000
_TUNSETIFF, _IFF_TUN, _IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
_SIOCSIFADDR, _SIOCSIFNETMASK, _SIOCGIFFLAGS, _SIOCSIFFLAGS = 0x8916, 0x891C, 0x8913, 0x8914
_IFF_UP = 0x1
_LARGEST_PACKET = 65_536


class NoNamespacesError(OSError):
    """This machine does not let us make network namespaces; the text says which step it refused."""


@dataclass(slots=True)
class Impairment:
    """What happens to each packet, in both directions."""

    delay: float = 0.0
    """[s]"""
    jitter: float = 0.0
    """Each packet's delay is that much more or less at most, evenly spread [s]."""
    loss: float = 0.0
    """Share that is lost, [0, 1]."""
    reorder: bool = False
    """Whether a packet may overtake another; otherwise the later one waits."""
    cut: bool = False
    """Nothing comes through."""


class Wire:
    """Carries packets between two file descriptors. seed: of losses and delays."""

    def __init__(self, ends: tuple[int, int], seed: int = 0) -> None:
        self._ends = ends
        self._random = random.Random(seed)
        self._waiting: list[tuple[float, int, int, bytes]] = []
        self._number = 0
        self._last = [0.0, 0.0]
        self.impairment = Impairment()
        self.carried = self.lost = 0

    def run(self, ended: threading.Event) -> None:
        """Carries until `ended`."""
        while not ended.is_set():
            now = time.monotonic()
            while self._waiting and self._waiting[0][0] <= now:
                _, _, to, packet = heapq.heappop(self._waiting)
                try:
                    os.write(self._ends[to], packet)
                    self.carried += 1
                except OSError:
                    self.lost += 1
            pause = min(self._waiting[0][0] - now, 0.05) if self._waiting else 0.05
            for end in select.select(self._ends, [], [], max(pause, 0.0))[0]:
                self._take(os.read(end, _LARGEST_PACKET), 1 - self._ends.index(end))

    def _take(self, packet: bytes, to: int) -> None:
        now, how = time.monotonic(), self.impairment
        if how.cut or self._random.random() < how.loss:
            self.lost += 1
            return
        due = now + max(how.delay + self._random.uniform(-how.jitter, how.jitter), 0.0)
        if not how.reorder:
            due = self._last[to] = max(due, self._last[to])
        self._number += 1
        heapq.heappush(self._waiting, (due, self._number, to, packet))


class _Namespace:
    """A thread that lives in a network namespace of its own, and starts processes there."""

    def __init__(self, address: str) -> None:
        self.tun = -1
        self._address = address
        self._work: queue.Queue[tuple[Callable[[], Any], queue.Queue[Any]]] = queue.Queue()
        ready: queue.Queue[Exception | None] = queue.Queue()
        threading.Thread(target=self._live, args=(ready,), daemon=True).start()
        error = ready.get()
        if error is not None:
            raise error

    def _live(self, ready: queue.Queue[Exception | None]) -> None:
        try:
            _unshare(_CLONE_NEWNET)
            self.tun = _open_tun(self._address)
        except OSError as error:
            ready.put(error)
            return
        ready.put(None)
        while True:
            work, answer = self._work.get()
            try:
                answer.put(work())
            except OSError as error:
                answer.put(error)

    def start(self, command: list[str], **streams: Any) -> subprocess.Popen[bytes]:
        """Starts a process in the namespace. Raises OSError."""
        answer: queue.Queue[Any] = queue.Queue()
        self._work.put((lambda: subprocess.Popen(command, **streams), answer))
        done = answer.get()
        if isinstance(done, OSError):
            raise done
        return done


def _unshare(flags: int) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(flags) != 0:
        number = ctypes.get_errno()
        kind = "a user namespace" if flags & _CLONE_NEWUSER else "a network namespace"
        raise NoNamespacesError(number, f"{kind} cannot be made: {os.strerror(number)}")


def _become_root_of_a_namespace() -> None:
    """A user namespace in which this process may do what it needs, and nothing outside. Before any thread is there."""
    user, group = os.getuid(), os.getgid()
    _unshare(_CLONE_NEWUSER)
    try:
        Path("/proc/self/setgroups").write_text("deny")
        Path("/proc/self/uid_map").write_text(f"0 {user} 1")
        Path("/proc/self/gid_map").write_text(f"0 {group} 1")
    except OSError as error:
        raise NoNamespacesError(error.errno, f"a user namespace cannot be set up: {error.strerror}") from error


def _open_tun(address: str) -> int:
    """A TUN interface in the present namespace, up and with an address."""
    name = b"nermo0"
    try:
        tun = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)
        fcntl.ioctl(tun, _TUNSETIFF, struct.pack("16sH22x", name, _IFF_TUN | _IFF_NO_PI))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
            for request, value in ((_SIOCSIFADDR, address), (_SIOCSIFNETMASK, "255.255.255.0")):
                packed = struct.pack("16sH2x4s16x", name, socket.AF_INET, socket.inet_aton(value))
                fcntl.ioctl(control, request, packed)
            for interface in (name, b"lo"):
                flags = struct.unpack(
                    "16xH", fcntl.ioctl(control, _SIOCGIFFLAGS, struct.pack("16sH22x", interface, 0))[:18]
                )
                fcntl.ioctl(control, _SIOCSIFFLAGS, struct.pack("16sH22x", interface, flags[0] | _IFF_UP))
    except OSError as error:
        raise NoNamespacesError(error.errno, f"/dev/net/tun cannot be used: {error.strerror}") from error
    return tun


class _Server:
    """The words of the network process."""

    def __init__(self) -> None:
        self._spaces = {side: _Namespace(address) for side, address in ADDRESSES.items()}
        self._wire = Wire((self._spaces["robot"].tun, self._spaces["workstation"].tun))
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._wire.run, args=(self._ended,), daemon=True)
        self._thread.start()
        self._processes: dict[str, subprocess.Popen[Any]] = {}
        self.words: dict[str, Callable[..., Any]] = {
            "impair": self._impair,
            "start": self._start,
            "signal": self._signal,
            "tell": self._tell,
            "cpu": self._cpu,
            "counts": lambda: {"carried": self._wire.carried, "lost": self._wire.lost},
        }

    def _impair(self, **values: Any) -> None:
        self._wire.impairment = Impairment(**values)

    def _start(self, name: str, side: str, command: list[str], talks: bool = False) -> int:
        streams: dict[str, Any] = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL}
        if talks:
            streams = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        process = self._processes[name] = self._spaces[side].start(command, **streams)
        return process.pid

    def _tell(self, name: str, line: str) -> str:
        process = self._processes[name]
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(line)
        process.stdin.flush()
        return str(process.stdout.readline())

    def _signal(self, name: str, number: int) -> int | None:
        process = self._processes[name]
        process.send_signal(number)
        if number in (signal.SIGKILL, signal.SIGTERM, signal.SIGINT):
            return process.wait(10.0)
        return None

    def _cpu(self, name: str) -> float:
        """Processor time that a process has used [s]."""
        times = psutil.Process(self._processes[name].pid).cpu_times()
        return float(times.user + times.system)

    def end(self) -> None:
        """Ends all processes."""
        self._ended.set()
        for process in self._processes.values():
            process.terminate()
        for process in self._processes.values():
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()


class Network(Child):
    """The network process, and processes in its namespaces. Raises NoNamespacesError where there can be none."""

    def __init__(self) -> None:
        super().__init__("the network", [sys.executable, "-m", "nermo_hw.bench.network"])
        assert self.process.stdout is not None
        line = self.process.stdout.readline().strip()
        if line != "ready":
            self.close()
            raise NoNamespacesError(0, line or "the network process has ended")

    def impair(self, impairment: Impairment) -> None:
        """Makes the wire so, from now on."""
        values = {name: getattr(impairment, name) for name in Impairment.__slots__}
        self.do("impair", **values)


def main() -> int:
    """Makes the namespaces, says "ready" or why not, and obeys words."""
    try:
        _become_root_of_a_namespace()
        server = _Server()
    except NoNamespacesError as error:
        print(error.strerror, flush=True)
        return 1
    print("ready", flush=True)
    serve(server.words, server.end)
    return 0


if __name__ == "__main__":
    sys.exit(main())
