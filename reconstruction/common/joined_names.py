"""Groups of cameras or pictures that pairs of them join."""

from collections.abc import Collection


def joined_to(name: str, pairs: Collection[tuple[str, str]]) -> set[str]:
    """Return the names that a chain of pairs joins to a name, including itself."""
    joined = {name}
    while more := {name for pair in pairs if joined & set(pair) for name in pair} - joined:
        joined |= more
    return joined
