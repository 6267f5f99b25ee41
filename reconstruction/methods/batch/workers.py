"""Workers of a batch: local processes, jobs of a cluster, or the workers of a Dask scheduler.

Workers are processes, not threads, so that a crash in native code costs only one unit. Any client of a Dask
scheduler can run code through it, so the schedulers started here use TLS with keys made for the run.
"""

import logging
import shutil
import signal
from collections.abc import Generator, Mapping, Sequence
from contextlib import ExitStack, suppress
from importlib import import_module
from itertools import islice
from multiprocessing import resource_tracker
from pathlib import Path
from typing import Any, cast

import msgspec

from capture_app.common import system
from capture_app.common.errors import BadInputError, ExitCode, NotAvailableError, SimulshotError
from capture_app.common.optional_packages import RECONSTRUCTION, load_optional
from capture_app.common.text import first_line
from capture_app.console.terminal import talk
from reconstruction.common.memory import (
    DEFAULT_FRACTION,
    MAX_BY_DEFAULT,
    free_memory,
    limited_memory,
    memory_budget,
)
from reconstruction.methods.batch.units import WORK, Outcome, Unit, run_unit

LOCAL = "local"
QUEUES = {
    "slurm": "SLURMCluster", "pbs": "PBSCluster", "lsf": "LSFCluster", "sge": "SGECluster",
    "oar": "OARCluster", "moab": "MoabCluster", "htcondor": "HTCondorCluster",
}  # fmt: skip
"""Queueing systems, each with its class in dask-jobqueue."""
MEMORY_OF_UNIT = 1 << 30
"""Maximum memory in bytes of a unit with five 640x480 images."""
MAX_QUEUED_JOBS = 100
"""Jobs in the cluster's queue if `--jobs` is not given."""
CONNECT_S, START_S = 5, 120
"""Timeout for a scheduler at an address, and for one that is started here, on a busy machine, too."""
NO_DASHBOARD = "127.0.0.1:0"
SETTINGS: Mapping[str, Any] = {"cores": 1, "memory": "2GB"}
CONFIGURATION: Mapping[str, Any] = {
    # A worker's job may time out or run short of memory: a single death does not prove a crash.
    "distributed.scheduler.allowed-failures": 1,
    # A unit may block the interpreter for minutes, and a suspended computer may resume.
    "distributed.scheduler.worker-ttl": None,
    # Dask's default of one OpenMP thread would leave cores idle; workers are bound to cores instead.
    "distributed.nanny.pre-spawn-environ": {},
    # Nothing is served over HTTP, which has no keys.
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}


class Workers:
    """Place in which a batch's units are computed, and the number computed at once."""

    def __init__(self, where: str = LOCAL, jobs: int | None = None, settings: Sequence[str] = ()) -> None:
        """Choose the workers.

        `where` is `local`, one of `QUEUES`, or a Dask scheduler's address. `jobs` is the number of units at
        once; None = one per core as memory permits, one per unit in a queue. `settings` are `name=value`
        options of a queue's jobs, named as in dask-jobqueue.

        Raises:
            NotAvailableError: Dask is not installed, or the queue's commands are not on this machine.
            BadInputError: `where` is unknown, or a setting is not `name=value`.
        """
        if where not in (LOCAL, *QUEUES) and "://" not in where:
            raise BadInputError(
                f"{where!r} is not a cluster",
                hint=f"use {', '.join((LOCAL, *QUEUES))}, or a Dask scheduler's address as in tcp://host:8786",
            )
        if settings and where not in QUEUES:
            raise BadInputError(
                "--cluster-setting applies to the jobs of a queue only",
                hint="leave it out, or add --cluster slurm",
            )
        self.dask = load_optional("distributed", RECONSTRUCTION, "a batch")
        self.where, self.jobs = where, jobs
        self.settings = {**SETTINGS, **dict(map(_parse_setting, settings))}
        if where in QUEUES:
            # Importing it makes Ctrl-C end the process with a success code, and writes a file beside the
            # user's settings, unless the place of these is a file.
            on_interrupt, config = signal.getsignal(signal.SIGINT), import_module("dask").config
            place, config.PATH = config.PATH, __file__
            try:
                queues = load_optional("dask_jobqueue", "cluster", f"--cluster {where}")
            finally:
                config.PATH = place
            signal.signal(signal.SIGINT, on_interrupt)
            self.queue = getattr(queues, QUEUES[where])
            if shutil.which(program := self.queue.job_cls.submit_command.split()[0]) is None:
                raise NotAvailableError(
                    f"the command {program} is not on this machine",
                    hint="run on a login node of the cluster, or use --cluster local",
                )

    def run_units(self, task: str, units: Sequence[Unit], root: Path) -> Generator[Outcome, None, None]:
        """Run the units, and yield each outcome as it arrives; closing the generator early stops them.

        Raises:
            SimulshotError: the queue refuses the jobs, or the scheduler cannot be reached.
        """
        if not units:
            return
        # Its log is for Dask's developers; each unit's outcome reports what happened to it.
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        with ExitStack() as stack:
            stack.enter_context(import_module("dask").config.set(CONFIGURATION))
            cores, memory, cluster = None, None, None
            if self.where == LOCAL:
                count, memory = self._local_fraction(len(units))
                every = system.usable_cores()
                cores = [every[k % len(every) :: count] or every for k in range(count)]
                cluster = stack.enter_context(self._local_cluster(count))
            elif self.where in QUEUES:
                count = min(len(units), self.jobs or MAX_QUEUED_JOBS)
                cluster = stack.enter_context(self._queue_cluster(count, root))
            else:
                count = self.jobs or len(units)
            client = stack.enter_context(self._connect(cluster or self.where))
            left = iter(units)
            running: dict[Any, Unit] = {}
            while True:
                for unit in islice(left, count - len(running)):
                    running[client.submit(_run_in_worker, task, unit, root, memory, cores, pure=False)] = unit
                if not running:
                    return
                for future in self._wait_for_any(list(running), client, cluster, count):
                    yield _outcome(future, running.pop(future))

    def _local_fraction(self, units: int) -> tuple[int, int]:
        """Return the number of local processes, and the memory budget of each in bytes."""
        budget = memory_budget()
        total = budget.limit_bytes if budget.asked_for else int(DEFAULT_FRACTION * free_memory())
        count = self.jobs or max(1, min(len(system.usable_cores()), total // MEMORY_OF_UNIT))
        return min(count, units), min(total // count, total if budget.asked_for else MAX_BY_DEFAULT)

    def _local_cluster(self, count: int) -> Any:
        # Only this process handles Ctrl-C: workers inherit the mask of Dask's thread, which starts here.
        resource_tracker.ensure_running()
        with system.interrupts_blocked():
            return self.dask.LocalCluster(
                n_workers=count,
                threads_per_worker=1,
                memory_limit=0,
                dashboard_address=NO_DASHBOARD,
                security=True,
                silence_logs=logging.CRITICAL,
            )

    def _queue_cluster(self, count: int, root: Path) -> Any:
        folder = root / WORK / "cluster"
        folder.mkdir(parents=True, exist_ok=True)
        settings = {
            "processes": 1,
            "job_name": "simulshot",
            "log_directory": str(folder),
            "shared_temp_directory": str(folder),
            # One unit at a time, however many cores; the queue itself limits the memory.
            "worker_extra_args": ["--nthreads", "1", "--memory-limit", "0", "--no-dashboard"],
            "scheduler_options": {"dashboard_address": NO_DASHBOARD},
            **self.settings,
        }
        try:
            cluster = self.queue(security=True, silence_logs=logging.CRITICAL, **settings)
        except (TypeError, ValueError) as error:
            raise BadInputError(
                f"--cluster-setting: {first_line(error)}",
                hint="names and values are those of dask-jobqueue's job options, as in walltime=01:00:00",
            ) from error
        try:
            cluster.sync(_submit_jobs, cluster, count)
        except BaseException as error:
            # It asserts that all jobs were started, even if one was refused.
            with suppress(AssertionError):
                cluster.close()
            if not isinstance(error, RuntimeError):
                raise
            said = " ".join(str(error).partition("stderr:")[2].split()) or first_line(error)
            raise SimulshotError(
                f"{self.where} refused the jobs: {said}", hint="check the settings of --cluster-setting"
            ) from error
        return cluster

    def _connect(self, place: Any) -> Any:
        try:
            return self.dask.Client(place, timeout=CONNECT_S if place == self.where else START_S)
        except (OSError, ValueError) as error:
            raise NotAvailableError(
                f"no Dask scheduler answers at {place}: {first_line(error)}",
                hint="check the address, or use --cluster local",
            ) from error

    def _wait_for_any(self, futures: list[Any], client: Any, cluster: Any, count: int) -> set[Any]:
        """Return the finished futures, at least one; meanwhile resubmit jobs that ended early."""
        while True:
            with suppress(TimeoutError):
                return cast(set[Any], self.dask.wait(futures, 30, return_when="FIRST_COMPLETED").done)
            if cluster is not None:
                cluster.scale(count)
            if not client.scheduler_info()["workers"]:
                logs = f": look at its queue and the logs in {WORK}/cluster" if self.where in QUEUES else ""
                talk(f"no worker of {self.where} has started yet{logs}")


async def _submit_jobs(cluster: Any, count: int) -> None:
    """Submit jobs until there are `count`, and raise an error if the queue refuses one.

    Dask's own `scale` only logs a refusal.
    """
    while len(cluster.worker_spec) < count:
        cluster.worker_spec.update(cluster.new_worker_spec())
    await cluster


def _run_in_worker(
    task: str, unit: Unit, root: Path, memory: int | None, cores: Sequence[Sequence[int]] | None
) -> Outcome:
    """Compute a unit in a worker, on the worker's cores and within its part of the memory."""
    if cores is not None:
        system.use_cores(cores[int(import_module("distributed").get_worker().name)])
    # Must precede pycolmap: otherwise the first PNG that OpenCV writes aborts the process.
    import_module("cv2")
    with limited_memory(memory):
        return run_unit(task, unit, root)


def _outcome(future: Any, unit: Unit) -> Outcome:
    if future.cancelled():
        raise SimulshotError(
            "the Dask scheduler has ended", hint="finished results are saved: repeat the command to continue"
        )
    if (error := future.exception()) is None:
        return cast(Outcome, future.result())
    kind = type(error).__name__
    text = (
        "its process died twice, which often means too little memory; use fewer --jobs"
        if kind == "KilledWorker"
        else f"{kind}: {first_line(error)}"
    )
    return Outcome(key=unit.key, error=text, exit_code=ExitCode.FAILURE)


def _parse_setting(text: str) -> tuple[str, Any]:
    name, equals, value = text.partition("=")
    if not name or not equals:
        raise BadInputError(f"{text!r} is not a setting", hint="write name=value, as in queue=gpu")
    with suppress(msgspec.DecodeError):
        return name, msgspec.json.decode(value)
    return name, value
