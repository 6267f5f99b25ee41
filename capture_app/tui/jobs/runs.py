"""Queue of runs: child processes at the lowest priority, one at a time, none during a burst.

Each run is recorded beside its results, so that the next start of the screen knows it:

    _results/<session>/<command>.json    the command and its outcome
    _results/<session>/<command>.log     its output
"""

import asyncio
import os
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from capture_app.common.child import Child
from capture_app.common.errors import BadInputError, SimulshotError
from capture_app.common.text import UNREADABLE, ProgressStep, pretty_json, printable
from capture_app.session.files.durable import write_atomic
from capture_app.session.files.output_folder import clear_leftovers
from capture_app.session.files.strangers import read_regular
from capture_app.session.library.changes import RESULTS, results_folder
from capture_app.tui.jobs.run import COMMANDS, IMPORT, Command, Run, RunState

INTERRUPTED = "the screen was closed before it was done"
LOG_LINES = 500


class Runs:
    """Runs commands in the order in which they were added; all is called in the event loop's thread.

    A burst has the machine to itself: while one is selected or saved the run stands still (SIGSTOP), and
    goes on afterwards. Runs end with this process, and their results are there whole or not at all.
    """

    def __init__(self, root: Path, tell: Callable[[Run | None], None] = lambda _: None) -> None:
        """`root`: the folder of sessions; `tell`: a run has another state; None: any of them."""
        self.root = root
        self.all: list[Run] = []
        """The newest first; those that are over are as their files say."""
        self._tell = tell
        self._worker: asyncio.Task[None] | None = None
        self._free = asyncio.Event()
        self._free.set()
        self._child: Child | None = None
        self._going: Run | None = None
        """The run whose child is there, or whose file does not say yet that it is over."""
        self._since = 0.0
        self._said: dict[str, deque[str]] = {}

    @property
    def unfinished(self) -> list[Run]:
        """The runs that wait or go on: what would be lost by closing."""
        return [run for run in self.all if not run.state.is_over]

    @property
    def are_held(self) -> bool:
        """Whether they stand still for a burst."""
        return not self._free.is_set()

    def of(self, session: Path) -> list[Run]:
        """The runs on a session, the newest first."""
        return [run for run in self.all if run.session.absolute() == session.absolute()]

    def out(self, command: Command, session: Path) -> Path:
        """Where a command puts its results unless it is told otherwise."""
        return results_folder(session, self.root) / command.name

    async def read(self) -> None:
        """Read the runs that are over from the disk again: sessions may be renamed or trashed."""
        before = self._of_this_start
        found = await asyncio.to_thread(_read_all, self.root)
        ours = [run for run in self.all if run in (*before, *self._of_this_start)]
        known = {run.key for run in ours}
        self.all = [*ours, *(run for run in found if run.key not in known)]
        self._tell(None)

    def add(
        self, command: Command, session: Path, options: str | None = None, out: Path | None = None
    ) -> Run:
        """Start a command, or let it wait for its turn; by default with its quick options.

        A run of it on this session that is over gives way. Raises BadInputError where one is not over yet,
        or the options cannot be read.
        """
        options = command.quick if options is None else options
        if command.writes and out is None:
            out = self.out(command, session)
        command.arguments(session, out, options)
        run = Run(kind=command.name, session=session, out=out, options=options)
        others = [other for other in self.all if other.key != run.key]
        for same in self.unfinished:
            if same not in others:
                raise BadInputError(f"{command.title} of {session.name} is {same.state} already")
        self.all = [run, *others]
        self._said[run.key] = deque(maxlen=LOG_LINES)
        self._tell(run)
        if self._worker is None or self._worker.done():
            self._worker = asyncio.create_task(self._work())
        return run

    async def cancel(self, run: Run) -> None:
        """End a run; what it has made so far is removed."""
        if not run.state.is_over:
            goes_on = run.state is not RunState.WAITING
            run.state, run.ended = RunState.CANCELLED, datetime.now(UTC)
            if not goes_on:
                self._tell(run)
            elif self._child is not None:
                await self._child.stop()

    async def forget(self, run: Run) -> None:
        """Take a run that is over off the list; its results stay on disk."""
        for suffix in (".json", ".log"):
            with suppress(OSError):
                self._file(run, suffix).unlink(missing_ok=True)
        self.all.remove(run)
        self._tell(None)

    def hold(self, held: bool) -> None:
        """Let runs stand still, or go on."""
        if held == self.are_held:
            return
        (self._free.clear if held else self._free.set)()
        for run in self.all:
            if self._child is not None and run.state in (RunState.RUNNING, RunState.PAUSED):
                self.count_time()
                run.state = RunState.PAUSED if held else RunState.RUNNING
                (self._child.pause if held else self._child.resume)()
                self._tell(run)

    def log(self, run: Run) -> Sequence[str]:
        """The last lines that a run said."""
        if run.key not in self._said:
            with suppress(OSError):
                text = self._file(run, ".log").read_text(errors="replace")
                self._said[run.key] = deque(printable(text).splitlines(), maxlen=LOG_LINES)
        return self._said.get(run.key, ())

    def count_time(self) -> None:
        """Have the times of the runs as they are by now."""
        now = time.monotonic()
        for run in self.unfinished:
            if run.state is RunState.RUNNING:
                run.seconds += now - self._since
        self._since = now

    async def wait(self) -> None:
        """Wait until nothing runs or waits, and all is noted on disk."""
        if self._worker is not None:
            await self._worker

    async def close(self) -> None:
        """End all runs."""
        for run in self.unfinished:
            await self.cancel(run)
        self._free.set()
        await self.wait()

    @property
    def _of_this_start(self) -> list[Run]:
        return [run for run in self.all if run is self._going or not run.state.is_over]

    def _file(self, run: Run, suffix: str) -> Path:
        return results_folder(run.session, self.root) / f"{run.kind}{suffix}"

    async def _work(self) -> None:
        while waiting := [run for run in self.all if run.state is RunState.WAITING]:
            await self._free.wait()
            if waiting[-1].state is RunState.WAITING:
                self._going = waiting[-1]
                await self._run(self._going)
                self._going = None

    async def _run(self, run: Run) -> None:
        run.state, self._since, worked_s = RunState.RUNNING, time.monotonic(), _processor_s()
        self._tell(run)
        await self._keep(run)
        try:
            state, message = RunState.DONE, await self._run_child(run)
        except (SimulshotError, OSError) as failure:
            state, message = RunState.FAILED, str(failure)
        self.count_time()
        run.processor_s = _processor_s() - worked_s
        if run.state is RunState.CANCELLED:
            state, message = run.state, "cancelled"
        run.state, run.message, run.ended, run.step = state, printable(message), datetime.now(UTC), None
        await self._keep(run)
        self._tell(run)

    async def _run_child(self, run: Run) -> str:
        """Run the process; what came of it is what it prints first. Raises SimulshotError where it failed."""

        def hear(line: str) -> None:
            self._said[run.key].append(printable(line))
            if step := ProgressStep.parse(line):
                run.step = step

        module, arguments = run.command.module, run.command.arguments(run.session, run.out, run.options)
        child = await Child.start(run.command.title, (module, *arguments), on_line=hear, background=True)
        self._child = child
        try:
            if run.state is RunState.CANCELLED:
                return ""
            if self.are_held:
                child.pause()
                run.state = RunState.PAUSED
                self._tell(run)
            first, *more = (await child.output()).decode(errors="replace").splitlines() or [""]
            await asyncio.wait((child.listening,), timeout=1.0)
            self._said[run.key] += map(printable, more)
            return first
        except SimulshotError as failure:
            raise SimulshotError(failure.what.partition(": ")[2] or failure.what) from failure
        finally:
            self._child = None
            await child.stop()
            if run.out is not None and run.state is RunState.CANCELLED:
                # An import writes its sessions into its folder, all others write the folder itself.
                await asyncio.to_thread(
                    clear_leftovers, run.out if run.kind == IMPORT.name else run.out.parent
                )

    async def _keep(self, run: Run) -> None:
        try:
            await asyncio.to_thread(self._write, run)
        except OSError as error:
            self._said[run.key].append(f"this job will not be known after a restart: {error}")

    def _write(self, run: Run) -> None:
        root, path = self.root.absolute(), self._file(run, ".json")

        def shorten(path: Path) -> str:
            """Relative to the folder of sessions where it lies inside: that folder may be moved."""
            absolute = path.absolute()
            return str(absolute.relative_to(root) if absolute.is_relative_to(root) else absolute)

        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, pretty_json(msgspec.to_builtins(run, enc_hook=shorten)))
        if run.state.is_over:
            log = "".join(f"{line}\n" for line in self._said[run.key])
            write_atomic(path.with_suffix(".log"), log.encode(errors="replace"))
        else:
            path.with_suffix(".log").unlink(missing_ok=True)


def _processor_s() -> float:
    """How long processors have worked for children of this process that have ended."""
    times = os.times()
    return times.children_user + times.children_system


def _read_all(root: Path) -> list[Run]:
    """The runs of earlier starts in a folder of sessions, the latest first."""
    places = [*(root / RESULTS).glob("*/*.json"), *(root / RESULTS).glob("_*/*/*.json")]
    found = [run for place in places if (run := _read(place, root)) is not None]
    oldest = datetime.min.replace(tzinfo=UTC)
    return sorted(found, key=lambda run: (run.ended or oldest, run.key), reverse=True)


def _read(place: Path, root: Path) -> Run | None:
    try:
        run = msgspec.json.decode(read_regular(place), type=Run, dec_hook=lambda _, text: root / text)
        if place.stem != run.kind or run.kind not in COMMANDS:
            return None
        run.command.arguments(run.session, run.out, run.options)  # options that no command line can have
    except (*UNREADABLE, OSError, BadInputError):
        return None
    # A session that was renamed has its results under its new name, and its runs follow it.
    if place.parent.parent == root / RESULTS:
        run.session = root / place.parent.name
    if run.out is not None and run.out.is_relative_to(root / RESULTS):
        run.out = place.parent / run.out.name
    if not run.state.is_over:
        run.state, run.message = RunState.CANCELLED, INTERRUPTED
        run.ended = datetime.fromtimestamp(place.stat().st_mtime, UTC)
    return None if run.state is RunState.DONE and run.command.result and run.result is None else run
