"""What macOS and Windows lack, and simulshot does without."""

from pathlib import Path


def exchange(path: Path, other: Path) -> bool:
    """Return False: two folders are swapped by three renames."""
    return False


def raise_thread_priority() -> None:
    """Do nothing: macOS ranks processes only, and Windows hurries threads that have waited."""


def limit_heaps(heaps: int) -> None:
    """Do nothing: all threads share one heap."""


def reuse_freed_memory() -> None:
    """Do nothing: another allocator than glibc's decides by itself what it returns."""


def saves_power(interface: str) -> bool | None:
    """Return None: whether a WiFi interface saves power is not reported."""
    return None
