"""Sessions of a leader's earlier bursts, resumed where they were interrupted or lack images."""

import asyncio
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

from capture_app.common.errors import BadInputError, DiskError, DiskFullError, SimulshotError
from capture_app.common.timeouts import CAMERA_DISCONNECTED_NS, DISK_RETRY_S, RETURN_NS
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.burst.plans import check_machine
from capture_app.protocol.messages import CameraReport, ImageReceipt, ReportAck
from capture_app.session.files.disk import SPARE_BYTES, free_bytes
from capture_app.session.format.burst_plan import PLAN, read_plan
from capture_app.session.format.manifest import MANIFEST
from capture_app.session.reading.reader import Session, writing_state

Key = tuple[int, int]


class ResumedBursts:
    """Sessions in a folder that are interrupted, or finished without all images; opened when needed."""

    def __init__(
        self,
        root: Path,
        on_resumed: Callable[[BurstSession], None],
        disk: ThreadPoolExecutor,
        run: int | None = None,
    ) -> None:
        """`run` is the id of the leader's present run, whose bursts keep their numbers."""
        self._root, self._disk, self._on_resumed, self._run = root, disk, on_resumed, run
        self._open: dict[Key, BurstSession] = {}
        self._folders: dict[Key, Path] = {}
        self._opening = asyncio.Lock()
        self._all_resumed = asyncio.Event()

    def sessions(self) -> tuple[BurstSession, ...]:
        """Return the sessions of resumed bursts that are not finished."""
        return tuple(session for session in self._open.values() if not session.finished.is_set())

    async def resume_all(
        self, now_ns: int, *, folders: Sequence[Path] | None = None, wait_ns: int = RETURN_NS
    ) -> None:
        """Resume all interrupted sessions, which nodes have `wait_ns` to reconnect to; recordings last until
        their ordered end. With `folders`, resume only these, and do not wait for that end.
        """
        interrupted = await asyncio.to_thread(lambda: folders or [*interrupted_folders(self._root)])
        for folder in interrupted:
            async with self._opening:
                # A session that cannot be resumed is left unchanged; `sessions repair` says why.
                with suppress(SimulshotError):
                    key = (await asyncio.to_thread(read_plan, folder)).key
                    heard_ns = now_ns + wait_ns - CAMERA_DISCONNECTED_NS
                    session = await self._resume(key, folder, heard_ns, is_closing=folders is not None)
                    await session.finish_if_complete()
        self._all_resumed.set()

    async def finish_later(self, folder: Path, now_ns: Callable[[], int]) -> None:
        """Resume a session that could not be finished, once its disk has room again."""
        has_room = False
        while not has_room:
            await asyncio.sleep(DISK_RETRY_S)
            with suppress(DiskError):
                has_room = await asyncio.to_thread(free_bytes, folder) >= SPARE_BYTES
        # A camera that had more images for it may have caused that already.
        if (await asyncio.to_thread(writing_state, folder)).startswith("interrupted"):
            await self.resume_all(now_ns(), folders=[folder])

    async def wait_until_finished(self) -> None:
        """Wait until all sessions that `resume_all` resumed are finished."""
        await self._all_resumed.wait()
        for session in self.sessions():
            await session.finished.wait()

    async def answer_finished(self, report: CameraReport, pin: str) -> ReportAck | None:
        """Answer for a finished session that has all images of a report, without reopening it.

        Returns None if there is no such session, or it lacks images. Raises BadInputError for another
        machine's camera.
        """
        session = self._open.get((report.leader, report.burst))
        if session is not None and not session.finished.is_set():
            return None
        return await asyncio.to_thread(self._answer_if_whole, report, pin)

    def _answer_if_whole(self, report: CameraReport, pin: str) -> ReportAck | None:
        if (folder := self._find((report.leader, report.burst))) is None:
            return None
        plan, camera = read_plan(folder), report.camera
        # Check before anything is reopened.
        check_machine(plan, camera, pin)
        try:
            session = Session.open(folder)
        except SimulshotError:
            return None
        instants = session.manifest.burst.instants_ns
        # A recording that was cut off is shorter than ordered: the camera may have more of it.
        end = None if plan.streamed is None else plan.streamed.count
        chosen = plan.chosen or range(len(instants) if end is None else end)
        reported = {n for n in report.plan.instants if n in chosen}
        records = [
            record
            for record in session.manifest.images
            if record.camera == camera and (end is None or record.instant in reported)
        ]
        if (
            report.plan.picking
            or not reported <= {chosen[record.instant] for record in records}
            or not all(session.image_file(record).is_file() for record in records)
        ):
            return None
        return ReportAck(
            receipts=tuple(
                ImageReceipt(instant=chosen[record.instant], sha256=record.sha256) for record in records
            ),
            requested=tuple(chosen) if plan.spare else None,
            end=end,
        )

    async def reopen(self, report: CameraReport, now_ns: int) -> BurstSession:
        """Return the session that a report belongs to, reopened if it was closed.

        Raises BadInputError if there is no such session, TryAgainError where another process writes it,
        DiskFullError where it could not be finished again.
        """
        key = (report.leader, report.burst)
        async with self._opening:
            if (session := self._open.get(key)) is not None and not session.finished.is_set():
                return session
            if (folder := await asyncio.to_thread(self._find, key)) is None:
                raise BadInputError(
                    f"burst {report.burst} of that leader has no session in {self._root}",
                    hint="move its session back there: its images follow within five minutes",
                )
            if free_bytes(folder) < SPARE_BYTES:
                raise DiskFullError(f"the disk of {folder} is full", hint="make room on the leader")
            return await self._resume(key, folder, now_ns)

    async def suspend_all(self) -> None:
        """Suspend all unfinished sessions; write the manifest again of those that were finished before."""
        for session in self.sessions():
            if (session.folder / MANIFEST).exists():
                await session.finish_now("the leader was stopped")
            else:
                await session.suspend()

    async def _resume(
        self, key: Key, folder: Path, heard_ns: int, *, is_closing: bool = False
    ) -> BurstSession:
        session = await asyncio.to_thread(
            BurstSession.resume,
            folder,
            heard_ns,
            self._disk,
            is_of_this_run=key[0] == self._run,
            is_closing=is_closing,
        )
        self._open = {burst: other for burst, other in self._open.items() if not other.finished.is_set()}
        self._open[key] = session
        self._on_resumed(session)
        return session

    def _find(self, key: Key) -> Path | None:
        if (known := self._folders.get(key)) is not None and (known / PLAN).is_file():
            return known
        # A folder that is no longer there is no burst's.
        self._folders.clear()
        for plan in sorted(self._root.glob(f"*/{PLAN}")):
            with suppress(BadInputError):
                self._folders[read_plan(plan.parent).key] = plan.parent
        return self._folders.get(key)


def interrupted_folders(root: Path) -> Iterator[Path]:
    """Yield the folders of unfinished bursts that no process writes, oldest first, but unreadable ones."""
    plans = list[Path]()
    with suppress(OSError):
        plans += sorted(root.glob(f"*/{PLAN}"))
    for plan in plans:
        with suppress(OSError):
            if writing_state(plan.parent).startswith("interrupted"):
                yield plan.parent
