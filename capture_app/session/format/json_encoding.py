"""Records as JSON, proven to be what a reader will take."""

import msgspec

from capture_app.errors import BadInputError


def encode_checked(value: msgspec.Struct, kind: type[msgspec.Struct]) -> bytes:
    """Encode a struct; raises BadInputError where no reader would accept it: constructors check nothing."""
    data = msgspec.json.encode(value)
    try:
        msgspec.json.decode(data, type=kind)
    except msgspec.ValidationError as error:
        raise BadInputError(f"a {kind.__name__} that no reader would accept: {error}") from error
    return data


def indented(data: bytes) -> bytes:
    """Lay JSON out for people, one value a line."""
    return msgspec.json.format(data, indent=1) + b"\n"
