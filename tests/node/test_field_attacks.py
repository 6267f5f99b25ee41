"""Whatever a machine puts into a field of a message: it is refused, or it is bounded."""

import math
import typing
from collections.abc import Callable, Iterator
from typing import Any

import msgspec
import pytest
from msgspec import inspect

from benchmarks.endurance.field_attacks import attacks, example
from capture_app.common.errors import SimulshotError
from capture_app.common.text import UNREADABLE
from capture_app.phones import wire as page
from capture_app.protocol.messages import ToLeader
from capture_app.protocol.orders import ToViewfinder
from capture_app.sync.wire.codec import WireError, decode, encode
from capture_app.sync.wire.datagrams import ControlMessage, Goodbye

MAX_NUMBER, MAX_LETTERS, MAX_ENTRIES = 2**62, 10_000, 2_000

HEAD = encode(Goodbye(1))[:4]


def decode_datagram(plain: Any) -> Any:
    return decode(HEAD + msgspec.msgpack.encode(plain))


def decode_stream(plain: Any) -> Any:
    return msgspec.json.decode(msgspec.json.encode(plain), type=ToLeader)


def decode_viewfinder(plain: Any) -> Any:
    return msgspec.json.decode(msgspec.json.encode(plain), type=ToViewfinder)


def decode_page(plain: Any) -> Any:
    return page.decode_text(msgspec.json.encode(plain).decode())


KINDS: list[tuple[Any, Callable[[Any], Any]]] = [
    *((kind, decode_datagram) for kind in typing.get_args(ControlMessage)),
    *((kind, decode_stream) for kind in typing.get_args(ToLeader)),
    *((kind, decode_viewfinder) for kind in typing.get_args(ToViewfinder)),
    *((kind, decode_page) for kind in typing.get_args(page.Said)),
]


def unbounded(plain: Any, path: str = "") -> Iterator[str]:
    """The paths of numbers, texts and lists beyond every bound."""
    match plain:
        case bool() | None:
            return
        case int() if abs(plain) > MAX_NUMBER:
            yield f"{path}: {plain}"
        case float() if not (math.isfinite(plain) and abs(plain) <= 1e18):
            yield f"{path}: {plain}"
        case str() if len(plain) > MAX_LETTERS:
            yield f"{path}: {len(plain)} letters"
        case dict() | list() if len(plain) > MAX_ENTRIES:
            yield f"{path}: {len(plain)} entries"
        case dict():
            for key, value in plain.items():
                yield from unbounded(key, f"{path}.key")
                yield from unbounded(value, f"{path}.{key}"[:200])
        case list():
            for value in plain:
                yield from unbounded(value, f"{path}[]")


@pytest.mark.parametrize(("kind", "decoded"), KINDS, ids=[kind.__name__ for kind, _ in KINDS])
def test_each_field_of_each_message_is_refused_or_bounded(kind: Any, decoded: Callable[[Any], Any]) -> None:
    info = inspect.type_info(kind)
    plain = example(info)
    assert isinstance(decoded(plain), kind), "the example itself is a message"
    found: list[str] = []
    for path, attack in attacks(info, plain):
        try:
            message = decoded(attack)
        except (*UNREADABLE, ValueError, WireError, SimulshotError, OverflowError):
            continue
        found += (f"{path}: {what}" for what in unbounded(msgspec.to_builtins(message)))
    assert not found, found[:5]
