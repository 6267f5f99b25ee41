"""Queue of runs: child processes at the lowest priority, one at a time, none during a burst.

Each run is recorded beside its results, so that the next start of the screen knows it:

    _results/<session>/<command>.json    the command and its outcome
    _results/<session>/<command>.log     its output
"""

import asyncio
import os
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from socket import gethostname

import msgspec

from capture_app.common import system
from capture_app.common.child import LOWEST_PRIORITY, Child
from capture_app.common.errors import BadInputError, SimulshotError
from capture_app.common.text import UNREADABLE, ProgressStep, pretty_json, printable
from capture_app.session.files.durable import write_atomic
from capture_app.session.files.output_folder import clear_leftovers
from capture_app.session.files.untrusted_files import read_regular
from capture_app.session.library.changes import RESULTS, results_folder
from capture_app.tui.jobs.run import COMMANDS, IMPORT, MOMENT, OWN, Command, Run, RunState

INTERRUPTED = "its screen was closed before it was done"
LOG_LINES = 500


class Runs:
    """Queue that runs commands in the order added; call all methods in the event loop's thread.

    A burst has precedence: while one is selected or saved, the run is suspended (SIGSTOP). Runs end with this
    process; their results are complete or absent.
    """

    def __init__(self, root: Path, tell: Callable[[Run | None], None] = lambda _: None) -> None:
        """`root`: the sessions folder; `tell` is called with the run whose state changed, None for any."""
        self.root = root
        self.all: list[Run] = []
        """All runs, newest first; finished ones, and those of other screens, as stored in their files."""
        self._tell = tell
        self._worker: asyncio.Task[None] | None = None
        self._free = asyncio.Event()
        self._free.set()
        self._child: Child | None = None
        self._going: Run | None = None
        """Run with a live child process, or whose final state is not stored yet."""
        self._since = 0.0
        self._said: dict[str, deque[str]] = {}

    @property
    def unfinished(self) -> list[Run]:
        """Waiting and running runs of this screen, which closing would lose."""
        return [run for run in self.all if not run.state.is_over and not run.is_foreign]

    @property
    def are_held(self) -> bool:
        """Whether runs are suspended for a burst."""
        return not self._free.is_set()

    def of(self, session: Path) -> list[Run]:
        """Return the runs on a session, newest first."""
        return [run for run in self.all if run.session.absolute() == session.absolute()]

    def out(self, command: Command, session: Path) -> Path:
        """Return a command's default results folder."""
        return results_folder(session, self.root) / command.name

    async def read(self) -> None:
        """Read finished runs from disk again, because sessions may have been renamed or trashed."""
        before = self._of_this_start
        found = await asyncio.to_thread(_read_all, self.root)
        ours = {run.key: run for run in self.all if run in (*before, *self._of_this_start)}
        self.all = [*ours.values(), *(run for run in found if run.key not in ours)]
        self._tell(None)

    def add(
        self, command: Command, session: Path, options: str | None = None, out: Path | None = None
    ) -> Run:
        """Start a command or queue it, by default with its quick options.

        Replaces a finished run of the command on this session. Raises BadInputError if one is unfinished, or
        if the options are unreadable.
        """
        options = command.quick if options is None else options
        if command.writes and out is None:
            out = self.out(command, session)
        command.arguments(session, out, options)
        run = Run(kind=command.name, session=session, out=out, options=options, owner=OWN)
        for same in self.all:
            if same.key == run.key and not same.state.is_over:
                raise BadInputError(
                    f"{command.title} of {session.name} is {same.state} already",
                    hint="wait for it, or cancel it in Jobs (key 4)",
                )
        self.all = [run, *(other for other in self.all if other.key != run.key)]
        self._said[run.key] = deque(maxlen=LOG_LINES)
        self._tell(run)
        if self._worker is None or self._worker.done():
            self._worker = asyncio.create_task(self._work())
        return run

    async def cancel(self, run: Run) -> None:
        """Cancel a run and remove its partial results."""
        if run in self.unfinished:
            goes_on = run.state is not RunState.WAITING
            run.state, run.ended = RunState.CANCELLED, datetime.now(UTC)
            if not goes_on:
                self._tell(run)
            elif self._child is not None:
                await self._child.stop()

    async def forget(self, run: Run) -> None:
        """Remove a finished run from the list; its results stay on disk."""
        for suffix in (".json", ".log"):
            with suppress(OSError):
                self._file(run, suffix).unlink(missing_ok=True)
        self.all.remove(run)
        self._tell(None)

    def hold(self, held: bool) -> None:
        """Suspend or resume runs."""
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
        """Return the last lines of a run's output."""
        if run.key not in self._said:
            with suppress(OSError):
                lines = printable(self._file(run, ".log").read_text(errors="replace")).splitlines()
                self._said[run.key] = deque(lines, maxlen=LOG_LINES)
        return self._said.get(run.key, ())

    def count_time(self) -> None:
        """Update the run times."""
        now = system.monotonic_s()
        for run in self.unfinished:
            if run.state is RunState.RUNNING:
                run.seconds += now - self._since
        self._since = now

    async def wait(self) -> None:
        """Wait until all runs have ended and are stored on disk."""
        if self._worker is not None:
            await self._worker

    async def close(self) -> None:
        """Cancel all runs."""
        for run in self.unfinished:
            await self.cancel(run)
        self._free.set()
        await self.wait()

    @property
    def _of_this_start(self) -> list[Run]:
        return [run for run in self.all if run is self._going or run in self.unfinished]

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
        run.state, self._since, worked_s = RunState.RUNNING, system.monotonic_s(), _processor_s()
        self._tell(run)
        await self._keep(run)
        try:
            state, message = RunState.DONE, await self._run_child(run)
        except (SimulshotError, OSError) as failure:
            # Depth of each take is computed unasked, and most rigs are not calibrated.
            unasked = run.kind == MOMENT.name and isinstance(failure, BadInputError)
            state, message = RunState.NOT_APPLICABLE if unasked else RunState.FAILED, str(failure)
        self.count_time()
        run.processor_s = _processor_s() - worked_s
        if run.state is RunState.CANCELLED:
            state, message = run.state, "cancelled"
        run.state, run.message, run.ended, run.step = state, printable(message), datetime.now(UTC), None
        await self._keep(run)
        self._tell(run)

    async def _run_child(self, run: Run) -> str:
        """Run the process and return its first line, the outcome. Raises SimulshotError if it fails."""

        def hear(line: str) -> None:
            self._said[run.key].append(printable(line))
            if step := ProgressStep.parse(line):
                run.step = step

        words = run.command.module, *run.command.arguments(run.session, run.out, run.options)
        self._child = child = await Child.start(
            run.command.title, words, on_line=hear, niceness=LOWEST_PRIORITY
        )
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
            failure.what = failure.what.partition(": ")[2] or failure.what
            raise
        finally:
            self._child = None
            await child.stop()
            if run.out is not None and run.state is RunState.CANCELLED:
                # An import writes sessions into its folder; other commands write the folder itself.
                await asyncio.to_thread(
                    clear_leftovers, run.out if run.kind == IMPORT.name else run.out.parent
                )

    async def _keep(self, run: Run) -> None:
        try:
            await asyncio.to_thread(self._write, run)
        except OSError as error:
            self._said[run.key].append(
                f"this job cannot be stored and is forgotten at the next start: {error}"
            )

    def _write(self, run: Run) -> None:
        root, path = self.root.absolute(), self._file(run, ".json")

        def shorten(path: Path) -> str:
            """Make a path inside the sessions folder relative, because that folder may be moved."""
            absolute = path.absolute()
            place = absolute.relative_to(root) if absolute.is_relative_to(root) else absolute
            return place.as_posix()

        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(path, pretty_json(msgspec.to_builtins(run, enc_hook=shorten)))
        path.with_suffix(".log").unlink(missing_ok=True)
        if run.state.is_over:
            log = "".join(f"{line}\n" for line in self._said[run.key]).encode(errors="replace")
            write_atomic(path.with_suffix(".log"), log)


def _processor_s() -> float:
    """Return the CPU time in seconds of this process's ended children."""
    return sum(os.times()[2:4])


def _is_alive(owner: str) -> bool:
    """Return whether the screen of a run is running on this machine."""
    host, _, process = owner.rpartition(":")
    return host == gethostname() and process.isdecimal() and system.is_running(int(process))


def _read_all(root: Path) -> list[Run]:
    """Return the stored runs in a sessions folder, latest first."""
    places = [*(root / RESULTS).glob("*/*.json"), *(root / RESULTS).glob("_*/*/*.json")]
    found = (run for place in places if (run := _read(place, root)) is not None)
    # One that still runs is the latest.
    return sorted(
        found, key=lambda run: (run.ended or datetime.max.replace(tzinfo=UTC), run.key), reverse=True
    )


def _read(place: Path, root: Path) -> Run | None:
    try:
        run = msgspec.json.decode(read_regular(place), type=Run, dec_hook=lambda _, text: root / text)
        if place.stem != run.kind or run.kind not in COMMANDS:
            return None
        run.command.arguments(run.session, run.out, run.options)  # raises for unusable options
    except (*UNREADABLE, OSError, BadInputError):
        return None
    # The results of a renamed session are under its new name; the run takes that name too.
    if place.parent.parent == root / RESULTS:
        run.session = root / place.parent.name
    if run.out is not None and run.out.is_relative_to(root / RESULTS):
        run.out = place.parent / run.out.name
    if run.is_foreign and _is_alive(run.owner):
        run.message = f"runs in another screen on this machine (process {run.owner.rpartition(':')[2]})"
    elif not run.state.is_over:
        run.state, run.message = RunState.CANCELLED, INTERRUPTED
        run.ended = datetime.fromtimestamp(place.stat().st_mtime, UTC)
    return None if run.state is RunState.DONE and run.command.result and run.result is None else run
