"""Python interface to a rig: starts cameras or joins a leader, and returns bursts as open sessions."""

import asyncio
import contextlib
import contextvars
from collections.abc import AsyncGenerator, Coroutine, Sequence
from concurrent.futures import ThreadPoolExecutor
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from capture_app.common import system
from capture_app.common.address import Address, parse_address
from capture_app.common.errors import BadInputError, IncompleteError, NotAvailableError, SimulshotError
from capture_app.common.node_state import NodeState
from capture_app.common.stagger import Stagger
from capture_app.common.timeouts import READY_TIMEOUT_S, RIG_STOP_TIMEOUT_S
from capture_app.protocol.orders import AddSimulated, StopRig
from capture_app.protocol.status import RigStatus
from capture_app.rig.instant_previews import InstantPreviews, instant_previews
from capture_app.rig.process import start_rig
from capture_app.rig.rig_link import RigLink, ask_status, give_order, present_cameras
from capture_app.rig.rig_time import LeaderTime, PlacedMark, place_mark, rig_time
from capture_app.rig.taking import Saved, TakePlan, Taking
from capture_app.session.reading.array_access import OpenSession

T = TypeVar("T")
LOOK_EVERY_S = 0.2


class AsyncRig:
    """A rig for asyncio within its `async with` block: one that runs already, or one of its own.

    `leader`: HOST or HOST:PORT of a running rig, here or elsewhere, which keeps running after the block.
    Without one, a rig of this machine is started with `simulated` cameras that look at `scene`, and with
    `cameras` (specs as `capture-app cameras` shows them); it saves to `sessions`, and ends with the
    block. With `stagger`, its cameras take their frames one after the other: "even", or a delay for each,
    "cam0=0ms,cam1=8.3ms".
    """

    def __init__(
        self,
        leader: str | None = None,
        *,
        simulated: int = 0,
        scene: str = "studio",
        cameras: Sequence[str] = (),
        stagger: str | None = None,
        sessions: str | PathLike[str] = "sessions",
    ) -> None:
        if leader is not None and (simulated or cameras or stagger):
            raise BadInputError(
                f"both a leader and {'cameras' if simulated or cameras else 'stagger'} are given",
                hint="a leader joins a running rig; the others start a new one here: give one of them",
            )
        try:
            self._leader = None if leader is None else parse_address(leader)
        except ValueError as error:
            raise BadInputError(str(error), hint="such as 192.168.1.20:47010") from error
        self._simulated = AddSimulated(cameras=simulated, scene=scene) if simulated else None
        self._cameras = tuple(cameras)
        self._stagger = None if stagger is None else Stagger.parse(stagger)
        self._sessions = Path(sessions)
        self._pid: int | None = None

    async def __aenter__(self) -> Self:
        """Find the rig, or start it. Raises NetworkError, BadInputError for a scene without such views."""
        if self._leader is not None:
            await ask_status(self._leader)
            return self
        # Simulated cameras are processes of this machine, so no other machine needs access.
        host = "0.0.0.0" if self._cameras else "127.0.0.1"  # noqa: S104
        rig = await start_rig(
            sessions=self._sessions, host=host, cameras=self._cameras, stagger=self._stagger, is_owned=True
        )
        self._leader, self._pid = rig.address, rig.pid
        if self._simulated is not None:
            try:
                await give_order(self._leader, self._simulated)
            except BaseException:
                await self._stop()
                raise
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the rig if it was started here."""
        if self._pid is not None:
            await self._stop()

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self._leader or 'outside of its with block'}>"

    @property
    def address(self) -> Address:
        """Address of the leader. Raises NotAvailableError outside of the `with` block."""
        if self._leader is None:
            raise NotAvailableError("the rig is not running", hint="use it in a with block")
        return self._leader

    async def status(self) -> RigStatus:
        """Return the status of the rig and all its nodes. Raises NetworkError."""
        return await ask_status(self.address)

    async def wait_until_ready(self, cameras: int = 1, timeout_s: float = READY_TIMEOUT_S) -> RigStatus:
        """Wait until at least `cameras` cameras are here and all present ones are ready.

        Raises IncompleteError, with a remedy, on timeout.
        """
        until_s = system.monotonic_s() + timeout_s
        while True:
            status = await self.status()
            here = present_cameras(status)
            ready = [node.name for node in status.nodes if node.state is NodeState.READY]
            if len(here) >= cameras and {*here} <= {*ready}:
                return status
            if system.monotonic_s() > until_s:
                raise IncompleteError(
                    f"{len(ready)} of {max(cameras, len(here))} cameras are ready after {timeout_s:g} s",
                    hint=status.advice,
                )
            await asyncio.sleep(LOOK_EVERY_S)

    wait_ready = wait_until_ready

    async def now(self) -> LeaderTime:
        """Return the rig's time now, from the earliest to the latest possible. Raises NetworkError."""
        return await rig_time(self.address)

    async def mark(self, text: str, *, local_ns: int | None = None) -> PlacedMark:
        """Note an event, such as a stimulus, in the take under way, at the time of this call.

        `local_ns`: its `time.perf_counter_ns()` on this machine, if it was earlier. Without a take, the rig
        stores it in a file beside its sessions. Raises BadInputError for an empty or long text, NetworkError.
        """
        return await place_mark(self.address, text, local_ns)

    def take(self, plan: TakePlan) -> Taking:
        """Take pictures: iterate over the events with `async for`, or await its `result()`."""
        return Taking(RigLink(self.address), plan)

    async def burst(self, frames: int = 5, *, name: str = "", note: str = "") -> OpenSession:
        """Take a burst with every camera and return its session when it is saved.

        Raises NotAvailableError where the leader saved it on another machine, IncompleteError where there is
        no session, and the leader's own errors.
        """
        return (await self.take(TakePlan(frames=frames, name=name, note=note)).result()).open()

    async def record(self, seconds: float, *, name: str = "", note: str = "") -> OpenSession:
        """Record a video with every camera and return its session when saved. Raises as `burst` does."""
        return (await self.take(TakePlan(seconds=seconds, video=True, name=name, note=note)).result()).open()

    def previews(
        self, width: int = 640, fps: float = 10.0, cameras: Sequence[str] | None = None
    ) -> AsyncGenerator[InstantPreviews, None]:
        """Yield small images of all cameras at one instant, then at the next, up to `fps` instants a second.

        They are about `width` px wide, and of these `cameras` only, if given. A slow reader skips instants;
        a burst interrupts them. Raises NetworkError.
        """
        return instant_previews(
            RigLink(self.address), cameras=None if cameras is None else tuple(cameras), width=width, fps=fps
        )

    async def preview(self, width: int = 640, wait_s: float = 10.0) -> InstantPreviews:
        """Return small images of all cameras at one instant, now; of fewer if some give none within `wait_s`.

        Raises NetworkError, and IncompleteError if no synchronized camera gives one.
        """
        ready = {node.name for node in (await self.status()).nodes if node.state is NodeState.READY}
        latest: InstantPreviews | None = None
        try:
            async with asyncio.timeout(wait_s), contextlib.aclosing(self.previews(width)) as previews:
                async for instant in previews:
                    if latest is None or len(instant.previews) > len(latest.previews):
                        latest = instant
                    if ready <= instant.previews.keys():
                        break
        except TimeoutError as error:
            if latest is None:
                raise IncompleteError(
                    f"no synchronized camera gave a preview within {wait_s:g} s",
                    hint="see their states: capture-app status",
                ) from error
        assert latest is not None, "previews end with an error"
        return latest

    async def _stop(self) -> None:
        """End the rig that was started here, and wait until its process has ended."""
        pid, leader = self._pid, self.address
        self._pid = self._leader = None
        assert pid is not None
        with contextlib.suppress(SimulshotError):
            await give_order(leader, StopRig())
        for _ in range(round(RIG_STOP_TIMEOUT_S / LOOK_EVERY_S)):
            if not system.is_running(pid):
                break
            await asyncio.sleep(LOOK_EVERY_S)


class Rig:
    """A rig within its `with` block, whose calls return when they are done; otherwise as `AsyncRig`."""

    def __init__(
        self,
        leader: str | None = None,
        *,
        simulated: int = 0,
        scene: str = "studio",
        cameras: Sequence[str] = (),
        stagger: str | None = None,
        sessions: str | PathLike[str] = "sessions",
    ) -> None:
        self._rig = AsyncRig(
            leader, simulated=simulated, scene=scene, cameras=cameras, stagger=stagger, sessions=sessions
        )

    def __enter__(self) -> Self:
        """Find the rig, or start it. Raises as in `AsyncRig`."""
        _run(self._rig.__aenter__())
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the rig if it was started here."""
        _run(self._rig.__aexit__(kind, error, trace))

    def __repr__(self) -> str:
        return repr(self._rig).replace(type(self._rig).__name__, type(self).__name__)

    @property
    def address(self) -> Address:
        """Address of the leader. Raises NotAvailableError outside of the `with` block."""
        return self._rig.address

    def status(self) -> RigStatus:
        """Return the status of the rig and all its nodes. Raises NetworkError."""
        return _run(self._rig.status())

    def wait_until_ready(self, cameras: int = 1, timeout_s: float = READY_TIMEOUT_S) -> RigStatus:
        """Wait until at least `cameras` cameras are here and all are ready. Raises IncompleteError."""
        return _run(self._rig.wait_until_ready(cameras, timeout_s))

    wait_ready = wait_until_ready

    def now(self) -> LeaderTime:
        """Return the rig's time now, from the earliest to the latest possible. Raises NetworkError."""
        return _run(self._rig.now())

    def mark(self, text: str, *, local_ns: int | None = None) -> PlacedMark:
        """Note an event in the take under way, at the time of this call. Raises as in `AsyncRig`."""
        called_ns = system.monotonic_ns() if local_ns is None else local_ns
        return _run(self._rig.mark(text, local_ns=called_ns))

    def take(self, plan: TakePlan) -> Saved:
        """Take pictures, and return the last saved take. Raises the first error of a take."""
        return _run(self._rig.take(plan).result())

    def burst(self, frames: int = 5, *, name: str = "", note: str = "") -> OpenSession:
        """Take a burst with every camera and return its session. Raises as in `AsyncRig`."""
        return _run(self._rig.burst(frames, name=name, note=note))

    def record(self, seconds: float, *, name: str = "", note: str = "") -> OpenSession:
        """Record a video with every camera and return its session. Raises as in `AsyncRig`."""
        return _run(self._rig.record(seconds, name=name, note=note))

    def preview(self, width: int = 640, wait_s: float = 10.0) -> InstantPreviews:
        """Return small images of all cameras at one instant, now. Raises as in `AsyncRig`."""
        return _run(self._rig.preview(width, wait_s))


def _run(work: Coroutine[Any, Any, T]) -> T:
    """Run a coroutine to its end, also in a notebook, where a loop is already running."""
    try:
        asyncio.get_running_loop()
    except RuntimeError:
        return asyncio.run(work)
    with ThreadPoolExecutor(1) as thread:
        # The trust in use applies in that thread, too.
        return thread.submit(contextvars.copy_context().run, asyncio.run, work).result()
