"""Text formats of times, sizes, counts, JSON and progress lines, for both packages."""

import os
import re
import shlex
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Self

import msgspec

NO_VALUE = "–"
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff]")
"""Controls of a terminal, line separators, and what turns the order of the letters on a line round."""
_SURROGATE = re.compile(r"[\ud800-\udfff]")
"""Bytes of a file name that are not UTF-8: no terminal can show them."""
_UNESCAPED = rb"\x7f|\xc2[\x80-\x9f]|\xd8\x9c|\xe2\x80[\x8e\x8f\xa8-\xae]|\xe2\x81[\xa6-\xa9]|\xef\xbb\xbf"
"""The same controls in UTF-8, without the ones that JSON escapes anyway."""
_JSON_CONTROL = re.compile(_UNESCAPED)
_JSON_ODD = re.compile(rb"\\(u[0-9a-fA-F]{4}|.)|" + _UNESCAPED, re.DOTALL)
"""In JSON: an escape sequence, or a control character that needs no escape."""
REPLACEMENT = b"\xef\xbf\xbd"
Talk = Callable[[str], None]
"""Called with a line for the user."""
Progress = Callable[[int, int], None]
"""Called with the number of things that are done, and with the total."""
UNREADABLE = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)
"""Exceptions raised by decoding untrusted data: wrong type, not UTF-8, nested too deeply."""
_PROGRESS = re.compile(r"\[\s*(\d+)/(\d+)\]\s*(.*)")


def duration(ns: float | None, *, signed: bool = False, gap: str = " ") -> str:
    """Format a time with its unit, in two or three digits: 850 ns, 12 µs, 3.4 ms, 2.1 s; a dash for None."""
    if ns is None:
        return NO_VALUE
    sign, size = "-" if ns < 0 else ("+" if signed else ""), abs(ns)
    if size < 999.5:
        return f"{sign}{size:.0f}{gap}ns"
    for unit, scale in (("µs", 1e3), ("ms", 1e6)):
        if size < scale * 999.5:
            return f"{sign}{size / scale:.{1 if size < scale * 9.95 else 0}f}{gap}{unit}"
    return f"{sign}{size / 1e9:.1f}{gap}s"


def clock_offset(ns: int | None, *, signed: bool = True) -> str:
    """Format the offset of a clock, from ns to days: +4 h 12 min, -12.3 s, +45 µs; a dash for None."""
    if ns is None or abs(ns) < 60e9:
        return duration(ns, signed=signed)
    sign = "-" if ns < 0 else "+" if signed else ""
    minutes = round(abs(ns) / 60e9)
    if minutes < 60:
        return f"{sign}{minutes} min"
    hours, minutes = divmod(minutes, 60)
    return sign + (f"{hours} h {minutes:02d} min" if hours < 48 else f"{hours // 24} d {hours % 24} h")


def rough_time(seconds: float) -> str:
    """Format a duration roughly: 8 s, 2 min, 1 h 20 min."""
    if seconds < 99.5:
        return f"{max(1, round(seconds))} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 100 else f"{minutes // 60} h {minutes % 60} min"


def megabytes(size: int) -> str:
    """Format a size in bytes as MB: 12.3 MB."""
    return f"{size / 1e6:,.1f} MB"


def count(number: int, thing: str) -> str:
    """Format a number of things: 1 frame, 2 frames."""
    return f"{number} {thing}" if abs(number) == 1 else f"{number} {thing}s"


def fill_in(template: str, values: Mapping[str, object]) -> str:
    """Return a template with each @NAME@ replaced by the value of that name."""
    return re.sub(r"@(\w+)@", lambda found: str(values[found[1]]), template)


def command_line(*words: str) -> str:
    """Return a command, or a part of one, as a person types it in this system's shell."""
    return shlex.join(words) if os.name == "posix" else subprocess.list2cmdline(words)


def first_line(error: object) -> str:
    """Return the first line of an exception's message, or its type if there is no message."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]


def printable(text: str) -> str:
    """Return the text with control characters, except tabs and line ends, replaced by their escapes."""
    for odd in (_CONTROL, _SURROGATE):
        text = odd.sub(lambda found: ascii(found[0])[1:-1], text)
    return text


def printable_json(data: bytes) -> bytes:
    """Return JSON with control characters in its texts, except tabs and line ends, replaced by U+FFFD."""
    return _JSON_ODD.sub(_printable_escape, data)


def _printable_escape(found: re.Match[bytes]) -> bytes:
    escape = found[1]
    if escape is None or escape in (b"b", b"f", b"r"):
        return REPLACEMENT
    is_control = len(escape) > 1 and _CONTROL.match(chr(int(escape[1:], 16))) is not None
    return REPLACEMENT if is_control else found[0]


def terminal_json(value: Any) -> bytes:
    """Encode msgspec structs or plain data as JSON without characters that a terminal interprets."""
    # The images of a large manifest are a sequence that msgspec does not know.
    encoded = msgspec.json.encode(value, enc_hook=tuple)
    return _JSON_CONTROL.sub(lambda found: b"\\u%04x" % ord(found[0].decode()), encoded)


def pretty_json(value: Any) -> bytes:
    """Encode msgspec structs or plain data as indented JSON for people, one value per line."""
    return msgspec.json.format(terminal_json(value), indent=2)


@dataclass(frozen=True, slots=True)
class ProgressStep:
    """Progress of a computation: step `done` of `total`, and a description of the step."""

    done: int
    total: int
    text: str

    def __str__(self) -> str:
        """Return the line that programs print: [3/9] stereo cam00-cam01."""
        return f"[{self.done}/{self.total}] {self.text}"

    @classmethod
    def parse(cls, line: str) -> Self | None:
        """Parse a progress line such as `[3/9] stereo cam00-cam01`; return None for any other line."""
        match = _PROGRESS.match(line)
        return cls(int(match[1]), int(match[2]), match[3]) if match else None
