"""Passwords of IP cameras, stored in the environment only, and never in process lists, logs or records."""

import os
import re
from hashlib import sha256
from urllib.parse import quote

VARIABLE = "SIMULSHOT_RTSP_PASSWORD"
"""Password of all cameras whose addresses have a user and no password."""
_WITH_PASSWORD = re.compile(
    r"((?:--camera=)?rtsp://)([^:@/]*):([^/]*|(?!\d*/|[\da-f:.]*\]).*)@(.*)", re.IGNORECASE
)
"""A password may contain an @. It may contain a / if no port precedes that and the path has no other @."""
_WITH_USER = re.compile(r"(rtsp://)([^:@/]+)@(.*)")


def hide_password(spec: str) -> str:
    """Return a camera's spec without its password, which moves to the environment of this process."""
    if (match := _WITH_PASSWORD.fullmatch(spec)) is None:
        return spec
    scheme, user, password, rest = match.groups()
    # Unescaped, these characters would hide the host behind them.
    os.environ[_variable(user, rest)] = re.sub("[/?#]", lambda match: quote(match[0], safe=""), password)
    return f"{scheme.lower()}{user}@{rest}"


def reveal_password(spec: str) -> str:
    """Return the spec with its stored password, for the code that opens the camera."""
    if (match := _WITH_USER.fullmatch(spec)) is None:
        return spec
    scheme, user, rest = match.groups()
    if (password := os.environ.get(_variable(user, rest))) is None:
        password = quote(os.environ.get(VARIABLE, ""), safe="")
    return f"{scheme}{user}:{password}@{rest}" if password else spec


def _variable(user: str, rest: str) -> str:
    host = re.split("[/,?]", rest, maxsplit=1)[0]
    return f"{VARIABLE}_{sha256(f'{user}@{host}'.encode()).hexdigest()[:16]}"
