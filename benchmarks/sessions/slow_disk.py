"""A stand-in for a slow disk: every sync of a process takes longer, and is counted."""

import os
import threading
import time
from collections.abc import Callable

Sync = Callable[[int], None]


class SlowDisk:
    """Each `os.fsync` and `os.fdatasync` of this process takes `sync_ms` longer, and is counted.

    Syncs that are made at the same time take no longer together than one: a file system writes its journal
    once for all that wait for it. With `one_by_one` they do.
    """

    def __init__(self, sync_ms: float, *, one_by_one: bool = False) -> None:
        self.syncs = 0
        self._sync_s = sync_ms / 1000
        self._turn = threading.Lock() if one_by_one else None
        self._counting = threading.Lock()
        os.fsync, os.fdatasync = self._slowed(os.fsync), self._slowed(os.fdatasync)  # type: ignore[assignment]

    def _slowed(self, sync: Sync) -> Sync:
        def slow_sync(handle: int) -> None:
            with self._counting:
                self.syncs += 1
            if self._turn is None:
                time.sleep(self._sync_s)
            else:
                with self._turn:
                    time.sleep(self._sync_s)
            sync(handle)

        return slow_sync
