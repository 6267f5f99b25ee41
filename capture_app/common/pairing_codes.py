"""Roles, pins and one-time codes, which people read, compare and type to pair machines."""

import base64
import hashlib
import re
from enum import StrEnum

from capture_app.common.errors import BadInputError

CODE_DIGITS = 8
SHOW_CODE = "on the leader's machine, capture-app trust invite shows one"
PIN_BYTES, PIN_GROUP = 20, 4
"""Length and grouping of a pin: no one can forge a certificate with the same first 160 bits of SHA-256."""
_NOT_IN_PIN = re.compile(r"[^a-z2-7]")


class Role(StrEnum):
    """Role of a machine: what it may do here."""

    CAMERA = "camera"
    """Join as a camera, and send its own images."""
    OPERATOR = "operator"
    """View the rig and control it."""
    RELAY = "relay"
    """Speak for cameras and operators that it knows."""
    LEADER = "leader"
    """Lead cameras of this machine, or answer operators here."""
    STANDBY = "standby"
    """Replace a lost leader: it receives the known machines in advance, and nodes follow it."""


def parse_code(text: str) -> str:
    """Parse a one-time code as typed or pasted. Raises BadInputError."""
    digits = re.sub(r"[\s-]", "", text)
    if not re.fullmatch(rf"[0-9]{{{CODE_DIGITS}}}", digits):
        raise BadInputError(f"{text!r} is not a code", hint=f"a code has {CODE_DIGITS} digits; {SHOW_CODE}")
    return digits


def show_code(code: str) -> str:
    """Format a one-time code for reading aloud: 1234 5678."""
    return f"{code[: CODE_DIGITS // 2]} {code[CODE_DIGITS // 2 :]}"


def pin_of(certificate: bytes) -> str:
    """Return the pin of a certificate (DER): the first 160 bits of its SHA-256 in base32, in groups."""
    return _grouped(base64.b32encode(hashlib.sha256(certificate).digest()[:PIN_BYTES]).decode().lower())


def parse_pin(text: str) -> str:
    """Parse a pin as pasted or typed, with or without groups. Raises BadInputError."""
    letters = re.sub(r"[\s-]", "", text.lower())
    if len(letters) != PIN_BYTES * 8 // 5 or _NOT_IN_PIN.search(letters):
        raise BadInputError(
            f"{text!r} is not a pin", hint="a pin is 32 letters and digits: capture-app trust list shows it"
        )
    return _grouped(letters)


def _grouped(text: str) -> str:
    return "-".join(text[at : at + PIN_GROUP] for at in range(0, len(text), PIN_GROUP))
