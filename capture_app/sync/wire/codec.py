"""Datagram encoding: the magic `sS`, version and kind, then a fixed layout or tagged msgpack.

Time messages have the fixed layout, and their send time is written last: each microsecond between reading the
clock and the socket is an error of the estimate. A time reply is never larger than its request.

The query for a peer's version has a format that no version may change:

2 bytes   magic of all datagrams
1 byte    version of the sender; 0 in a query
1 byte    0
8 bytes   token of the sender of the query, returned in the answer

A datagram of another version is answered with this version, in no more bytes. An answer is never answered.
"""

import struct
from typing import Any

import msgspec
from msgspec.structs import replace

from capture_app.common.camera_facts import CameraFacts, StampAccuracy
from capture_app.common.text import REPLACEMENT, UNREADABLE
from capture_app.sync.wire.datagrams import (
    ControlMessage,
    Goodbye,
    Heartbeat,
    Hello,
    JoinRefusal,
    MemberReports,
    Notice,
    Report,
    TimeReply,
    TimeRequest,
    TriggerAck,
)

MAGIC, VERSION, TOKEN_BYTES = b"sS", 8, 8
"""First bytes of each datagram, version of the protocol, and length of the token by which an answer to a
version query is matched; nobody guesses 64 bits while one query is open."""
KIND_VERSION, _ASKING = 0, 0
"""Kind and version of a version query; no version of the protocol uses either (see above)."""
_HEADER, _FORM = struct.Struct(">2sBB"), struct.Struct(f">2sBB{TOKEN_BYTES}s")
"""Magic, version and kind, as in all datagrams, and the same with a token, as in a query and its answer."""
MAX_DATAGRAM = 1200
"""Maximum bytes of a control message, which fit every link without fragmentation."""
_KIND_TIME_REQUEST, _KIND_TIME_REPLY, _KIND_CONTROL = 1, 2, 3
"""Kinds of datagrams of this version."""
_TIME, _T0, _T2 = struct.Struct(">2sBBIIqqq"), struct.Struct(">q16x"), struct.Struct(">q")
"""Layout of a time message: header, client, sequence, and the times in ns; and of its last field that is set,
t0 of a request, whose other two are 0, or t2 of a reply."""
_BEFORE_T0, _BEFORE_T2 = struct.Struct(">2sBBII"), struct.Struct(">2sBBIIqq")
"""Layouts of what is before that field."""


def version_question(token: bytes) -> bytes:
    """Return the datagram that queries a peer's version; `token` has TOKEN_BYTES bytes."""
    return _FORM.pack(MAGIC, _ASKING, KIND_VERSION, token)


def version_answer(data: bytes) -> bytes | None:
    """Return the answer to a datagram of another version; None if it gets no answer."""
    if len(data) < _FORM.size or data[:2] != MAGIC:
        return None
    _, version, kind = _HEADER.unpack_from(data)
    if version == VERSION or (kind == KIND_VERSION and version != _ASKING):
        return None
    return _FORM.pack(MAGIC, VERSION, KIND_VERSION, data[_HEADER.size : _FORM.size])


def answered_version(data: bytes, token: bytes) -> int | None:
    """Return the version in a peer's answer to a query; None if `data` is not the answer to this query."""
    if len(data) != _FORM.size:
        return None
    magic, version, kind, given_back = _FORM.unpack(data)
    is_answer = (magic, kind, given_back) == (MAGIC, KIND_VERSION, token) and version != _ASKING
    return int(version) if is_answer else None


def is_version_answer(data: bytes) -> bool:
    """Whether a datagram reports a version other than this one, in answer to any query."""
    is_one = len(data) == _FORM.size and data[:2] == MAGIC and data[3] == KIND_VERSION
    return is_one and data[2] not in (VERSION, _ASKING)


def other_version(data: bytes) -> str:
    """Return the words about a client whose datagram is of another version; empty for a mere query."""
    version = data[2]
    if version == _ASKING:
        return ""
    older = "on its machine" if version < VERSION else "here"
    return (
        f"it speaks version {version} of the protocol, and this leader version {VERSION}:"
        f" install the newer simulshot {older} too"
    )


def version_mismatch(version: int) -> str:
    """Return the error text for a leader of another version, with the remedy."""
    older = "here" if version > VERSION else "on the leader's machine"
    return (
        f"its leader speaks version {version} of the protocol, and this node version {VERSION}:"
        f" install the newer simulshot {older} too"
    )


Message = TimeRequest | TimeReply | ControlMessage
FromMember = TimeRequest | Heartbeat | TriggerAck | Goodbye
FromClient = FromMember | MemberReports | Hello

_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(ControlMessage)


class WireError(ValueError):
    """Datagram that is foreign, truncated, or of another version, which is then in `version`."""

    def __init__(self, why: str, *, version: int | None = None) -> None:
        super().__init__(why)
        self.version = version


def encode(message: Message) -> bytes:
    """Return the datagram of a message. Raises WireError if it would be larger than MAX_DATAGRAM."""
    match message:
        case TimeRequest(client, sequence, t0_ns):
            return request_at(request_before_t0(client, sequence), t0_ns)
        case TimeReply(client, sequence, t0_ns, t1_ns, t2_ns):
            return reply_at(reply_before_t2(TimeRequest(client, sequence, t0_ns), t1_ns), t2_ns)
    if len(data := _HEADER.pack(MAGIC, VERSION, _KIND_CONTROL) + _encoder.encode(message)) > MAX_DATAGRAM:
        raise WireError(f"a {type(message).__name__} of {len(data)} bytes is over {MAX_DATAGRAM}")
    return data


def decode(data: bytes) -> Message:
    """Return the message of a datagram. Raises WireError if it is not a message of this version.

    If the datagram is of another version, the error has that `version`.
    """
    if len(data) < _HEADER.size or data[:2] != MAGIC:
        raise WireError("not a simulshot datagram")
    version, kind = data[2], data[3]
    if version != VERSION:
        raise WireError(f"protocol version {version}, this is version {VERSION}", version=version)
    if kind == _KIND_CONTROL:
        try:
            message: ControlMessage = _printable(_decoder.decode(data[_HEADER.size :]))
        except UNREADABLE as error:
            raise WireError(f"malformed control message: {error}") from error
        return message
    if kind not in (_KIND_TIME_REQUEST, _KIND_TIME_REPLY) or len(data) != _TIME.size:
        raise WireError(f"unknown message kind {kind} of {len(data)} bytes")
    client, sequence, t0_ns, t1_ns, t2_ns = _TIME.unpack(data)[3:]
    if kind == _KIND_TIME_REQUEST:
        return TimeRequest(client, sequence, t0_ns)
    return TimeReply(client, sequence, t0_ns, t1_ns, t2_ns)


_TEXTS: dict[type, tuple[str, ...]] = {
    Hello: ("camera",),
    CameraFacts: ("kind", "model", "pixel_format", "stamp", "label"),
    StampAccuracy: ("against",),
    Heartbeat: ("report",),
    MemberReports: ("reports",),
    Report: ("message",),
    JoinRefusal: ("reason",),
    Notice: ("text",),
    TriggerAck: ("refusal",),
}
"""Fields with texts that people read, or with parts that have such fields, by type of message."""


def _printable(value: Any) -> Any:
    """Return a message, or a part of one, whose texts no terminal takes as commands.

    Unprintable characters are replaced.
    """
    if isinstance(value, str):
        if value.isprintable():
            return value
        return "".join(letter if letter.isprintable() else REPLACEMENT.decode() for letter in value)
    if isinstance(value, tuple):
        return tuple(map(_printable, value))
    parts = ((name, getattr(value, name)) for name in _TEXTS.get(type(value), ()))
    changed = {name: plain for name, part in parts if (plain := _printable(part)) != part}
    return replace(value, **changed) if changed else value


def request_before_t0(client: int, sequence: int) -> bytes:
    """Return the bytes of a TimeRequest before its `t0_ns`."""
    return _BEFORE_T0.pack(MAGIC, VERSION, _KIND_TIME_REQUEST, client, sequence)


def request_at(before: bytes, t0_ns: int) -> bytes:
    """Return the datagram of a TimeRequest."""
    return before + _T0.pack(t0_ns)


def reply_before_t2(request: TimeRequest, t1_ns: int) -> bytes:
    """Return the bytes of the TimeReply to a request before its `t2_ns`."""
    head = MAGIC, VERSION, _KIND_TIME_REPLY, request.client, request.sequence
    return _BEFORE_T2.pack(*head, request.t0_ns, t1_ns)


def reply_at(before: bytes, t2_ns: int) -> bytes:
    """Return the datagram of a TimeReply."""
    return before + _T2.pack(t2_ns)
