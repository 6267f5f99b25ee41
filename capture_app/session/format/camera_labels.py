"""Labels that a person or another file has for a recording's cameras: of these, by whole names.

A camera is known by what its owner wrote, its label, and then by the name of its folder.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from unicodedata import normalize

from capture_app.common.errors import BadInputError
from capture_app.common.names import label_key

_GENERIC = {"", "c", "cam", "camera", "port", "device", "sensor", "video", "view"}
"""What stands before a number and names no camera: `0`, `port_0` and `cam_0` are the same one."""


def require_camera(text: str, cameras: Mapping[str, str], where: str) -> str:
    """Return the name of the camera that a person means, as `pair_labels`; `cameras` is labels by name.

    Raises BadInputError: `where` names none.
    """
    if not (pairs := pair_labels([text], cameras)):
        raise BadInputError(
            f"{where} names {text}, which the recording lacks", hint=f"it has {', '.join(cameras.values())}"
        )
    return next(iter(pairs))


def pair_labels(labels: Iterable[str], cameras: Sequence[str] | Mapping[str, str]) -> dict[str, str]:
    """Return the label of each camera that has one in a file, by the camera's name.

    `cameras`: their names, or what their owner calls each, by name; that is compared before the name.
    Equal names are paired first, then names that differ in letter case, in separators, in leading zeros or in
    a word such as `cam` before the number. Where no name is equal, `1` and `2` are gopro_1 and gopro_2 only
    if the labels' numbers equal the cameras', one to one.
    """
    left = list(dict.fromkeys(labels))
    pairs: dict[str, str] = {}
    names = {name: name for name in cameras}
    called_by = [cameras, names] if isinstance(cameras, Mapping) else [names]
    keys: Sequence[Callable[[str], object]] = (_same, label_key, _key)
    for key, called in product(keys, called_by):
        own = {name: key(label) for name, label in called.items() if name not in pairs}
        given = {label: key(label) for label in left}
        for name, mine in own.items():
            same = [label for label in left if given[label] == mine]
            if len(same) == 1 and sum(other == mine for other in own.values()) == 1:
                pairs[name] = same[0]
        left = [label for label in left if label not in pairs.values()]
    return pairs or _by_number(left, [*names])


def _same(label: str) -> str:
    return normalize("NFC", label)


def _key(name: str) -> tuple[str, int | None]:
    """Return a name's words without separators, and its last number."""
    head, number = re.fullmatch(r"(.*?)(\d*)", name.casefold(), re.DOTALL).groups()  # type: ignore[union-attr]
    plain = re.sub(r"[\s_.-]+", "", head)
    return ("" if plain in _GENERIC and number else plain), int(number) if number else None


def _by_number(labels: Sequence[str], cameras: Sequence[str]) -> dict[str, str]:
    named, numbered = ({_key(name)[1]: name for name in names} for names in (cameras, labels))
    plain = any(all(not _key(name)[0] for name in names) for names in (cameras, labels))
    one_to_one = named.keys() == numbered.keys() and len(named) == len(cameras) == len(labels)
    return {named[n]: label for n, label in numbered.items()} if plain and one_to_one else {}


def describe_pairs(
    source: str, pairs: Mapping[str, str], labels: Iterable[str], cameras: Mapping[str, str] | None = None
) -> str:
    """Return which camera has which label of a file, and which labels have none; empty if all are equal.

    `cameras` is what their owner calls them, by name.
    """
    unused = [label for label in dict.fromkeys(labels) if label not in pairs.values()]
    called = {(cameras or {}).get(name, name): label for name, label in pairs.items()}
    if not unused and all(_same(name) == _same(label) for name, label in called.items()):
        return ""
    text = ", ".join(f"{name} = {label}" for name, label in called.items())
    return f"cameras of {source}: {text}" + (f"; not used: {', '.join(unused)}" if unused else "")
