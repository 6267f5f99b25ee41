"""How much memory this process can still take: of the machine, its control group and its own limit."""

import os
import resource
from contextlib import suppress
from pathlib import Path

_UNLIMITED = 1 << 62


def free_memory() -> int:
    """Bytes that this process can still take."""
    return max(0, min(_machine_memory(), _group_memory(), _process_memory()))


def _machine_memory() -> int:
    with suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) << 10
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2


def _group_memory() -> int:
    """What the control group has left, as in a container or a SLURM job; files in the cache count as free."""
    least = _UNLIMITED
    for limit, usage, root in (
        ("memory.max", "memory.current", Path("/sys/fs/cgroup")),
        ("memory.limit_in_bytes", "memory.usage_in_bytes", Path("/sys/fs/cgroup/memory")),
    ):
        for folder in _group_folders(root):
            with suppress(OSError, ValueError):
                used = int((folder / usage).read_text()) - _cached_files(folder / "memory.stat")
                least = min(least, int((folder / limit).read_text()) - used)
    return least


def _group_folders(root: Path) -> list[Path]:
    """The folder of this process's control group, and of all those above it."""
    folders = [root]
    with suppress(OSError, IndexError):
        for line in Path("/proc/self/cgroup").read_text().splitlines():
            _, kinds, path = line.split(":", 2)
            if kinds in ("", "memory"):
                own = root / path.strip("/")
                folders += [own, *(above for above in own.parents if above.is_relative_to(root))]
    return folders


def _cached_files(stat: Path) -> int:
    for line in stat.read_text().splitlines():
        name, _, value = line.partition(" ")
        if name in ("inactive_file", "total_inactive_file"):
            return int(value)
    return 0


def _process_memory() -> int:
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit == resource.RLIM_INFINITY:
        return _UNLIMITED
    with suppress(OSError, ValueError, IndexError):
        used = int(Path("/proc/self/statm").read_text().split()[0])
        return limit - used * resource.getpagesize()
    return limit
