"""Virtual time: an event loop whose clock jumps to the next timer, processes on it, and their chance.

All processes of a rig run as tasks of one loop. A context variable tells which one is running, so that
sockets, disks and random numbers are its own. Each source of chance has a generator of its own, named after
what it is for: the order in which two machines act at the same moment changes nothing.
"""

import asyncio
import contextlib
import contextvars
import hashlib
import random
import secrets
import selectors
import time
import weakref
from collections import deque
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any
from unittest.mock import patch

from capture_app.common import host_clock, system
from capture_app.common.host_clock import HostReadings, read_pair

START_NS = 1_000_000_000_000
WALL_NS = 1_790_000_000_000_000_000
CPU_NS = time.thread_time_ns
"""Processor time of this thread, which no other work on the machine lengthens."""
TIMER_SLACK, TIMER_SLACK_S = 1e-4, 1e-6
"""What a timer is late by: a fraction of its delay, above the skew of any machine's clock, and some more. One
that is early by that clock finds nothing due, and is set again."""
FREEZE_STEPS = 5_000
"""Steps of the loop at one moment of virtual time after which it counts as stuck; five evenings had 112."""
STOP_S = 20.0
"""Time within which a process ends that is stopped."""

process: contextvars.ContextVar["Process | None"] = contextvars.ContextVar("process", default=None)
"""The process whose code is running; None for the world's own."""


class StuckError(Exception):
    """The loop goes round without letting time pass."""


class KilledError(BaseException):
    """Raised in code of a process that was killed, so that it does nothing more."""


@dataclass(eq=False)
class Process:
    """One process of a machine; a name may have several, one after the other."""

    name: str
    machine: str
    """The name of its disk and its place in the network."""
    run: int
    rng: random.Random
    """What `secrets` gives this process."""
    is_alive: bool = True
    is_frozen: bool = False
    is_buried: bool = False
    """Nothing of it runs any more."""
    tasks: "weakref.WeakSet[asyncio.Task[Any]]" = field(default_factory=weakref.WeakSet)
    main: "asyncio.Task[Any] | None" = None
    frozen: list[asyncio.Handle] = field(default_factory=list)
    """What has become due while the process was suspended."""
    on_death: list[Callable[[], None]] = field(default_factory=list)


class _NoSelector(selectors.BaseSelector):
    """Selector without files: nothing is ever readable, and waiting lets virtual time pass."""

    def __init__(self, world: "World") -> None:
        self._world = world

    def register(self, fileobj: Any, events: int, data: Any = None) -> selectors.SelectorKey:
        return selectors.SelectorKey(fileobj, 0, events, data)

    def unregister(self, fileobj: Any) -> selectors.SelectorKey:
        return selectors.SelectorKey(fileobj, 0, 0, None)

    def get_map(self) -> dict[Any, Any]:
        return {}

    def select(self, timeout: float | None = None) -> list[Any]:
        self._world.pass_time(timeout)
        return []


class VirtualLoop(asyncio.SelectorEventLoop):
    """Event loop of all processes; what they would do in threads happens on it, after the disk's delay."""

    def __init__(self, world: "World") -> None:
        super().__init__(_NoSelector(world))
        self.world = world
        self._clock_resolution = 1e-9
        self.set_task_factory(OwnedTask.of)
        self._queues: weakref.WeakKeyDictionary[ThreadPoolExecutor, _Worker] = weakref.WeakKeyDictionary()

    def time(self) -> float:
        """Return the virtual time, s."""
        return self.world.now_ns / 1e9

    def call_later(  # type: ignore[override]
        self, delay: float, callback: Any, *args: Any, context: Any = None
    ) -> asyncio.TimerHandle:
        """Call after a delay, never early by the clock of any machine."""
        late_s = delay * TIMER_SLACK + TIMER_SLACK_S if delay > 0 else 0.0
        return self.call_at(self.time() + delay + late_s, callback, *args, context=context)

    def run_in_executor(self, executor: Any, func: Callable[..., Any], *args: Any) -> Any:  # type: ignore[override]
        """Run `func` on the loop, as late as the machine's disk is slow; a single thread keeps its order."""
        future: asyncio.Future[Any] = self.create_future()
        owner = process.get()
        context = contextvars.copy_context()

        def work() -> None:
            if future.cancelled() or (owner is not None and not owner.is_alive):
                return
            begun_ns = CPU_NS()
            try:
                self.world.in_thread = True
                result = context.run(func, *args)
            except KilledError:
                return
            except BaseException as error:
                if not future.cancelled():
                    future.set_exception(error)
            else:
                if not future.cancelled():
                    future.set_result(result)
            finally:
                self.world.in_thread = False
                self.world.in_threads_ns += CPU_NS() - begun_ns

        delay_s = 0.0 if owner is None else self.world.disks.delay_s(owner.machine)
        if isinstance(executor, ThreadPoolExecutor) and getattr(executor, "_max_workers", 2) == 1:
            self._queues.setdefault(executor, _Worker(self)).add(delay_s, work)
        elif delay_s:
            self.call_later(delay_s, work)
        else:
            self.call_soon(work)
        return future

    # Real sockets and files have no place here.

    async def sock_sendall(self, sock: Any, data: Any) -> None:
        """Send over a connected virtual socket."""
        sock.sendto(bytes(data), sock.peer)

    async def sock_recv(self, sock: Any, _: int) -> bytes:
        """Receive on a virtual socket."""
        while not sock.queue:  # noqa: ASYNC110 - a reader is for the pump
            await asyncio.sleep(0.01)
        return bytes(sock.recvmsg()[0])

    def add_reader(self, fd: Any, callback: Callable[..., Any], *args: Any) -> None:  # type: ignore[override]
        """Call back when a virtual socket has something to read."""
        self.world.network.watch(fd, asyncio.Handle(callback, args, self, contextvars.copy_context()))

    def remove_reader(self, fd: Any) -> bool:
        """Stop watching a virtual socket."""
        return self.world.network.unwatch(fd)

    async def getaddrinfo(self, host: Any, port: Any, **options: Any) -> Any:
        """Return a numeric address as it is."""
        return self.world.network.getaddrinfo(host, port, **options)

    async def create_connection(  # type: ignore[override]
        self, factory: Any, host: Any = None, port: Any = None, **options: Any
    ) -> Any:
        """Connect over the virtual network."""
        return await self.world.network.connect(factory, str(host), int(port), options.get("ssl"))

    async def create_server(  # type: ignore[override]
        self, factory: Any, *_: Any, sock: Any = None, **__: Any
    ) -> Any:
        """Serve on a listening virtual socket."""
        return self.world.network.serve(factory, sock)


class _Worker:
    """The one thread of an executor: its work, in order."""

    def __init__(self, loop: VirtualLoop) -> None:
        self._loop, self._queue = loop, deque[tuple[float, Callable[[], None]]]()

    def add(self, delay_s: float, work: Callable[[], None]) -> None:
        self._queue.append((delay_s, work))
        if len(self._queue) == 1:
            self._loop.call_later(delay_s, self._next)

    def _next(self) -> None:
        _, work = self._queue[0]
        try:
            work()
        finally:
            self._queue.popleft()
            if self._queue:
                self._loop.call_later(self._queue[0][0], self._next)


class OwnedTask(asyncio.Task[Any]):
    """Task that knows its process."""

    owner: Process | None = None

    @classmethod
    def of(cls, loop: asyncio.AbstractEventLoop, work: Any, **options: Any) -> "OwnedTask":
        """Make a task of the running process, for `loop.set_task_factory`."""
        task = cls(work, loop=loop, **options)
        given = options.get("context")
        task.owner = process.get() if given is None else given.get(process)
        if task.owner is not None:
            task.owner.tasks.add(task)
        return task


class World:
    """Virtual time, chance, network and disks of one run; `with world.entered():` puts them in force."""

    def __init__(self, seed: int) -> None:
        from tests.virtual.disk import Disks
        from tests.virtual.network import Network

        self.seed, self.now_ns = seed, START_NS
        self.in_thread = False
        """Whether the running code would run in a thread of its process, not on its event loop."""
        self.in_threads_ns = 0
        """Processor time of all that would have run in threads."""
        self.longest_step_ns: dict[str, int] = {}
        """Longest processor time for which each machine's loop was held by one step."""
        self.network, self.disks = Network(self), Disks(self)
        self.loop = VirtualLoop(self)
        self.trace: list[tuple[int, str, str]] = []
        """What happened: time, machine, words."""
        self._steps = 0
        self._runs: dict[str, int] = {}
        self.processes: dict[str, Process] = {}
        self.slept_ns: Callable[[str], int] = lambda _: 0
        """Returns for how long a machine has slept until now."""
        self.on_end: Callable[[Process, Exception | None], None] = lambda _, __: None
        """Called when a process has ended by itself, with its error; None if it was killed by its disk."""
        self.failures: list[str] = []
        """Broken invariants and unhandled errors."""
        self.loop.set_exception_handler(self._unhandled)
        self._own_rng, self._root = self.chance("world"), contextvars.Context()

    def chance(self, *of: object) -> random.Random:
        """Return a generator for one purpose, the same in every run of the seed."""
        text = "/".join(map(str, (self.seed, *of)))
        return random.Random(int.from_bytes(hashlib.blake2b(text.encode(), digest_size=8).digest()))

    def elapsed_s(self) -> float:
        """Return the virtual time since the start, s."""
        return (self.now_ns - START_NS) / 1e9

    def note(self, machine: str, words: str) -> None:
        """Add to the trace."""
        self.trace.append((self.now_ns - START_NS, machine, words.replace(str(self.disks.root), "")))

    def fail(self, words: str) -> None:
        """Note a broken invariant."""
        self.failures.append(f"{self.elapsed_s():.3f} s: {words}")

    def digest(self) -> str:
        """Return a checksum of the trace and of each link's number of datagrams.

        What happens at one moment on two machines has no order. Times count to 1 ms: Python 3.12 and later
        sum floats more exactly, which moves a timer by a nanosecond.
        """
        lines = [(at_ns // 1_000_000, machine, words) for at_ns, machine, words in self.trace]
        text = "\n".join(f"{at} {machine} {words}" for at, machine, words in sorted(lines))
        text += f"\n{sorted(self.network.counts().items())}"
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def pass_time(self, timeout: float | None) -> None:
        """Let time pass until the loop's next timer."""
        if timeout is None:
            raise StuckError("nothing is going to happen any more")
        if timeout <= 0:
            self._steps += 1
            if self._steps > FREEZE_STEPS:
                raise StuckError(f"the loop does not rest at {self.elapsed_s():.3f} s")
            return
        self._steps = 0
        self.now_ns += max(1, round(timeout * 1e9))

    def within(self, one: Process, work: Callable[[], Any]) -> None:
        """Call something as a process, unless it has ended."""
        if one.is_alive:
            context = contextvars.Context()
            context.run(process.set, one)
            self.loop.call_soon(work, context=context)

    def at(self, at_ns: int, work: Callable[[], None]) -> None:
        """Call at a time, outside of all processes."""
        self.loop.call_at(at_ns / 1e9, work, context=self._root)

    # Processes

    def start(self, name: str, machine: str, work: Callable[[], Coroutine[Any, Any, None]]) -> Process:
        """Start a process that runs this coroutine."""
        run = self._runs[name] = self._runs.get(name, 0) + 1
        started = Process(name, machine, run, self.chance("secrets", name, run))
        self.processes[name] = started
        context = contextvars.copy_context()
        context.run(process.set, started)

        async def main() -> None:
            try:
                await work()
            except asyncio.CancelledError:
                raise
            except Exception as error:
                if started.is_alive:
                    self.note(name, f"ended: {type(error).__name__}: {error}")
                    self.on_end(started, error)
            finally:
                started.is_alive = False

        started.main = context.run(self.loop.create_task, main())
        return started

    async def stop(self, name: str) -> None:
        """End a process in good order, as by Ctrl-C."""
        one = self.processes[name]
        if one.main is not None and not one.main.done():
            one.main.cancel()
            _, hangs = await asyncio.wait([one.main], timeout=STOP_S)
            if hangs and not one.is_frozen:
                self.fail(f"{name} hangs {STOP_S:.0f} s after it was stopped")
        await self.kill(name)

    async def kill(self, name: str) -> None:
        """Kill a process at once: nothing that it would do from now on happens."""
        one = self.processes[name]
        self.note(name, "killed" if one.is_alive else "gone")
        one.is_alive = False
        self.thaw(one)
        self.network.drop(one)
        self.disks.release(one)
        for task in [task for task in one.tasks if not task.done()]:
            task.cancel()
        for _ in range(50):
            if not (left := [task for task in one.tasks if not task.done()]):
                break
            for task in left:
                task.cancel()
            await asyncio.sleep(0)
        one.is_buried = True

    def freeze(self, name: str) -> None:
        """Suspend a process, as by Ctrl-Z or a machine that sleeps."""
        self.processes[name].is_frozen = True

    def thaw(self, one: Process) -> None:
        """Let a suspended process go on."""
        one.is_frozen = False
        for handle in one.frozen:
            if not handle.cancelled():
                self.loop._ready.append(handle)  # type: ignore[attr-defined]
        one.frozen.clear()

    def _unhandled(self, _: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        error = context.get("exception")
        task = context.get("task") or context.get("future")
        owner = getattr(task, "owner", None) or process.get()
        if (handle := context.get("handle")) is not None:
            owner = handle._context.get(process)
        if isinstance(error, KilledError) or (owner is not None and not owner.is_alive):
            return
        self.fail(f"unhandled: {context.get('message')}: {error!r}")

    # In force

    @contextlib.contextmanager
    def entered(self) -> Iterator[None]:
        """Put virtual time, chance, network and disks in the place of the host's within the block."""

        def own() -> random.Random:
            one = process.get()
            return self._own_rng if one is None else one.rng

        def clock_ns(_: int) -> int:
            return self.now_ns

        with contextlib.ExitStack() as undo:

            def replaced(module: Any, **values: Any) -> None:
                undo.enter_context(patch.multiple(module, **values))

            replaced(
                time,
                monotonic=lambda: self.now_ns / 1e9,
                time_ns=lambda: WALL_NS + self.now_ns,
                time=lambda: (WALL_NS + self.now_ns) / 1e9,
                clock_gettime_ns=clock_ns,
                sleep=lambda _: None,
            )

            def slept_ns() -> int:
                one = process.get()
                return 0 if one is None else self.slept_ns(one.machine)

            replaced(system, monotonic_ns=lambda: self.now_ns, monotonic_s=lambda: self.now_ns / 1e9)
            # What it has read of the host's clocks, before and afterwards, is of another time.
            replaced(host_clock, _readings=HostReadings(read_pair), slept_ns=slept_ns)
            replaced(
                secrets,
                randbits=lambda bits: own().getrandbits(bits),
                token_bytes=lambda n=32: own().randbytes(n),
                token_hex=lambda n=32: own().randbytes(n).hex(),
                randbelow=lambda n: own().randrange(n),
                choice=lambda of: own().choice(of),
            )
            run_handle = asyncio.Handle._run

            def run(handle: asyncio.Handle) -> None:
                if (owner := handle._context.get(process)) is not None:  # type: ignore[attr-defined]
                    if owner.is_frozen:
                        owner.frozen.append(handle)
                        return
                    if owner.is_buried:
                        return
                    begun_ns, in_threads_ns = CPU_NS(), self.in_threads_ns
                    run_handle(handle)
                    held_ns = CPU_NS() - begun_ns - (self.in_threads_ns - in_threads_ns)
                    if held_ns > self.longest_step_ns.get(owner.machine, 0):
                        self.longest_step_ns[owner.machine] = held_ns
                    return
                run_handle(handle)

            replaced(asyncio.Handle, _run=run)
            undo.enter_context(self.network.entered(replaced))
            undo.enter_context(self.disks.entered(replaced))
            yield

    def run(self, work: Coroutine[Any, Any, None]) -> None:
        """Run the world's own coroutine to its end."""
        asyncio.set_event_loop(self.loop)
        try:
            self.loop.run_until_complete(work)
        finally:
            with contextlib.suppress(Exception):
                self.loop.run_until_complete(self.loop.shutdown_asyncgens())
            asyncio.set_event_loop(None)
            self.loop.close()
