"""Results as people read them: with what their owners call the cameras in place of their names."""

from collections.abc import Mapping
from typing import Any

from msgspec import Struct, structs

ONE_CAMERA = ("camera", "reference", "other")
"""Fields of results whose text is the name of a camera; in lists and as keys it is recognized everywhere."""


def spoken(result: Any, labels: Mapping[str, str]) -> Any:
    """Return a result, or a part of one, in which cameras have their labels.

    `labels` is what people call cameras, by name. Only whole names are replaced; paths remain.
    """
    if isinstance(result, Struct):
        parts = ((name, getattr(result, name)) for name in result.__struct_fields__)
        named = (part for part in parts if part[0] in ONE_CAMERA or not isinstance(part[1], str))
        return structs.replace(result, **{name: spoken(field, labels) for name, field in named})
    if isinstance(result, dict):
        return {labels.get(key, key): spoken(part, labels) for key, part in result.items()}
    if isinstance(result, list | tuple):
        return type(result)(spoken(part, labels) for part in result)
    return labels.get(result, result) if isinstance(result, str) else result
