"""Run the units of a batch: in processes of this machine, or as jobs of a SLURM cluster through submitit.

Processes, not threads, so that a crash of native code costs one unit only. A cluster must see this
machine's folders and Python under the same paths; its jobs outlive the command that submitted them, so each
unit's job number is kept in a file, and a repeated command waits for that job.
"""

import os
import signal
import subprocess
import threading
import time
from collections import deque
from collections.abc import Generator, Mapping, Sequence
from contextlib import redirect_stderr, suppress
from functools import partial
from importlib import import_module
from io import StringIO
from multiprocessing import get_context, parent_process, resource_tracker
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any, Protocol

import msgspec

from capture_app.common.errors import BadInputError, ExitCode, NotAvailableError, SimulshotError
from capture_app.common.optional_packages import load_optional
from capture_app.common.text import first_line
from capture_app.session.files.durable import write_atomic
from reconstruction.batch.units import WORK, Outcome, Unit, run_unit
from reconstruction.common.memory import (
    DEFAULT_SHARE,
    MOST_BY_DEFAULT,
    free_memory,
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


POLL_S = 1.0
LARGEST_ARRAY = 500
"""Jobs in one array; SLURM refuses more than 1001 where nobody set another limit."""
DEFAULTS: Mapping[str, Any] = {"cpus_per_task": 1, "time": 60, "mem": "2GB"}


class SlurmExecutor:
    """Jobs of the cluster that this machine belongs to, by its commands `sbatch` and `squeue`."""

    def __init__(self, jobs: int | None = None, settings: Sequence[str] = ()) -> None:
        """`jobs`: how many at once; `settings`: `name=value` as submitit names them, `partition=gpu`.

        Raises:
            NotAvailableError: submitit is not installed, or SLURM's commands are not on this machine.
            BadInputError: a setting is not `name=value`.
        """
        self.submitit: Any = load_optional("submitit", "slurm", "SLURM")
        self.settings = {**DEFAULTS, **dict(map(_setting, settings))}
        if jobs:
            self.settings["array_parallelism"] = jobs
        _squeue()

    def run_units(self, task: str, units: Sequence[Unit], root: Path) -> Generator[Outcome, None, None]:
        """Run all units as jobs; closing the iterator early cancels them."""
        folder = root / WORK / "slurm"
        folder.mkdir(parents=True, exist_ok=True)
        alive = _squeue()
        jobs = {}
        for unit in units:
            with suppress(FileNotFoundError):
                number = _job_file(folder, unit).read_text().strip()
                if number in alive:
                    jobs[unit.key] = self.submitit.SlurmJob(folder=folder, job_id=number, tasks=(0,))
        new = [unit for unit in units if unit.key not in jobs]
        try:
            for first in range(0, len(new), LARGEST_ARRAY):
                some = new[first : first + LARGEST_ARRAY]
                for unit, job in zip(some, self._submit(task, some, root, folder), strict=True):
                    jobs[unit.key] = job
                    write_atomic(_job_file(folder, unit), f"{job.job_id}\n".encode())
            yield from _wait_for(jobs)
        finally:
            _cancel([job.job_id for job in jobs.values()])

    def _submit(self, task: str, units: Sequence[Unit], root: Path, folder: Path) -> list[Any]:
        executor = self.submitit.SlurmExecutor(folder=folder, max_num_timeout=0)
        try:
            executor.update_parameters(job_name="simulshot", **self.settings)
            # The error holds the message of sbatch too.
            with redirect_stderr(StringIO()):
                submitted: list[Any] = executor.map_array(partial(_run_in_job, task, str(root)), units)
        except (ValueError, TypeError) as error:
            raise BadInputError(f"--slurm: {first_line(error)}") from error
        except (self.submitit.core.utils.FailedJobError, subprocess.CalledProcessError, OSError) as error:
            raise SimulshotError(
                f"SLURM refused the jobs: {first_line(error)}", hint="check sinfo and the --slurm settings"
            ) from error
        return submitted


def _run_in_job(task: str, root: str, unit: Unit) -> Outcome:
    # Before pycolmap: in the other order the first PNG that OpenCV writes aborts the process.
    import_module("cv2")
    return run_unit(task, unit, Path(root))


def _wait_for(jobs: dict[str, Any]) -> Generator[Outcome, None, None]:
    """Yield each job's outcome and take it out of `jobs`.

    A job that has left the queue without a result has died. The queue is asked since only clusters with
    accounting can tell how a job ended.
    """
    missing: set[str] = set()
    while jobs:
        alive = _squeue()
        for key, job in list(jobs.items()):
            if job.paths.result_pickle.exists():
                yield _outcome(key, job)
            elif job.job_id in alive:
                missing.discard(key)
                continue
            elif key not in missing:
                # A network file system may show the result a little later.
                missing.add(key)
                continue
            else:
                error = f"its SLURM job {job.job_id} ended without a result; see {job.paths.stderr}"
                yield Outcome(key=key, error=error, exit_code=ExitCode.FAILURE)
            del jobs[key]
        if jobs:
            time.sleep(POLL_S)


def _outcome(key: str, job: Any) -> Outcome:
    error = job.exception()
    if error is None:
        outcome: Outcome = job.result()
        return outcome
    return Outcome(key=key, error=first_line(error), exit_code=ExitCode.FAILURE)


def _squeue() -> set[str]:
    """Numbers of the user's jobs that wait or run; those of an array one by one (`12_3`).

    Raises:
        NotAvailableError: SLURM is not on this machine, or does not answer.
    """
    command = ["squeue", "--me", "--noheader", "--array", "--format=%i"]
    for _ in range(30):
        try:
            asked = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
        except FileNotFoundError as error:
            raise NotAvailableError(
                "SLURM's command squeue is not on this machine",
                hint="run on a login node of the cluster, or use --executor local",
            ) from error
        if asked.returncode == 0:
            return set(asked.stdout.split())
        time.sleep(POLL_S)
    raise NotAvailableError(
        f"SLURM does not answer: {first_line(asked.stderr)}",
        hint="its jobs continue; repeat the command later",
    )


def _cancel(numbers: Sequence[str]) -> None:
    with suppress(OSError):
        if numbers:
            subprocess.run(["scancel", *numbers], capture_output=True, check=False)  # noqa: S603, S607


def _job_file(folder: Path, unit: Unit) -> Path:
    return folder / f"{unit.key}.job"


def _setting(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not name or not equals:
        raise BadInputError(f"{text!r} is not a SLURM setting", hint="write name=value, as in partition=gpu")
    with suppress(msgspec.DecodeError):
        return name, msgspec.json.decode(value)
    return name, value
