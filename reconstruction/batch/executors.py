"""Where a batch's units are worked on: processes of this machine.

Processes, not threads: native code that crashes takes one unit with it and no more.
"""

import os
import signal
import threading
from collections import deque
from collections.abc import Generator, Sequence
from contextlib import suppress
from importlib import import_module
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Protocol

from capture_app.errors import ExitCode
from reconstruction.batch.units import Outcome, Unit, perform

MEMORY_OF_UNIT = 1 << 30
"""Bytes that a unit of five pictures of 640x480 stays below."""


class Executor(Protocol):
    """Somebody who works on units and tells how each went, in the order in which they end."""

    def run(self, make: str, units: Sequence[Unit], root: Path) -> Generator[Outcome, None, None]:
        """Perform all units; closing the iterator early stops the work."""
        ...


class LocalExecutor:
    """Processes of this machine, each with its share of the cores."""

    def __init__(self, jobs: int | None = None) -> None:
        """`jobs`: how many at once; else as many as there are cores, and memory for."""
        self.cores = sorted(os.sched_getaffinity(0))
        self.jobs = jobs or max(1, min(len(self.cores), _free_memory() // MEMORY_OF_UNIT))

    def run(self, make: str, units: Sequence[Unit], root: Path) -> Generator[Outcome, None, None]:
        """Perform all units; a process that dies is a failed unit, and another takes its place."""
        left = deque(units)
        count = min(self.jobs, len(left))
        workers = [_Worker(make, root, self._share(k, count)) for k in range(count)]
        try:
            for worker in workers:
                worker.begin(left.popleft())
            while busy := [worker for worker in workers if worker.unit is not None]:
                ready = wait([worker.pipe for worker in busy])
                for k, worker in enumerate(workers):
                    if worker.pipe not in ready or worker.unit is None:
                        continue
                    yield worker.outcome()
                    if left:
                        if not worker.process.is_alive():
                            worker.stop()
                            worker = workers[k] = _Worker(make, root, self._share(k, count))
                        worker.begin(left.popleft())
        finally:
            for worker in workers:
                worker.stop()

    def _share(self, which: int, count: int) -> list[int]:
        return self.cores[which % len(self.cores) :: count] or self.cores


class _Worker:
    """One process and what it is at."""

    def __init__(self, make: str, root: Path, cores: list[int]) -> None:
        context = get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs, make, str(root), cores), daemon=True)
        self.process.start()
        theirs.close()
        self.unit: Unit | None = None

    def begin(self, unit: Unit) -> None:
        """Hand a unit over."""
        self.unit = unit
        # A process that is gone is seen when its answer is awaited.
        with suppress(OSError):
            self.pipe.send(unit)

    def outcome(self) -> Outcome:
        """Its answer, or that there is none."""
        assert self.unit is not None
        unit, self.unit = self.unit, None
        try:
            answer: Outcome = self.pipe.recv()
        except (EOFError, OSError):
            self.process.join()
            problem = f"its process ended with {_how(self.process.exitcode)}"
            return Outcome(key=unit.key, problem=problem, code=ExitCode.FAILURE)
        return answer

    def stop(self) -> None:
        """End the process, whatever it is at; what it was at is not there then."""
        self.process.kill()
        self.process.join()
        self.pipe.close()


def _serve(pipe: Connection, make: str, root: str, cores: list[int]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.sched_setaffinity(0, cores)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    # Before pycolmap: in the other order the first PNG that OpenCV writes aborts the process.
    import_module("cv2")
    with suppress(EOFError, OSError):
        while True:
            unit = pipe.recv()
            pipe.send(perform(make, unit, Path(root)))


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(ExitCode.FAILURE)


def _how(code: int | None) -> str:
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        return f"{name} (often too little memory; use fewer --jobs)" if name == "SIGKILL" else name
    return f"exit code {code}"


def _free_memory() -> int:
    """Bytes that programs can still have, by Linux's own estimate."""
    with suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) << 10
    return MEMORY_OF_UNIT
