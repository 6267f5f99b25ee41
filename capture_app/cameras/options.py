"""The options of a camera's spec, as drivers read them."""

import math
from collections.abc import Iterable, Mapping

from capture_app.errors import BadInputError


def refuse_unknown(options: Mapping[str, str], known: Iterable[str], camera: str) -> None:
    """Raise BadInputError for an option that is none of those known; `camera` says of what, as `a webcam`."""
    names = tuple(known)
    for key in options:
        if key not in names:
            raise BadInputError(f"{camera} has no option {key!r}", hint=f"there are {', '.join(names)}")


def read_number(
    options: Mapping[str, str], key: str, camera: str, *, least: float, most: float
) -> float | None:
    """Read an option that is a number within bounds; None where it is not given. Raises BadInputError."""
    text = options.get(key)
    if text is None:
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not least <= value <= most:
        raise BadInputError(
            f"{key}={text} of {camera}", hint=f"a number from {least:g} to {most:g} is needed"
        )
    return value
