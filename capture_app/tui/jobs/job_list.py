"""The queue of jobs: child processes at the lowest priority, one at a time, none while a burst is taken.

What is kept of a job on disk, beside its results, so that the next start of the screen knows of it.

_results/<session>/<job>.json    what it was to do, and what came of it
_results/<session>/<job>.log     what it said
"""

import asyncio
import time
from collections.abc import Callable, Coroutine, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from msgspec import Struct

from capture_app.errors import BadInputError, SimulshotError
from capture_app.node.child import Child
from capture_app.node.wire.status import RigStatus
from capture_app.session.files.durable import write_atomic_unsynced
from capture_app.session.files.output_folder import clear_leftovers
from capture_app.session.format.checks import read_struct
from capture_app.session.library.changes import RESULTS, results_folder
from capture_app.text import ProgressStep, pretty_json, printable
from capture_app.tui.jobs.job import KINDS, Job, JobKind, JobState
from capture_app.tui.jobs.results import outcome

INTERRUPTED = "the screen was closed before it was done"


class JobRecord(Struct, frozen=True, kw_only=True):
    """What is kept of a job."""

    kind: str
    session: str
    """Relative to the folder of sessions where it lies inside, else absolute."""
    out: str = ""
    """The same, for its folder of results."""
    options: str = ""
    state: JobState = JobState.RUNNING
    message: str = ""
    ended: datetime | None = None
    seconds: float = 0.0


def default_out(kind_name: str, session: Path, root: Path) -> Path:
    """Where a job of that kind puts its results unless it is told otherwise."""
    return results_folder(session, root) / kind_name


def save_record(job: Job, root: Path) -> None:
    """Write a job's record and its log. Raises OSError."""
    place = results_folder(job.session, root)
    place.mkdir(parents=True, exist_ok=True)
    record = JobRecord(
        kind=job.kind.name,
        session=_shorten(job.session, root),
        out="" if job.out is None else _shorten(job.out, root),
        options=job.options,
        state=job.state,
        message=job.message,
        ended=job.ended,
        seconds=round(job.seconds, 1),
    )
    write_atomic_unsynced(place / f"{job.kind.name}.json", pretty_json(record))
    if not job.state.is_over:
        (place / f"{job.kind.name}.log").unlink(missing_ok=True)
    else:
        log = "".join(f"{line}\n" for line in job.log)
        write_atomic_unsynced(place / f"{job.kind.name}.log", log.encode(errors="replace"))


def forget_record(job: Job, root: Path) -> None:
    """Remove a job's record and its log; its results stay. Raises OSError."""
    for suffix in ("json", "log"):
        (results_folder(job.session, root) / f"{job.kind.name}.{suffix}").unlink(missing_ok=True)


def find_jobs(root: Path) -> Iterator[Job]:
    """Yield the jobs of earlier runs in a folder of sessions, the latest last; blocks on the disk.

    A session that was renamed since has its results under its new name, and its jobs follow it.
    """
    places = [*(root / RESULTS).glob("*/*.json"), *(root / RESULTS).glob("_*/*/*.json")]
    found = [job for place in places if (job := _read(place, root)) is not None]
    yield from sorted(found, key=_age)


def _age(job: Job) -> tuple[datetime, str]:
    return job.ended or datetime.min.replace(tzinfo=UTC), f"{job.session} {job.kind.name}"


def _read(place: Path, root: Path) -> Job | None:
    try:
        record = read_struct(place, JobRecord)
    except BadInputError:
        return None
    kind = KINDS.get(record.kind)
    if kind is None or place.stem != record.kind:
        return None
    session, out = _lengthen(record.session, root), _lengthen(record.out, root) if record.out else None
    if place.parent.parent == root / RESULTS and session.parent == root:
        session = root / place.parent.name
        if out is not None and not Path(record.out).is_absolute():
            out = place.parent / out.name
    state, message, ended = record.state, record.message, record.ended
    if not state.is_over:
        state, message = JobState.CANCELLED, INTERRUPTED
        ended = datetime.fromtimestamp(place.stat().st_mtime, UTC)
    if state is JobState.DONE and kind.result and (out is None or not (out / kind.result).is_file()):
        return None
    job = Job(kind, session, out, record.options, 0, state, message=message, ended=ended)
    job.seconds, job.is_found = record.seconds, True
    with suppress(OSError):
        job.log.extend(printable(place.with_suffix(".log").read_text(errors="replace")).splitlines())
    return job


def _shorten(path: Path, root: Path) -> str:
    """Relative to the folder of sessions where it lies inside: that folder may be moved."""
    absolute, base = path.absolute(), root.absolute()
    return str(absolute.relative_to(base)) if absolute.is_relative_to(base) else str(absolute)


def _lengthen(text: str, root: Path) -> Path:
    return root / text


AT_ONCE = 1
"""Jobs that run at the same time: each takes all the cores that are free."""

HEARD_S = 0.1
"""What a job says within this time is told at once."""


class JobList:
    """Runs jobs in the order in which they were added; all methods are called in the event loop's thread.

    A burst has the machine to itself: while one is picked or saved the running job stands still (SIGSTOP),
    and goes on afterwards. Jobs end with this process, and their results are there whole or not at all.
    """

    def __init__(self, root: Path, *, clock: Callable[[], float] = time.monotonic) -> None:
        """`root` is the folder of sessions; `clock` gives seconds that only grow."""
        self.root = root
        self.jobs: list[Job] = []
        """The newest first; what was found on disk last."""
        self._clock = clock
        self._watchers: list[Callable[[Job], None]] = []
        self._children: dict[Job, Child] = {}
        self._since: dict[Job, float] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._heard: set[Job] = set()
        self._held = False
        self._closing = False
        self._numbered = 0

    @property
    def unfinished(self) -> tuple[Job, ...]:
        """The jobs that wait or run: what would be lost by closing."""
        return tuple(job for job in self.jobs if not job.state.is_over)

    @property
    def is_held(self) -> bool:
        """Whether jobs stand still for a burst."""
        return self._held

    def of(self, session: Path) -> list[Job]:
        """The jobs of a session, the newest first."""
        return [job for job in self.jobs if job.place == session.absolute()]

    def watch(self, tell: Callable[[Job], None]) -> Callable[[], None]:
        """Be told of each job that changes; the function that is returned ends that."""
        self._watchers.append(tell)
        return lambda: self._watchers.remove(tell)

    async def find_earlier(self) -> None:
        """Add the jobs of earlier runs that are found on disk."""
        found = await asyncio.to_thread(lambda: list(find_jobs(self.root)))
        known = {(job.kind.name, job.place) for job in self.jobs}
        for job in reversed(found):
            if (job.kind.name, job.place) not in known:
                self._number(job)
                self.jobs.append(job)
                self._tell(job)

    def add(self, kind: JobKind, session: Path, options: str | None = None, out: Path | None = None) -> Job:
        """Start a job, or let it wait for its turn; by default with the kind's quick options.

        One of the same kind and session that is over gives way to it. Raises BadInputError where one is not
        over yet, or the options cannot be read.
        """
        options = kind.quick if options is None else options
        same = [job for job in self.jobs if job.kind.name == kind.name and job in self.of(session)]
        if any(not job.state.is_over for job in same):
            raise BadInputError(f"{kind.title} of {session.name} is {same[0].state} already")
        if kind.writes and out is None:
            out = default_out(kind.name, session, self.root)
        kind.arguments(session, out, options)
        job = Job(kind, session, out, options, 0)
        self._number(job)
        self.jobs = [job, *(other for other in self.jobs if other not in same)]
        self._tell(job)
        self._start_next()
        return job

    def retry(self, job: Job) -> Job:
        """Do the same again. Raises BadInputError where it is not over yet."""
        return self.add(job.kind, job.session, job.options, job.out)

    async def cancel(self, job: Job) -> None:
        """End a job; what it has made so far is removed."""
        if job.state.is_over:
            return
        waiting = job.state is JobState.WAITING
        job.state = JobState.CANCELLED
        child = self._children.get(job)
        if waiting:
            job.ended = datetime.now(UTC)
            self._tell(job)
        elif child is not None:
            await child.stop()

    def drop(self, session: Path) -> None:
        """Take a session's jobs off the list: it and its results are in the trash."""
        gone = [job for job in self.of(session) if job.state.is_over]
        self.jobs = [job for job in self.jobs if job not in gone]
        for job in gone:
            self._tell(job)

    def forget(self, job: Job) -> None:
        """Take a job that is over off the list; its results stay on disk."""
        if job.state.is_over and job in self.jobs:
            self.jobs.remove(job)
            self._spawn(self._forget_on_disk(job))
            self._tell(job)

    async def follow_rename(self, session: Path, renamed: Path) -> None:
        """Let the jobs of a session go with it to its new name, where its results are already."""
        for job in self.jobs:
            if job in self.of(session) and job.state.is_over:
                job.session = renamed
                if job.out is not None and job.out.is_relative_to(results_folder(session, self.root)):
                    job.out = results_folder(renamed, self.root) / job.out.name
                await self._note(job)
                self._tell(job)

    def hold(self, held: bool) -> None:
        """Let jobs stand still, or go on."""
        if held == self._held:
            return
        self._held = held
        for job, child in self._children.items():
            if held and job.state is JobState.RUNNING:
                child.pause()
                self.seconds_of(job)
                job.state = JobState.PAUSED
            elif not held and job.state is JobState.PAUSED:
                child.resume()
                self._since[job] = self._clock()
                job.state = JobState.RUNNING
            self._tell(job)
        self._start_next()

    def hold_for(self, status: RigStatus) -> None:
        """Let jobs stand still while this rig takes or saves a burst."""
        self.hold(status.burst is not None and not status.burst.done)

    def seconds_of(self, job: Job) -> float:
        """How long a job has run by now."""
        if job.state is JobState.RUNNING and job in self._since:
            now = self._clock()
            job.seconds += now - self._since[job]
            self._since[job] = now
        return job.seconds

    async def wait(self) -> None:
        """Wait until nothing runs or waits, and all is noted on disk."""
        while self._tasks:
            await asyncio.wait(tuple(self._tasks))

    async def close(self) -> None:
        """End all jobs."""
        self._closing = True
        for job in self.unfinished:
            await self.cancel(job)
        await self.wait()

    def _number(self, job: Job) -> None:
        self._numbered += 1
        job.number = self._numbered

    def _tell(self, job: Job) -> None:
        for tell in tuple(self._watchers):
            tell(job)

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def _start_next(self) -> None:
        waiting = [job for job in self.jobs if job.state is JobState.WAITING]
        running = sum(job.state in (JobState.RUNNING, JobState.PAUSED) for job in self.jobs)
        if waiting and running < AT_ONCE and not self._held and not self._closing:
            job = waiting[-1]
            job.state = JobState.RUNNING
            self._spawn(self._run(job))

    async def _run(self, job: Job) -> None:
        self._since[job] = self._clock()
        self._tell(job)
        try:
            await self._note(job)
            printed, error = await self._run_child(job)
        except (SimulshotError, OSError) as failure:
            printed, error = b"", str(failure)
        self.seconds_of(job)
        self._since.pop(job, None)
        if job.state is JobState.CANCELLED:
            job.message = "cancelled"
        elif error:
            job.state, job.message = JobState.FAILED, printable(error)
        else:
            job.state, job.message = JobState.DONE, printable(outcome(job.kind, printed))
        job.ended = datetime.now(UTC)
        await self._note(job)
        self._tell(job)
        self._start_next()

    async def _run_child(self, job: Job) -> tuple[bytes, str]:
        """Run the job's process; what it printed, and how it failed."""
        if job.state.is_over:
            return b"", ""
        arguments = job.kind.arguments(job.session, job.out, job.options)
        child = await Child.start(
            job.kind.title,
            (job.kind.module, *arguments),
            on_line=lambda line: self._hear(job, line),
            background=True,
        )
        self._children[job] = child
        try:
            if _is_cancelled(job):
                return b"", ""
            if self._held:
                child.pause()
                job.state = JobState.PAUSED
                self._tell(job)
            assert child.process.stdout is not None
            printed = await child.process.stdout.read()
            if await child.process.wait() and not _is_cancelled(job):
                failure = await child.failure()
                return printed, failure.what.partition(": ")[2] or failure.what
            await asyncio.wait((child.listening,), timeout=1.0)
            return printed, ""
        finally:
            await child.stop()
            del self._children[job]
            if job.out is not None and job.state is JobState.CANCELLED:
                await asyncio.to_thread(clear_leftovers, job.out.parent)

    def _hear(self, job: Job, line: str) -> None:
        job.log.append(printable(line))
        if step := ProgressStep.parse(line):
            job.step = ProgressStep(step.done, step.total, printable(step.text))
        # A program may say a thousand lines a second; nobody reads them one by one.
        if job not in self._heard:
            self._heard.add(job)
            asyncio.get_running_loop().call_later(HEARD_S, self._tell_heard, job)

    def _tell_heard(self, job: Job) -> None:
        self._heard.discard(job)
        self.seconds_of(job)
        self._tell(job)

    async def _note(self, job: Job) -> None:
        try:
            await asyncio.to_thread(save_record, job, self.root)
        except OSError as error:
            job.log.append(f"this job will not be known after a restart: {error}")

    async def _forget_on_disk(self, job: Job) -> None:
        try:
            await asyncio.to_thread(forget_record, job, self.root)
        except OSError:
            return


def _is_cancelled(job: Job) -> bool:
    return job.state is JobState.CANCELLED
