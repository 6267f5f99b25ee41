"""Numbers in the names of images: which of them count the frames."""

import re
from collections.abc import Mapping, Sequence
from itertools import combinations

Numbers = tuple[int, ...]
"""All numbers in a name, in order."""


def numbers_in(name: str) -> Numbers:
    """Return the numbers in a name."""
    return tuple(map(int, re.findall(r"\d+", name)))


def frame_numbers(cameras: Mapping[str, Sequence[Numbers]]) -> dict[str, Sequence[int]] | None:
    """Return the frames' numbers by camera, given the numbers in their names; None if none counts frames.

    A number that is the same in all names of each camera does not count, such as a size. If several change,
    as hours and seconds do, frames are numbered by the order of all of them; if no two cameras then share a
    frame, by the one that two cameras share.
    """
    lengths = {name: {len(name) for name in names} for name, names in cameras.items()}
    if any(len(length) != 1 for length in lengths.values()):
        return None
    changing = {
        name: [k for k, values in enumerate(zip(*names, strict=True)) if len(set(values)) > 1]
        for name, names in cameras.items()
    }
    if len(set.union(*lengths.values())) == 1:
        together = sorted(set().union(*changing.values()))
        changing = dict.fromkeys(cameras, together)
    (width, *others) = {len(columns) for columns in changing.values()}
    if others or not width:
        return None
    kept = {name: [tuple(of[k] for k in changing[name]) for of in names] for name, names in cameras.items()}
    single: list[dict[str, list[Numbers]]] = [
        {name: [(name[k],) for name in names] for name, names in kept.items()} for k in range(width)
    ]
    alone = len(kept) == 1 or _shared(kept)
    tried = [kept] if alone else [digits for digits in single if _shared(digits)] or [kept]
    usable = [trial for trial in tried if all(len(set(names)) == len(names) for names in trial.values())]
    if len(usable) != 1:
        return None
    (kept,) = usable
    if all(len(name) == 1 for names in kept.values() for name in names):
        return {name: [number for (number,) in names] for name, names in kept.items()}
    order = {word: n for n, word in enumerate(sorted(set().union(*kept.values())))}
    return {name: [order[name] for name in names] for name, names in kept.items()}


def _shared(cameras: Mapping[str, Sequence[Numbers]]) -> bool:
    return any(set(first) & set(other) for first, other in combinations(cameras.values(), 2))
