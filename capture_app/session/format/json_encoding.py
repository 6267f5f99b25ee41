"""Encodes records as JSON and checks that a reader accepts them."""

import msgspec

from capture_app.errors import BadInputError


def encode_checked(value: msgspec.Struct, kind: type[msgspec.Struct]) -> bytes:
    """Encode a struct. Raises BadInputError where its values break its schema: constructors check nothing."""
    data = msgspec.json.encode(value)
    try:
        msgspec.json.decode(data, type=kind)
    except msgspec.ValidationError as error:
        raise BadInputError(f"a {kind.__name__} that breaks its schema: {error}") from error
    return data


def indented(data: bytes) -> bytes:
    """Indent JSON, one value a line."""
    return msgspec.json.format(data, indent=1) + b"\n"
