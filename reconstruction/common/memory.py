"""Cores and memory that a command may use for dense work; less memory reduces scale or parallelism.

A command sets the budget (`limited_memory`). Code that is about to use much memory asks `memory_budget()`
for the scale, or the number of parallel jobs, that fits. Changes due to the budget are noted, for the user
and the result.
"""

import mmap
import os
import re
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from capture_app.common import system
from capture_app.common.errors import BadInputError

if TYPE_CHECKING:
    from reconstruction.common.geometry import Array

T = TypeVar("T")
DEFAULT_FRACTION = 0.5
"""Fraction of the free memory at the start of a command that is the default budget."""
MAX_BY_DEFAULT = 3 << 30
"""Maximum default budget, bytes; results do not depend on the free memory above it."""
MIN_BYTES = 128 << 20
MEMORY = "SIMULSHOT_MEMORY"
"""Environment variable with a budget that is asked for, such as 800MB or 8GB."""
_UNITS = {"K": 1e3, "M": 1e6, "G": 1e9, "T": 1e12, "Ki": 2**10, "Mi": 2**20, "Gi": 2**30, "Ti": 2**40}


def free_memory() -> int:
    """Return the bytes that this process can still allocate."""
    return max(0, min(system.machine_memory(), _group_memory(), _process_memory()))


def _group_memory() -> int:
    """Return the control group's remaining memory, as in a container or SLURM job; cached files are free."""
    lowest = system.NO_LIMIT
    for limit, usage, root in (
        ("memory.max", "memory.current", Path("/sys/fs/cgroup")),
        ("memory.limit_in_bytes", "memory.usage_in_bytes", Path("/sys/fs/cgroup/memory")),
    ):
        for folder in _group_folders(root):
            with suppress(OSError, ValueError):
                used = int((folder / usage).read_text()) - _cached_files(folder / "memory.stat")
                lowest = min(lowest, int((folder / limit).read_text()) - used)
    return lowest


def _group_folders(root: Path) -> list[Path]:
    """Return the folders of this process's control group and of all its ancestors."""
    folders = [root]
    with suppress(OSError, IndexError):
        for line in Path("/proc/self/cgroup").read_text(encoding="utf-8").splitlines():
            _, kinds, path = line.split(":", 2)
            if kinds in ("", "memory"):
                own = root / path.strip("/")
                folders += [own, *(above for above in own.parents if above.is_relative_to(root))]
    return folders


def _cached_files(stat: Path) -> int:
    matched = re.search(r"^(?:total_)?inactive_file (\d+)", stat.read_text(encoding="utf-8"), re.MULTILINE)
    return int(matched[1]) if matched else 0


def _process_memory() -> int:
    limit = system.address_space()
    with suppress(OSError, ValueError, IndexError):
        return limit - int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[0]) * mmap.PAGESIZE
    return limit


class MemoryBudget:
    """Memory limit for the arrays of one command, and notes on what was reduced to meet it."""

    def __init__(self, limit_bytes: int, *, asked_for: bool = False) -> None:
        """`asked_for`: set by the user rather than derived from the free memory."""
        self.limit_bytes = max(int(limit_bytes), MIN_BYTES)
        self.asked_for = asked_for
        self._notes: dict[str, None] = {}
        self._reserved = 0
        self._freed = threading.Condition()

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on what was reduced to meet the budget; empty if nothing was."""
        return tuple(self._notes)

    def fit_scale(self, what: str, bytes_at: Callable[[float], float], *, fraction: float = 1.0) -> float:
        """Return the largest scale, at most 1, at which `what` fits into `fraction` of the budget.

        `bytes_at` returns the memory for a scale of the images' sides.

        Raises:
            BadInputError: even a sixteenth of its size takes more.
        """
        limit, scale = fraction * self.limit_bytes, 1.0
        while bytes_at(scale) > limit:
            scale *= 2**-0.25
            if scale < 1 / 16:
                raise BadInputError(
                    f"{what} takes {gigabytes(bytes_at(1.0))} of memory, and {gigabytes(limit)} may be used",
                    hint=f"give it more: {MEMORY}=8GB in the environment",
                )
        if scale < 1.0:
            self._notes[
                f"{what} is done at {100 * scale:.0f} % of the full size, which would take "
                f"{gigabytes(bytes_at(1.0))} of memory; {gigabytes(limit)} may be used ({MEMORY})"
            ] = None
        return scale

    def fit_count(self, bytes_each: float, max_count: int, *, fraction: float = 1.0) -> int:
        """Return how many items of `bytes_each` fit into `fraction` of the budget, from 1 to `max_count`."""
        return max(1, min(max_count, int(fraction * self.limit_bytes // max(bytes_each, 1.0))))

    @contextmanager
    def reserved(self, size: float) -> Iterator[None]:
        """Wait until so many bytes are not in use by other threads, or until none of them uses any.

        Threads that run side by side thus keep to the budget together. A thread reserves once at a time.
        """
        with self._freed:
            self._freed.wait_for(lambda: not self._reserved or self._reserved + size <= self.limit_bytes)
            self._reserved += int(size)
        try:
            yield
        finally:
            with self._freed:
                self._reserved -= int(size)
                self._freed.notify_all()


def memory_budget() -> MemoryBudget:
    """Return the running command's or session's budget; outside of both, the default one."""
    return _budget.get(None) or _new_budget()


def limited_memory(limit_bytes: int | None = None) -> AbstractContextManager[MemoryBudget]:
    """Set the budget for code in this context; None = the default one."""
    return running(_budget, _new_budget(limit_bytes))


def _new_budget(asked: int | None = None) -> MemoryBudget:
    """Return a budget: that asked for here or by `MEMORY`, else half of the free memory, within limits."""
    if asked is None and (text := os.environ.get(MEMORY)):
        asked = parse_size(text)
    free = min(int(DEFAULT_FRACTION * free_memory()), MAX_BY_DEFAULT)
    return MemoryBudget(free if asked is None else asked, asked_for=asked is not None)


_budget: ContextVar[MemoryBudget] = ContextVar("budget")


@contextmanager
def running(variable: ContextVar[T], value: T) -> Iterator[T]:
    """Set a context variable inside the `with` block; `worker_pool` passes it on to its threads."""
    token = variable.set(value)
    try:
        yield value
    finally:
        variable.reset(token)


def parse_size(text: str) -> int:
    """Parse a size such as 800MB, 4G or 2GiB into bytes.

    Raises:
        BadInputError: it is not a size.
    """
    if (matched := re.fullmatch(r"\s*(\d+(?:\.\d+)?)\s*([KMGT]i?)B?\s*", text)) is None:
        raise BadInputError(f"{text!r} is not a size of memory", hint=f"{MEMORY}=800MB, or 4GB")
    return int(float(matched[1]) * _UNITS[matched[2]])


def gigabytes(size: float) -> str:
    """Format a size in bytes, as in 850 MB or 20.9 GB."""
    return f"{size / 1e6:.0f} MB" if size < 1e9 else f"{size / 1e9:.1f} GB"


class ByteCache:
    """A function from keys to arrays with a least-recently-used cache limited in bytes."""

    def __init__(self, make: "Callable[..., Array]", limit_bytes: int) -> None:
        self._make = make
        self._limit_bytes = limit_bytes
        self._bytes = 0
        self._cached: OrderedDict[tuple[Hashable, ...], Array] = OrderedDict()
        self._lock = threading.Lock()

    def __call__(self, *key: Hashable) -> "Array":
        """Return the array of a key, cached or computed."""
        with self._lock:
            if key in self._cached:
                self._cached.move_to_end(key)
                return self._cached[key]
        made = self._make(*key)
        with self._lock:
            if key not in self._cached:
                self._cached[key] = made
                self._bytes += made.nbytes
            # The newest stays whatever its size: it is requested again at once.
            while self._bytes > self._limit_bytes and len(self._cached) > 1:
                _, dropped = self._cached.popitem(last=False)
                self._bytes -= dropped.nbytes
        return made
