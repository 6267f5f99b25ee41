"""What the phones' apps libsoftwaresync and RecSync say, from google-research/libsoftwaresync at 028709a.

Calls are a big-endian 32-bit method and a text that ends with the datagram; time messages are big-endian
64-bit times in ns. Both go to a fixed port, whatever port was sent from. Nothing is sealed or numbered, and
only heartbeats are acknowledged.
"""

import struct
from dataclasses import dataclass
from enum import IntEnum

CALL_PORT, TIME_PORT = 8244, 9428
HEARTBEAT_EVERY_NS = 1_000_000_000
TIME_REQUEST, TIME_ANSWER = struct.Struct(">q"), struct.Struct(">qqq")
_METHOD = struct.Struct(">i")
MOST_BYTES = 1024

PERIOD_NS, GOAL_PHASE_NS, ALIGNED_NS = 33_320_000, 15_000_000, 100_000
"""The app's own constants (for a Pixel 3): leader time % period is to be at the goal, aligned to so much."""


class Method(IntEnum):
    """What a call asks for."""

    HEARTBEAT = 1
    """A phone is here: name, IPv4 address, and true or false for having the time, with commas between."""
    HEARTBEAT_ACK = 2
    OFFSET_UPDATE = 3
    """Leader time is the phone's time minus this, decimal, in ns."""
    SET_TRIGGER_TIME = 200_000
    """Save the first frame at or after this leader time, decimal, in ns; a later call replaces it."""
    DO_PHASE_ALIGN = 200_001
    SET_EXPOSURE = 200_002
    """Exposure in ns and ISO, with a comma between."""
    START_RECORDING = 200_003
    """RecSync's, as the next; libsoftwaresync ignores both."""
    STOP_RECORDING = 200_004


@dataclass(frozen=True, slots=True)
class AppHeartbeat:
    """A phone says that it is here."""

    name: str
    is_synced: bool


def encode_call(method: Method, text: str = "") -> bytes:
    """Return the datagram of a call."""
    return _METHOD.pack(method) + text.encode()


def decode_call(data: bytes) -> tuple[int, str] | None:
    """Return method and text of a call; None for a datagram that is none."""
    if not _METHOD.size <= len(data) <= MOST_BYTES:
        return None
    return _METHOD.unpack_from(data)[0], data[_METHOD.size :].decode("utf-8", "replace")


def read_heartbeat(text: str) -> AppHeartbeat | None:
    """Read a heartbeat's text; None where it is none. The address in it may be another network's."""
    parts = text.rsplit(",", 2)
    if len(parts) != 3 or parts[2] not in ("true", "false"):
        return None
    return AppHeartbeat(parts[0], parts[2] == "true")
