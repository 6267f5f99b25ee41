"""RTP and RTCP packets (RFC 3550), and access units of H.264 (RFC 6184) and H.265 (RFC 7798)."""

import struct
from collections.abc import Iterator
from dataclasses import dataclass

from capture_app.common.errors import CameraError

_START = b"\0\0\0\1"
MAX_UNIT_BYTES = 1 << 23
"""Largest coded frame; the largest ones of 8K cameras have half of it."""


def reported_ticks(data: bytes) -> list[int]:
    """Return the RTP timestamps (32 bits) in the sender reports of a compound RTCP packet.

    The camera's wall clock in the same reports is not used: it may be wrong by years.
    """
    found, at = [], 0
    while at + 4 <= len(data):
        kind, words = struct.unpack_from(">xBH", data, at)
        if kind == 200 and at + 20 <= len(data):  # a sender report
            found.append(struct.unpack_from(">I", data, at + 16)[0])
        at += 4 * (words + 1)
    return found


@dataclass(frozen=True, slots=True)
class AccessUnit:
    """One coded frame, in the byte stream format that decoders take."""

    ticks: int
    """RTP timestamp, 32 bits."""
    arrival_ns: int
    """Arrival time of its first packet."""
    data: bytes
    whole: bool
    """Whether no packet is missing, in it or just before it."""


class AccessUnits:
    """Assembler of access units (coded frames) from the RTP packets of one stream."""

    def __init__(self, codec: str, payload_type: int) -> None:
        """Create an assembler; `codec` is h264 or hevc."""
        self._is_hevc, self._payload_type = codec == "hevc", payload_type
        self._next: int | None = None
        self._ticks = self._arrival_ns = 0
        self._data, self._whole = bytearray(), True

    def add(self, packet: bytes, arrival_ns: int) -> list[AccessUnit]:
        """Add an RTP packet; return the access units that it completes.

        Raises CameraError for a unit of over MAX_UNIT_BYTES.
        """
        if len(packet) < 12 or packet[0] >> 6 != 2 or packet[1] & 0x7F != self._payload_type:
            return []
        sequence, ticks = struct.unpack_from(">HI", packet, 2)
        done = self._finish() if ticks != self._ticks else []
        if not self._data:
            self._arrival_ns, self._ticks = arrival_ns, ticks
        if self._next not in (None, sequence):
            self._whole = False
        self._next = sequence + 1 & 0xFFFF
        try:
            for piece in self._pieces(_payload(packet)):
                self._data += piece
            if len(self._data) > MAX_UNIT_BYTES:
                raise CameraError(
                    f"sends a picture of over {MAX_UNIT_BYTES >> 20} MiB",
                    hint="choose a smaller picture or a lower bit rate in the camera's settings",
                )
        except (IndexError, struct.error):
            self._whole = False
        return [*done, *(self._finish() if packet[1] & 0x80 else [])]

    def _finish(self) -> list[AccessUnit]:
        if not self._data:
            return []
        done = AccessUnit(self._ticks, self._arrival_ns, bytes(self._data), self._whole)
        self._data, self._whole = bytearray(), True
        return [done]

    def _pieces(self, payload: bytes) -> Iterator[bytes]:
        """Yield the bytes that a payload adds: one unit, several in one packet, or a fragment of one."""
        head = 2 if self._is_hevc else 1
        kind = payload[0] >> 1 & 0x3F if self._is_hevc else payload[0] & 0x1F
        if kind == (48 if self._is_hevc else 24):
            at = head
            while at < len(payload):
                size = struct.unpack_from(">H", payload, at)[0]
                yield _START + payload[at + 2 : at + 2 + size]
                at += 2 + size
        elif kind == (49 if self._is_hevc else 28):
            fragment = payload[head]
            if fragment & 0x80 and self._is_hevc:
                yield _START + bytes((payload[0] & 0x81 | (fragment & 0x3F) << 1, payload[1]))
            elif fragment & 0x80:
                yield _START + bytes((payload[0] & 0xE0 | fragment & 0x1F,))
            yield payload[head + 1 :]
        else:
            yield _START + payload


def _payload(packet: bytes) -> bytes:
    at = 12 + 4 * (packet[0] & 0x0F)
    if packet[0] & 0x10:
        at += 4 + 4 * struct.unpack_from(">H", packet, at + 2)[0]
    return packet[at : len(packet) - packet[-1] if packet[0] & 0x20 else None]
