"""Time messages: a fixed layout, and the time of sending goes in last.

Every microsecond between the reading of the clock and the socket would be an error of the estimate. A time
reply is never larger than its request.
"""

import struct

from msgspec import Struct

MAGIC = b"sS"
VERSION = 1
KIND_TIME_REQUEST = 1
KIND_TIME_REPLY = 2
_TIME = struct.Struct(">2sBBIIqqq")
_BEFORE_T0 = struct.Struct(">2sBBII")
_BEFORE_T2 = struct.Struct(">2sBBIIqq")
_T0 = struct.Struct(">q16x")
_T2 = struct.Struct(">q")


class WireError(ValueError):
    """A datagram that is not one of ours, cut, or of another version."""


class TimeRequest(Struct, frozen=True):
    """A client asks for the leader's time; `t0_ns` is its own when it sent this."""

    client: int
    sequence: int
    t0_ns: int


class TimeReply(Struct, frozen=True):
    """The leader's answer: request received at `t1_ns` and answered at `t2_ns`, leader time."""

    client: int
    sequence: int
    t0_ns: int
    t1_ns: int
    t2_ns: int


def encode_time(message: TimeRequest | TimeReply) -> bytes:
    """Return the datagram of a time message."""
    if isinstance(message, TimeRequest):
        return request_at(request_before_t0(message.client, message.sequence), message.t0_ns)
    request = TimeRequest(message.client, message.sequence, message.t0_ns)
    return reply_at(reply_before_t2(request, message.t1_ns), message.t2_ns)


def decode_time(data: bytes) -> TimeRequest | TimeReply:
    """Return the time message of a datagram of this version. Raises WireError where it is none."""
    kind = data[3]
    if kind not in (KIND_TIME_REQUEST, KIND_TIME_REPLY) or len(data) != _TIME.size:
        raise WireError(f"unknown message kind {kind} of {len(data)} bytes")
    client, sequence, t0_ns, t1_ns, t2_ns = _TIME.unpack(data)[3:]
    if kind == KIND_TIME_REQUEST:
        return TimeRequest(client, sequence, t0_ns)
    return TimeReply(client, sequence, t0_ns, t1_ns, t2_ns)


def request_before_t0(client: int, sequence: int) -> bytes:
    """Return a TimeRequest up to its `t0_ns`."""
    return _BEFORE_T0.pack(MAGIC, VERSION, KIND_TIME_REQUEST, client, sequence)


def request_at(before: bytes, t0_ns: int) -> bytes:
    """Return the datagram of a TimeRequest."""
    return before + _T0.pack(t0_ns)


def reply_before_t2(request: TimeRequest, t1_ns: int) -> bytes:
    """Return the TimeReply to a request up to its `t2_ns`."""
    head = MAGIC, VERSION, KIND_TIME_REPLY, request.client, request.sequence
    return _BEFORE_T2.pack(*head, request.t0_ns, t1_ns)


def reply_at(before: bytes, t2_ns: int) -> bytes:
    """Return the datagram of a TimeReply."""
    return before + _T2.pack(t2_ns)
