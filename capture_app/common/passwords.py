"""Passwords of IP cameras: kept in the environment, and in no list of processes, log or record."""

import os
import re
from hashlib import sha256
from urllib.parse import quote

VARIABLE = "SIMULSHOT_RTSP_PASSWORD"
"""The password of all cameras whose addresses name a user and no password."""
_WITH_PASSWORD = re.compile(
    r"((?:--camera=)?rtsp://)([^:@/]*):([^/]*|(?!\d*/|[\da-f:.]*\]).*)@(.*)", re.IGNORECASE
)
"""A password may hold an @; also a /, where no port stands before that and the path has no other @."""
_WITH_USER = re.compile(r"(rtsp://)([^:@/]+)@(.*)")


def hide_password(spec: str) -> str:
    """Return a camera's spec without its password, which this process and its children keep."""
    found = _WITH_PASSWORD.fullmatch(spec)
    if found is None:
        return spec
    scheme, user, password, rest = found.groups()
    # Nobody would find the host behind it as it is.
    os.environ[_variable(user, rest)] = re.sub("[/?#]", lambda found: quote(found[0], safe=""), password)
    return f"{scheme.lower()}{user}@{rest}"


def reveal_password(spec: str) -> str:
    """Return the spec with the password that is known for it, for who must have it."""
    found = _WITH_USER.fullmatch(spec)
    if found is None:
        return spec
    scheme, user, rest = found.groups()
    password = os.environ.get(_variable(user, rest))
    if password is None:
        password = quote(os.environ.get(VARIABLE, ""), safe="")
    return f"{scheme}{user}:{password}@{rest}" if password else spec


def _variable(user: str, rest: str) -> str:
    host = re.split("[/,?]", rest, maxsplit=1)[0]
    return f"{VARIABLE}_{sha256(f'{user}@{host}'.encode()).hexdigest()[:16]}"
