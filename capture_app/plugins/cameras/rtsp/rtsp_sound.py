"""Sound of an IP camera: G.711 in RTP packets (RFC 3551), at 8 kHz and mono."""

import re
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from capture_app.common.errors import CameraError
from capture_app.plugins.cameras.rtsp.connection import packet_payload

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

RATE_HZ, HEARD_HZ = 8_000, 48_000
"""Samples per second of the camera, and of what is passed on."""
MU_LAW, A_LAW = 0, 8
MAX_SAMPLES = RATE_HZ


@dataclass(frozen=True, slots=True)
class SoundStream:
    """A camera's description of its sound."""

    payload_type: int
    """MU_LAW or A_LAW, whose numbers are fixed."""
    control: str
    """Control URL of the stream, possibly relative."""


def parse_sound(text: str) -> SoundStream | None:
    """Parse the sound out of an SDP description (RFC 4566); None if there is none in G.711."""
    section = re.search(r"^m=audio \d+ \S+ (0|8)\b.*?(?=^m=|\Z)", text, re.MULTILINE | re.DOTALL)
    control = section and re.search(r"^a=control:(\S+)", section[0], re.MULTILINE)
    return SoundStream(int(section[1]), control[1]) if section and control else None


def _levels(payload_type: int) -> "NDArray[np.int16]":
    """Return the level of each of the 256 codes (ITU-T G.711)."""
    import numpy as np

    codes = np.arange(256, dtype=np.int32) ^ (0xFF if payload_type == MU_LAW else 0x55)
    segment, step = codes >> 4 & 7, codes & 15
    if payload_type == MU_LAW:
        size = ((step << 3) + 0x84 << segment) - 0x84
        return np.where(codes & 0x80, -size, size).astype(np.int16)
    size = np.where(segment == 0, (step << 4) + 8, (step << 4) + 0x108 << np.maximum(segment - 1, 0))
    return np.where(codes & 0x80, size, -size).astype(np.int16)


class RtspMicrophone:
    """The microphone of an IP camera; its samples arrive over the camera's connection."""

    def __init__(self, host: str) -> None:
        """`host` names the camera in errors."""
        self._host = host
        self._stream: SoundStream | None = None
        self._has_begun = threading.Event()
        self._on_sound: Callable[[bytes, int], None] | None = None
        self._last = 0

    def begin(self, stream: SoundStream | None) -> None:
        """Note the stream's description once the camera is connected; None if it has no sound."""
        if stream is not None:
            self._stream, self._levels = stream, _levels(stream.payload_type)
        self._has_begun.set()

    def listen(self, on_sound: Callable[[bytes, int], None], closing: threading.Event) -> None:
        """Block and pass samples on until `closing` is set. Raises CameraError for a camera without sound."""
        self._has_begun.wait()
        if self._stream is None:
            raise CameraError(
                f"{self._host} sends no sound that is read",
                hint="switch its sound on, as G.711 (PCMU or PCMA)",
            )
        self._on_sound = on_sound
        closing.wait()

    def ticks_of(self, packet: bytes) -> int | None:
        """Return the RTP timestamp of a packet's first sample; None for another packet."""
        if self._stream is None or len(packet) < 12 or packet[1] & 0x7F != self._stream.payload_type:
            return None
        return int(struct.unpack_from(">I", packet, 4)[0])

    def hear(self, packet: bytes, at_ns: int, *, is_begin: bool) -> None:
        """Pass on a packet's samples, which begin at a time of the node's clock, or else arrive then."""
        import numpy as np

        try:
            codes = np.frombuffer(packet_payload(packet)[:MAX_SAMPLES], np.uint8)
        except (struct.error, IndexError):
            return
        if self._on_sound is None or not len(codes):
            return
        levels = self._levels[codes]
        places = np.arange(1, 1 + len(levels) * HEARD_HZ // RATE_HZ) * RATE_HZ / HEARD_HZ
        pcm = np.interp(places, np.arange(len(levels) + 1), [self._last, *levels])
        self._last = int(levels[-1])
        length_ns = len(levels) * 1_000_000_000 // RATE_HZ if is_begin else 0
        self._on_sound(pcm.astype("<i2").tobytes(), at_ns + length_ns)
