"""Labels that another file has for a recording's cameras: paired with them one to one, by whole names."""

import re
from collections.abc import Iterable, Mapping, Sequence

_GENERIC = {"", "c", "cam", "camera", "port", "device", "sensor", "video", "view"}
"""What stands before a number and names no camera: `0`, `port_0` and `cam_0` are the same one."""


def pair_labels(labels: Iterable[str], cameras: Sequence[str]) -> dict[str, str]:
    """Return the label of each camera that has one in a file, by camera.

    Equal names are paired first, then names that differ in letter case, in separators, in leading zeros or in
    a word such as `cam` before the number. Where no name is equal, `1` and `2` are gopro_1 and gopro_2 only
    if the numbers of the labels are those of the cameras, one to one.
    """
    left = list(dict.fromkeys(labels))
    pairs: dict[str, str] = {}
    for key in (str, str.casefold, _key):
        own, given = ({name: key(name) for name in names if name not in pairs} for names in (cameras, left))
        for name, of in own.items():
            same = [label for label in left if given[label] == of]
            if len(same) == 1 and sum(other == of for other in own.values()) == 1:
                pairs[name] = same[0]
        left = [label for label in left if label not in pairs.values()]
    return pairs or _by_number(left, cameras)


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


def describe_pairs(source: str, pairs: Mapping[str, str], labels: Iterable[str]) -> str:
    """Return which camera has which label of a file, and which labels have none; empty if all are equal."""
    unused = [label for label in dict.fromkeys(labels) if label not in pairs.values()]
    if not unused and all(name == label for name, label in pairs.items()):
        return ""
    text = ", ".join(f"{name} = {label}" for name, label in pairs.items())
    return f"cameras of {source}: {text}" + (f"; not used: {', '.join(unused)}" if unused else "")
