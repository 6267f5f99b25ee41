"""Processes of this machine: their parents, and whether they still run."""

from contextlib import suppress
from pathlib import Path


def stat_of(pid: int) -> list[str]:
    """State, parent and what follows of a process. Raises OSError where there is none."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()


def children_of(parent: int) -> list[int]:
    """The processes that a process has started and that are still its own."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        with suppress(FileNotFoundError, ProcessLookupError):
            if int(stat_of(int(path.name))[1]) == parent:
                found.append(int(path.name))
    return found


def is_running(pid: int) -> bool:
    """Whether a process is there and no zombie that only waits to be noticed."""
    try:
        return stat_of(pid)[0] != "Z"
    except (ProcessLookupError, FileNotFoundError):
        return False
