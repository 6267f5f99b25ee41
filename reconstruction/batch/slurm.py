"""Run the units of a batch as jobs of a SLURM cluster, through submitit.

The cluster must see this machine's folders and Python under the same paths. Jobs outlive the command that
submitted them: the number of each unit's job is kept in a file, and a repeated command waits for that job.
"""

import subprocess
import time
from collections.abc import Generator, Mapping, Sequence
from contextlib import redirect_stderr, suppress
from functools import partial
from importlib import import_module
from io import StringIO
from pathlib import Path
from typing import Any

import msgspec

from capture_app.errors import BadInputError, ExitCode, NotAvailableError, SimulshotError
from capture_app.optional_packages import load_optional
from capture_app.session.files.durable import write_atomic_unsynced
from reconstruction.batch.units import WORK, Outcome, Unit, run_unit

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
                    write_atomic_unsynced(_job_file(folder, unit), f"{job.job_id}\n".encode())
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
            raise BadInputError(f"--slurm: {_first_line(error)}") from error
        except (self.submitit.core.utils.FailedJobError, subprocess.CalledProcessError, OSError) as error:
            raise SimulshotError(
                f"SLURM refused the jobs: {_first_line(error)}", hint="check sinfo and the --slurm settings"
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
    return Outcome(key=key, error=_first_line(error), exit_code=ExitCode.FAILURE)


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
        f"SLURM does not answer: {_first_line(asked.stderr)}",
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


def _first_line(error: object) -> str:
    lines = [line for line in str(error).splitlines() if line.strip()]
    return lines[0].strip() if lines else type(error).__name__
