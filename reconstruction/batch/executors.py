"""Run the units of a batch in processes of this machine.

Processes, not threads, so that a crash of native code costs one unit only.
"""

import os
import signal
import threading
from collections import deque
from collections.abc import Generator, Sequence
from contextlib import suppress
from importlib import import_module
from multiprocessing import get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Protocol

from capture_app.errors import ExitCode
from reconstruction.batch.units import Outcome, Unit, run_unit
from reconstruction.common.free_memory import free_memory
from reconstruction.common.memory_budget import (
    DEFAULT_SHARE,
    MOST_BY_DEFAULT,
    limited_memory,
    memory_budget,
)

MEMORY_OF_UNIT = 1 << 30
"""Bytes that a unit of five 640x480 images needs at most."""


class Executor(Protocol):
    """Runs units and yields their outcomes in the order in which they end."""

    def run_units(self, task: str, units: Sequence[Unit], root: Path) -> Generator[Outcome, None, None]:
        """Run all units; closing the iterator early stops them."""
        ...


class LocalExecutor:
    """Processes of this machine, each with its share of the cores."""

    def __init__(self, jobs: int | None = None) -> None:
        """`jobs`: how many at once, None = one per core as memory allows; they share the memory budget."""
        self.cores = sorted(os.sched_getaffinity(0))
        budget = memory_budget()
        total = budget.limit_bytes if budget.asked_for else int(DEFAULT_SHARE * free_memory())
        self.jobs = jobs or max(1, min(len(self.cores), total // MEMORY_OF_UNIT))
        most = total if budget.asked_for else MOST_BY_DEFAULT
        self.memory_each = min(total // self.jobs, most)

    def run_units(self, task: str, units: Sequence[Unit], root: Path) -> Generator[Outcome, None, None]:
        """Run all units; a process that dies is a failed unit and is replaced."""
        left = deque(units)
        count = min(self.jobs, len(left))
        workers = [_Worker(task, root, self._share(k, count), self.memory_each) for k in range(count)]
        try:
            for worker in workers:
                worker.start_unit(left.popleft())
            while busy := [worker for worker in workers if worker.unit is not None]:
                ready = wait([worker.pipe for worker in busy])
                for k, worker in enumerate(workers):
                    if worker.pipe not in ready or worker.unit is None:
                        continue
                    yield worker.receive_outcome()
                    if left:
                        if not worker.process.is_alive():
                            worker.stop()
                            worker = workers[k] = _Worker(task, root, self._share(k, count), self.memory_each)
                        worker.start_unit(left.popleft())
        finally:
            for worker in workers:
                worker.stop()

    def _share(self, which: int, count: int) -> list[int]:
        return self.cores[which % len(self.cores) :: count] or self.cores


class _Worker:
    """A process and the unit it runs."""

    def __init__(self, task: str, root: Path, cores: list[int], memory: int) -> None:
        context = get_context("spawn")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(
            target=_worker_main, args=(theirs, task, str(root), cores, memory), daemon=True
        )
        # A worker that is only starting would answer Ctrl-C, which is for this process, by a traceback.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        self.process.start()
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        theirs.close()
        self.unit: Unit | None = None

    def start_unit(self, unit: Unit) -> None:
        """Send a unit to the process."""
        self.unit = unit
        # A process that has died is noticed by receive_outcome.
        with suppress(OSError):
            self.pipe.send(unit)

    def receive_outcome(self) -> Outcome:
        """The outcome of its unit, a failure if the process has died."""
        assert self.unit is not None
        unit, self.unit = self.unit, None
        try:
            answer: Outcome = self.pipe.recv()
        except (EOFError, OSError):
            self.process.join()
            error = f"its process ended with {_describe_exit(self.process.exitcode)}"
            return Outcome(key=unit.key, error=error, exit_code=ExitCode.FAILURE)
        return answer

    def stop(self) -> None:
        """Kill the process; its unit leaves no result."""
        self.process.kill()
        self.process.join()
        self.pipe.close()


def _worker_main(pipe: Connection, task: str, root: str, cores: list[int], memory: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.sched_setaffinity(0, cores)
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    # Before pycolmap: in the other order the first PNG that OpenCV writes aborts the process.
    import_module("cv2")
    with suppress(EOFError, OSError):
        while True:
            unit = pipe.recv()
            with limited_memory(memory):
                outcome = run_unit(task, unit, Path(root))
            pipe.send(outcome)


def _exit_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(ExitCode.FAILURE)


def _describe_exit(code: int | None) -> str:
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        return f"{name} (often too little memory; use fewer --jobs)" if name == "SIGKILL" else name
    return f"exit code {code}"
