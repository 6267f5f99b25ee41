"""The operating system: what simulshot asks of Linux, macOS or Windows where Python itself differs.

Each module beside this one offers the same functions. Nothing outside this folder calls `fcntl`, `os.kill`,
`os.open` and the like: ruff's list of banned names in pyproject.toml says which. Python's paths, sockets,
TLS and threads behave alike everywhere.

They are listed below by subject: clock, files, locks, datagrams, input and signals, processes, limits,
network.
"""

import sys

if sys.platform == "win32":
    from capture_app.common.system.windows import *  # noqa: F403
elif sys.platform == "darwin":
    from capture_app.common.system.macos import *  # noqa: F403
else:
    from capture_app.common.system.linux import *  # noqa: F403

# fmt: off
__all__ = (  # noqa: F405, RUF022 - the modules have them; by subject
    "monotonic_ns", "monotonic_s", "asleep_ns", "new_event_loop",
    "open_file", "open_folder", "path_of", "read_at", "sync_data", "sync_path",
    "replace", "exchange", "move_new",
    "flock", "hold_name",
    "receive_datagrams",
    "watch_input", "on_end", "on_interrupt", "end_as_interrupt", "interrupts_blocked",
    "PYTHON", "child_options", "is_running", "signal_group", "end_with_parent", "lower_priority",
    "raise_thread_priority",
    "usable_cores", "use_cores", "machine_memory", "address_space", "NO_LIMIT", "allow_open_files",
    "limit_heaps", "reuse_freed_memory",
    "saves_power",
)
# fmt: on
