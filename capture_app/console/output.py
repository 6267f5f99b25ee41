"""Non-blocking output of long-running processes: no write waits for the reader.

A pipe without a reader, a pager or a suspended terminal would block a write. Output waits in a queue for a
thread of its own. Lines that exceed the queue are dropped, and their number is printed when reading resumes.
"""

import contextlib
import io
import logging
import os
import stat
import sys
import threading
from collections import deque
from typing import Any, cast

MAX_BYTES = 1 << 16
"""Maximum size of the queue, in bytes."""
LAST_S = 1.0
"""Time for which the end of a process waits for the reader."""


class PatientOutput(io.RawIOBase):
    """Replacement for a stream's file: accepts all data at once, and writes it in a thread."""

    def __init__(self, handle: int, max_bytes: int = MAX_BYTES) -> None:
        self._handle, self._max_bytes = handle, max_bytes
        self._queue: deque[bytes] = deque()
        self._waiting = self._left_out = 0
        self._in_json = False
        self._error: OSError | None = None
        self._changed = threading.Condition()
        threading.Thread(target=self._write_all, name="output", daemon=True).start()

    def writable(self) -> bool:
        """Return True: a raw file for output must be writable."""
        return True

    def fileno(self) -> int:
        """Return the file descriptor of the stream."""
        return self._handle

    def isatty(self) -> bool:
        """Whether the stream is a terminal."""
        return os.isatty(self._handle)

    def write(self, data: Any) -> int:
        """Queue lines, or drop them if the queue is full. Raises OSError once the reader has closed it."""
        lines = bytes(data)
        with self._changed:
            if self._error is not None:
                raise self._error
            # A line may come in two writes, of which the second one is its end alone.
            self._in_json |= lines.startswith(b"{")
            # A returning reader gets the notice first, and then the following lines without a gap.
            room = self._max_bytes // 2 if self._left_out else self._max_bytes
            if self._waiting and self._waiting + len(lines) > room:
                self._left_out += lines.count(b"\n")
            else:
                self._add(self._take_notice())
                self._add(lines)
                self._changed.notify_all()
        return len(lines)

    def finish(self, within_s: float = LAST_S) -> None:
        """Wait until all queued data is written, at most `within_s` seconds."""
        with self._changed:
            self._changed.wait_for(lambda: not self._waiting or self._error is not None, within_s)

    def _add(self, lines: bytes) -> None:
        if lines:
            self._queue.append(lines)
            self._waiting += len(lines)

    def _take_notice(self) -> bytes:
        count, self._left_out = self._left_out, 0
        as_json = b'{"event":"left-out","lines":%d}\n'
        as_text = b"(%d lines were left out here: they were not read in time)\n"
        return (as_json if self._in_json else as_text) % count if count else b""

    def _write_all(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._queue)
                lines = self._queue.popleft()
            try:
                left = memoryview(lines)
                while left:
                    left = left[os.write(self._handle, left) :]
            except OSError as error:
                with self._changed:
                    self._error = error
                    self._changed.notify_all()
                return
            with self._changed:
                self._waiting -= len(lines)
                if not self._queue:
                    self._add(self._take_notice())
                self._changed.notify_all()


_before: dict[str, tuple[io.TextIOWrapper, PatientOutput]] = {}


def wait_for_no_reader() -> None:
    """Make writes and logging to stdout and stderr non-blocking until `finish_output`."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        with contextlib.suppress(OSError, ValueError):
            if name in _before or not isinstance(stream, io.TextIOWrapper):
                continue
            if stat.S_ISREG(os.fstat(stream.fileno()).st_mode):
                continue  # a file never blocks
            stream.flush()
            output = PatientOutput(stream.fileno())
            _before[name] = stream, output
            _put(
                name, io.TextIOWrapper(cast(Any, output), stream.encoding, stream.errors, write_through=True)
            )


def finish_output() -> None:
    """Give the reader a moment to read the queued output, and make writes blocking again."""
    for name, (stream, output) in tuple(_before.items()):
        output.finish()
        _put(name, stream)
    _before.clear()


def _put(name: str, stream: io.TextIOWrapper) -> None:
    was = getattr(sys, name)
    setattr(sys, name, stream)
    for handler in logging.getLogger().handlers:
        if isinstance(handler, logging.StreamHandler) and handler.stream is was:
            handler.setStream(stream)
