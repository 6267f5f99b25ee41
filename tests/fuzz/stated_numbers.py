"""The numbers that a file or a message states, each exchanged for ones that it cannot be."""

import re
import struct
from collections.abc import Iterator

TEXT_NUMBERS = b"0", b"-1", b"2147483648", b"9223372036854775808", b"NaN"
BINARY_NUMBERS = tuple(
    dict.fromkeys(
        struct.pack(order + kind, value)
        for order in "<>"
        for kind, value in (
            ("I", 0), ("i", -1), ("I", 2**31), ("f", float("nan")),
            ("q", -1), ("Q", 2**63), ("d", float("nan")),
        )
    )
)  # fmt: skip
"""0, -1, 2^31, 2^63 and NaN in four and eight bytes, either end first."""
_NUMBER = re.compile(rb"(?<![\w.])[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?(?![\w.])")


def restated(data: bytes) -> Iterator[bytes]:
    """Yield `data` with one number exchanged: each number of a text, or each two bytes of another file."""
    if _is_text(data):
        for found in _NUMBER.finditer(data):
            for number in TEXT_NUMBERS:
                yield data[: found.start()] + number + data[found.end() :]
        return
    for at in range(0, len(data) - 3, 2):
        for number in BINARY_NUMBERS:
            if at + len(number) <= len(data):
                yield data[:at] + number + data[at + len(number) :]


def _is_text(data: bytes) -> bool:
    return all(byte >= 32 or byte in b"\t\r\n" for byte in data)
