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
__all__ = (  # noqa: F405 - the modules have them
    "NO_LIMIT",
    "PYTHON",
    "address_space",
    "allow_open_files",
    "child_options",
    "end_as_interrupt",
    "end_group",
    "end_with_parent",
    "exchange",
    "flock",
    "hold_name",
    "interrupts_blocked",
    "is_running",
    "kill_group",
    "lower_priority",
    "machine_memory",
    "monotonic_ns",
    "monotonic_s",
    "move_new",
    "new_event_loop",
    "on_end",
    "on_interrupt",
    "open_file",
    "open_folder",
    "pause_group",
    "raise_thread_priority",
    "read_at",
    "receive_datagrams",
    "replace",
    "resume_group",
    "saves_power",
    "share_heaps",
    "sync_data",
    "sync_path",
    "usable_cores",
    "use_cores",
    "watch_input",
)
# fmt: on
