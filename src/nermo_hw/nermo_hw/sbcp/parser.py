"""Packets out of a stream of bytes that may hold anything."""

from __future__ import annotations

from collections.abc import Callable

from nermo_hw.sbcp.packet import HEADER, MAX_PAYLOAD, OVERHEAD, PREAMBLE, Packet, checksum

Plausible = Callable[[int, int, int, int], bool]
"""Whether a preamble can be meant: device class, ID, size, code."""


class Parser:
    """Cuts a stream into packets, and finds its way back from any garbage.

    A header byte that turns out to be none costs nothing but itself: the search goes on with the byte after it, so that
    a packet that begins inside a false one is found. An 8-bit sum lets one false frame in 256 through; who knows what
    can come says so with `plausible`, which is asked as soon as a preamble is complete. Where that knows so much that
    data hardly ever look like a preamble, `prefer_later` takes the later of two frames with right checksums that
    overlap: the earlier was cut off, and what followed happened to fit.
    """

    def __init__(self, plausible: Plausible | None = None, prefer_later: bool = False) -> None:
        self._plausible, self._prefer_later = plausible, prefer_later
        self._buffer = bytearray()
        self._flushing = False
        self.corrupt = 0
        """Frames with a plausible preamble and a wrong checksum."""
        self.garbage_bytes = 0
        """Bytes that belong to no packet."""

    @property
    def pending(self) -> int:
        """Bytes that wait for the rest of their packet."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Packet]:
        """Takes what came and returns the packets that are complete now."""
        buffer = self._buffer
        buffer += data
        packets: list[Packet] = []
        position, end = 0, len(buffer)
        while position < end:
            start = buffer.find(HEADER, position)
            if start < 0:
                self.garbage_bytes += end - position
                position = end
                break
            self.garbage_bytes += start - position
            position = start
            if end - position < PREAMBLE:
                break
            device_class, device_id, size, code = buffer[position + 1 : position + PREAMBLE]
            if size > MAX_PAYLOAD or not (
                self._plausible is None or self._plausible(device_class, device_id, size, code)
            ):
                self.garbage_bytes += 1
                position += 1
                continue
            last = position + OVERHEAD + size - 1
            if last >= end:
                break
            wrong = checksum(buffer[position + 1 : last]) != buffer[last]
            hides = not wrong and self._hides_another(position, last)
            if hides is None:
                break
            if wrong or hides:
                self.corrupt += 1
                self.garbage_bytes += 1
                position += 1
                continue
            packets.append(Packet(device_class, device_id, code, bytes(buffer[position + PREAMBLE : last])))
            position = last + 1
        del buffer[:position]
        return packets

    def _hides_another(self, start: int, last: int) -> bool | None:
        """Whether within the frame from `start` to `last` another begins, with a right checksum; None: not yet known.

        Then this one was cut off, and what followed happened to fit.
        """
        if not self._prefer_later or self._plausible is None:
            return False
        buffer, position = self._buffer, start
        while (position := buffer.find(HEADER, position + 1, last + 1)) >= 0:
            if len(buffer) - position < PREAMBLE:
                return False  # too little to wait for: most such bytes are data
            device_class, device_id, size, code = buffer[position + 1 : position + PREAMBLE]
            end = position + OVERHEAD + size - 1
            if size > MAX_PAYLOAD or not self._plausible(device_class, device_id, size, code):
                continue
            if end >= len(buffer):
                if not self._flushing:
                    return None
            elif checksum(buffer[position + 1 : end]) == buffer[end]:
                return True
        return False

    def flush(self) -> list[Packet]:
        """Says that the line has been quiet for longer than within a packet: what waits will never be complete.

        Returns the packets that a false or cut-off one was hiding.
        """
        self._flushing = True
        packets = self.feed(b"")
        while self._buffer:
            # The first byte is a header whose packet did not come; the next may be a true one.
            del self._buffer[0]
            self.garbage_bytes += 1
            packets += self.feed(b"")
        self._flushing = False
        return packets
