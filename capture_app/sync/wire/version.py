"""Which version of the protocol a peer speaks, asked and told in a form that no version may change.

2 bytes   the magic of all datagrams
1 byte    the version of who sends this; 0 of one who only asks
1 byte    0
8 bytes   a token of who asks, given back in the answer

Whoever gets a datagram of another version answers with its own, in no more bytes, and never to an answer.
"""

import struct

MAGIC = b"sS"
VERSION = 2
TOKEN_BYTES = 8
KIND_VERSION = 0
_ASKING = 0
_FORM = struct.Struct(f">2sBB{TOKEN_BYTES}s")
_HEADER = struct.Struct(">2sBB")


def version_question(token: bytes) -> bytes:
    """Return the datagram that asks a peer for its version; `token` has TOKEN_BYTES bytes."""
    return _FORM.pack(MAGIC, _ASKING, KIND_VERSION, token)


def version_answer(data: bytes) -> bytes | None:
    """Return what to answer to a datagram of another version; None where it gets no answer."""
    if len(data) < _FORM.size or data[:2] != MAGIC:
        return None
    _, version, kind = _HEADER.unpack_from(data)
    if version == VERSION or (kind == KIND_VERSION and version != _ASKING):
        return None
    return _FORM.pack(MAGIC, VERSION, KIND_VERSION, data[_HEADER.size : _FORM.size])


def answered_version(data: bytes, token: bytes) -> int | None:
    """Return the version that a peer tells in its answer to a question; None where this is none to it."""
    if len(data) != _FORM.size:
        return None
    magic, version, kind, given_back = _FORM.unpack(data)
    is_answer = (magic, kind, given_back) == (MAGIC, KIND_VERSION, token) and version != _ASKING
    return int(version) if is_answer else None


def is_version_question(data: bytes) -> bool:
    """Whether a datagram only asks for the version, which anybody may."""
    return len(data) == _FORM.size and data[:2] == MAGIC and (data[2], data[3]) == (_ASKING, KIND_VERSION)


def is_version_answer(data: bytes) -> bool:
    """Whether a datagram tells another version than this one, whoever asked."""
    is_one = len(data) == _FORM.size and data[:2] == MAGIC and data[3] == KIND_VERSION
    return is_one and data[2] not in (VERSION, _ASKING)


def version_mismatch(version: int) -> str:
    """Say that a leader speaks another version, and what to do."""
    older = "here" if version > VERSION else "on the leader's machine"
    return (
        f"its leader speaks version {version} of the protocol, and this node version {VERSION}:"
        f" install the newer simulshot {older} too"
    )
