"""Datagrams of messages: the magic `sS`, the version and the kind, then a fixed layout or tagged msgpack."""

import struct

import msgspec

from capture_app.sync.wire.beacon import ArrivalReport
from capture_app.sync.wire.messages import ControlMessage, Goodbye, Heartbeat, Hello, TriggerAck
from capture_app.sync.wire.time_messages import (
    MAGIC,
    VERSION,
    TimeReply,
    TimeRequest,
    WireError,
    decode_time,
    encode_time,
)

MAX_DATAGRAM = 1200
"""In bytes, of a control message; fits every link without fragments."""
_KIND_CONTROL = 3
_HEADER = struct.Struct(">2sBB")

Message = TimeRequest | TimeReply | ControlMessage
FromClient = TimeRequest | Hello | Heartbeat | TriggerAck | Goodbye | ArrivalReport

_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(ControlMessage)


def encode(message: Message) -> bytes:
    """Return the datagram of a message. Raises WireError where it would be larger than MAX_DATAGRAM."""
    if isinstance(message, TimeRequest | TimeReply):
        return encode_time(message)
    data = _HEADER.pack(MAGIC, VERSION, _KIND_CONTROL) + _encoder.encode(message)
    if len(data) > MAX_DATAGRAM:
        raise WireError(f"a {type(message).__name__} of {len(data)} bytes is over {MAX_DATAGRAM}")
    return data


def decode(data: bytes) -> Message:
    """Return the message of a datagram. Raises WireError where it is not a message of this version."""
    if len(data) < _HEADER.size or data[:2] != MAGIC:
        raise WireError("not a simulshot datagram")
    version, kind = data[2], data[3]
    if version != VERSION:
        raise WireError(f"protocol version {version}, this is version {VERSION}")
    if kind != _KIND_CONTROL:
        return decode_time(data)
    try:
        message: ControlMessage = _decoder.decode(data[_HEADER.size :])
    except (msgspec.DecodeError, msgspec.ValidationError, UnicodeDecodeError) as error:
        raise WireError(f"malformed control message: {error}") from error
    return message
