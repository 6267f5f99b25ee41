"""Changes to bytes that break readers: bits, lengths, cuts, repeats, and odd values in JSON."""

import json
import random
from typing import Any

ODD: tuple[Any, ...] = (
    None, True, -1, 0, 2**63, -(2**70), 10**400, 1e308, -1e-308, "", "\x1b[2J", "../..", "a/b", [], [[]], {},
)  # fmt: skip
NUMBERS = b"\x00", b"\x7f", b"\x80", b"\xff", b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\x00\x00\x00\x00"


def mutate(data: bytes, rng: random.Random) -> bytes:
    """Change a thing or a few."""
    if rng.random() < 0.5 and (odd := _with_odd_value(data, rng)) is not None:
        return odd
    changed = bytearray(data)
    for _ in range(rng.randint(1, 4)):
        at, length = rng.randrange(len(changed) + 1), rng.randint(1, 16)
        match rng.randrange(5):
            case 0 if at < len(changed):
                changed[at] ^= 1 << rng.randrange(8)
            case 1:
                number = rng.choice(NUMBERS)
                changed[at : at + len(number)] = number
            case 2:
                del changed[at:]
            case 3:
                del changed[at : at + length]
            case _:
                changed[at:at] = changed[max(0, at - length) : at]
    return bytes(changed)


def _with_odd_value(data: bytes, rng: random.Random) -> bytes | None:
    """JSON, alone or in lines, with one value exchanged; None where the data is none."""
    lines = data.splitlines(keepends=True)
    for part in (data, rng.choice(lines) if lines else b""):
        try:
            value = json.loads(part)
        except ValueError:
            continue
        if isinstance(value, dict | list):
            _exchange(value, rng)
            return data.replace(part, json.dumps(value).encode() + (b"\n" if part is not data else b""), 1)
    return None


def _exchange(value: Any, rng: random.Random) -> None:
    """Exchange one value somewhere inside, or take it out."""
    while True:
        keys = list(value) if isinstance(value, dict) else list(range(len(value)))
        if not keys:
            return
        key = rng.choice(keys)
        inner = value[key]
        if isinstance(inner, dict | list) and inner and rng.random() < 0.8:
            value = inner
        elif rng.random() < 0.2:
            del value[key]
            return
        else:
            value[key] = rng.choice(ODD)
            return
