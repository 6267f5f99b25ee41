"""A rig of a plan, in a world: starts its processes, lets its steps happen, and looks at what is left."""

import asyncio
import contextlib
import contextvars
import functools
from collections import Counter
from collections.abc import Callable, Collection, Coroutine, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from unittest.mock import patch
from weakref import WeakKeyDictionary

from capture_app.common.address import Address
from capture_app.common.errors import SimulshotError
from capture_app.common.node_state import NodeState
from capture_app.net.channel import Channel
from capture_app.node import joining
from capture_app.node.burst.burst_session import BurstSession
from capture_app.node.camera import burst_upload
from capture_app.node.camera.camera_node import CameraNode
from capture_app.node.camera.supervisor import NodeOptions
from capture_app.node.leader.bursts import ActiveBursts
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.node.leader.standby import lead_by_rank
from capture_app.node.relay_node import RelayNode, RelayOptions
from capture_app.protocol.log import Log
from capture_app.protocol.messages import CameraReport, FilmPart, ImageUpload
from capture_app.protocol.status import BurstStatus
from capture_app.rig.rig_link import LinkLost, RigLink, ask_status
from capture_app.rig.taking import Begun, Failed, Progress, Saved, TakePlan, Taking
from capture_app.sync.phase import frame_line
from capture_app.sync.rig.frame_selection import Burst
from capture_app.sync.timekeeping import poll_schedule
from capture_app.trust.trust import Trust
from tests.virtual.cameras import Device, VirtualCamera
from tests.virtual.network import Link
from tests.virtual.plan import Plan, Step
from tests.virtual.world import Process, World, process

PORT = 47010
RARE = {
    "first_interval_ns": 20_000_000,
    "easing_intervals_ns": (60_000_000,),
    "poll_interval_ns": 500_000_000,
    "near_ns": 0,
}
"""Intervals of the exchanges between a node and its leader."""
FEW: dict[str, Any] = {
    "FIRST_SAMPLES": 100,
    "EASING_SAMPLES": 50,
    "SPACING_NS": 20_000_000,
    "TREE_INTERVAL_NS": 200_000_000,
}
"""Exchanges after a node's start, and those of relays and standbys."""
SEARCH_EVERY_FRAMES = 60
"""Frames between searches for a step of the timestamps: these cameras have none."""
ESTIMATE_EVERY_NS = 400_000_000
"""Interval of a node's estimates of its clock: each takes in what one exchange or two have shown."""
MAX_WAIT_S = 330.0
"""Time after everything is healed within which every burst has ended and every spool is empty."""
RESTART_S = 2.0
"""Time after which a process that ended by itself is started again."""


class MachineClock:
    """A machine's clock: an offset, a skew, and slews of an NTP daemon."""

    def __init__(self, world: World, machine: str) -> None:
        chance = world.chance("clock", machine)
        self._world = world
        self._offset_ns, self._ppm = round(chance.uniform(1, 9) * 3.6e12), chance.uniform(-50, 50)
        self._slews: list[tuple[int, int, float]] = []

    def slew(self, ppm: float, seconds: float) -> None:
        """Run faster by so much for a while, from now on."""
        now_ns = self._world.now_ns
        self._slews.append((now_ns, now_ns + round(seconds * 1e9), ppm))

    def local_from_true(self, true_ns: int) -> int:
        """Return the reading at a true time, ns."""
        gained = self._ppm * (true_ns - 10**12) / 1e6
        for begins_ns, ends_ns, ppm in self._slews:
            gained += ppm * max(0, min(true_ns, ends_ns) - begins_ns) / 1e6
        return true_ns + self._offset_ns + round(gained)

    def true_from_local(self, local_ns: int) -> int:
        """Return the true time of a reading, to some ns."""
        true_ns = local_ns - self._offset_ns
        for _ in range(4):
            true_ns += local_ns - self.local_from_true(true_ns)
        return true_ns

    def now_ns(self) -> int:
        """Return the reading now."""
        return self.local_from_true(self._world.now_ns)


@dataclass(slots=True)
class OrderedBurst:
    """A burst as its leader ordered it, and what may excuse a missing image of it."""

    key: tuple[int, int]
    name: str
    burst: Burst
    clock: Any
    """The leader's clock."""
    ordered_ns: int
    """True time of the order."""
    ready: tuple[str, ...]
    folder: Path
    machine: str
    session: BurstSession
    cancelled: bool = False
    ended_ns: int | None = None
    """True time when the operator was told that it is over."""

    def last_ns(self) -> int:
        """True time of the last instant."""
        instants = self.session.burst.instants_ns
        return int(self.clock.true_from_local(instants[-1]))


@dataclass(slots=True)
class Take:
    """What an operator was told of a take."""

    step: Step
    begun_ns: int
    status: BurstStatus | None = None
    result: str = ""
    """"saved", or the error."""


@dataclass(slots=True)
class Span:
    """A fault: from when to when it befell a machine."""

    target: str
    kind: str
    from_ns: int
    until_ns: int


@dataclass
class Evidence:
    """What is needed to judge a run."""

    bursts: list[OrderedBurst] = field(default_factory=list)
    takes: list[Take] = field(default_factory=list)
    spans: list[Span] = field(default_factory=list)
    confirmed: dict[tuple[int, int, str, int], str] = field(default_factory=dict)
    """Checksums of the images that a node counts as safe: by leader's run, burst, camera, ordered instant."""
    log_lines: Counter[str] = field(default_factory=Counter)


class VirtualRig:
    """The machines of a plan; `await rig.run()` in its world is its whole evening."""

    def __init__(self, world: World, plan: Plan) -> None:
        self.world, self.plan = world, plan
        self.evidence = Evidence()
        self.leaders: dict[str, LeaderNode] = {}
        """The leading nodes, by machine."""
        self.devices = {name: Device() for name in plan.cameras}
        self.clocks: dict[str, MachineClock] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._down: Counter[str] = Counter()
        self.reported: WeakKeyDictionary[Channel[Any], CameraReport] = WeakKeyDictionary()
        """The last report on each stream."""
        self.absent_leaders: set[str] = set()
        """Machines that do not lead in the end: images of their bursts wait for them."""
        self.inside = self.total = 0
        """Images whose true time is within the stated 95 % bar, and all."""
        self.works: dict[str, Callable[[], Coroutine[Any, Any, None]]] = {}
        for machine in ("lead", "lead2", "relay", "desk", *plan.cameras):
            world.network.host(machine)
            (world.disks.of(machine).folder / "sessions").mkdir()
            world.disks.settle(machine)
            self.clocks[machine] = MachineClock(world, machine)
        self.works["lead"] = lambda: self._lead("lead")
        if plan.has_standby:
            self.works["lead2"] = lambda: self._lead("lead2")
        if plan.behind_relay:
            self.works["relay"] = self._relay
        for name in plan.cameras:
            self.works[name] = functools.partial(self._camera, name)
        if plan.wifi:
            world.network.shape = _as_wifi
        world.on_end = self._restart_later

    # Processes

    @property
    def _leaders(self) -> tuple[Address, ...]:
        machines = ("lead", "lead2") if self.plan.has_standby else ("lead",)
        return tuple(Address(self.world.network.host(machine), PORT) for machine in machines)

    def _log(self, name: str) -> Log:
        def show(line: str) -> None:
            self.evidence.log_lines[name] += 1
            self.world.note(name, line)

        return Log(show, name=None if name.startswith(("lead", "relay")) else name)

    async def _lead(self, machine: str) -> None:
        def options() -> LeaderOptions:
            return LeaderOptions(
                sessions=self.world.disks.of(machine).folder / "sessions",
                host=self.world.network.host(machine),
                port=PORT,
                trust=Trust.open(),
                clock=self.clocks[machine],
                log=self._log(machine),
            )

        async def lead(node: LeaderNode) -> None:
            self.leaders[machine] = node
            self.world.note(machine, "leads")
            try:
                await asyncio.Event().wait()
            finally:
                self.leaders.pop(machine, None)

        await lead_by_rank(options, self._leaders if self.plan.has_standby else (), lead)

    async def _camera(self, name: str) -> None:
        below = name in self.plan.behind_relay
        relay = Address(self.world.network.host("relay"), PORT)
        clock = self.clocks[name]
        options = NodeOptions(
            name=name,
            open_camera=lambda: VirtualCamera(
                self.world,
                name,
                clock,
                self.devices[name],
                drops=self.plan.drops,
                image_bytes=self.plan.image_bytes,
                lie=self.plan.liars.get(name, ""),
            ),
            leaders=(relay,) if below else self._leaders,
            clock=clock,
            spool=self.world.disks.of(name).folder / "spool",
            trust=Trust.open(),
            log=self._log(name),
        )
        await CameraNode(options).run()

    async def _relay(self) -> None:
        options = RelayOptions(
            name="relay",
            parents=self._leaders,
            host=self.world.network.host("relay"),
            port=PORT,
            trust=Trust.open(),
            clock=self.clocks["relay"],
            log=self._log("relay"),
        )
        async with await RelayNode.start(options):
            await asyncio.Event().wait()

    def _start(self, name: str) -> None:
        self.world.network.switch(name, on=True)
        self.world.start(name, name, self.works[name])

    def _restart_later(self, one: Process, error: Exception | None) -> None:
        """Start a process again that has ended, as a service manager does."""
        if error is not None and not isinstance(error, SimulshotError):
            self.world.fail(f"{one.name} ended with {type(error).__name__}: {error}")
        if not self._down[one.name]:
            self._do(self._again(one), contextvars.Context())

    async def _again(self, one: Process) -> None:
        self._befell(one.name, "kill", RESTART_S)
        self._down[one.name] += 1
        await self.world.kill(one.name)
        await asyncio.sleep(RESTART_S)
        self._down[one.name] -= 1
        if not self._down[one.name]:
            self._start(one.name)

    def _do(self, work: Coroutine[Any, Any, None], context: contextvars.Context | None = None) -> None:
        """Run a coroutine as a task, by default as the running process."""
        task = self.world.loop.create_task(work, context=context)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # The evening

    async def run(self) -> None:
        """Run the plan to its end, heal everything, wait until all is at rest, and stop."""
        plan, world = self.plan, self.world
        for name in self.works:
            self._start(name)
        world.start("desk", "desk", self._watch)
        ends_s = max([plan.seconds, *(step.at_s + step.seconds for step in plan.steps)])
        for step in plan.steps:
            world.at(world.now_ns + round(step.at_s * 1e9), lambda step=step: self._happen(step))  # type: ignore[misc]
        await asyncio.sleep(ends_s + 1)
        for machine in self.works:
            world.network.cut(machine, is_cut=False)
        await self._end_recordings()
        await self._rest()
        if "lead2" in self.leaders and "lead" not in self.leaders:
            # What the first leader had begun waits for it: the standby hands over.
            self._befell("lead2", "stop", 0.0)
            await world.stop("lead2")
            await self._rest()
        self.absent_leaders = {"lead", "lead2"} - {*self.leaders}
        await self._judge_at_rest()
        for name in ("desk", *[name for name in self.works if not name.startswith("lead")]):
            await world.stop(name)
        for name in ("lead2", "lead"):
            if name in self.works:
                await world.stop(name)

    async def _end_recordings(self) -> None:
        """End what is still recorded: its operator may have lost the leader when it was to end."""
        for node in self.leaders.values():
            for session in node.bursts._bursts.values():
                if session.burst.video and not session.finished.is_set():
                    await node.bursts.end(session.burst.number)

    async def _rest(self) -> None:
        """Wait until all takes are over and all spools are empty, at most MAX_WAIT_S after the last fault."""
        begun_ns = self.world.now_ns
        quiet = 0
        while quiet < 3:
            # A process may be killed at a step of its disk that it takes only now.
            healed_ns = max([begun_ns, *(span.until_ns for span in self.evidence.spans)])
            if self.world.now_ns >= healed_ns + MAX_WAIT_S * 1e9:
                break
            await asyncio.sleep(2)
            over = all(take.result for take in self.evidence.takes)
            elsewhere = {"lead", "lead2"} - {*self.leaders}
            waiting = self.spooled(but_for=elsewhere if self.leaders else set())
            quiet = quiet + 1 if over and not waiting and not self._open_bursts() else 0

    def spooled(self, but_for: Collection[str] = ()) -> list[str]:
        """Return the images in the spools of honest cameras, but those of bursts of these machines.

        Nor those of an order that nobody was answered: on a slow disk a leader can be killed before the
        burst's plan is on it, but after cameras learned of the burst, which say where its images are.
        """
        honest = [name for name in self.plan.cameras if name not in self.plan.liars]
        root = self.world.disks.root
        runs = {f"{of.key[0]:08x}" for of in self.evidence.bursts if of.machine in but_for}
        answered = {"{:08x}-{:06}".format(*of.key) for of in self.evidence.bursts}
        return [
            str(path.relative_to(root))
            for name in honest
            for path in (self.world.disks.of(name).folder / "spool").rglob("*")
            if path.suffix in (".jpg", ".film")
            and path.parent.name in answered
            and path.parent.name.split("-")[0] not in runs
        ]

    def _open_bursts(self) -> list[str]:
        """Return the bursts under way, but saved ones that only a liar opens again and again."""
        liars = {*self.plan.liars}
        return [
            session.status.name
            for node in self.leaders.values()
            for session in (*node.bursts._bursts.values(), *node.bursts.resumed.sessions())
            if not session.finished.is_set()
            and not (
                session.session is not None
                and all(
                    of.is_complete(session._choice) or of.name in liars for of in session._deliveries.values()
                )
            )
        ]

    async def _judge_at_rest(self) -> None:
        for take in self.evidence.takes:
            if not take.result:
                self.world.fail(f"the take {take.step} never ended; last: {_short(take.status)}")
        for name in self._open_bursts():
            self.world.fail(f"{name} is still under way")

    # Faults

    def _befell(self, target: str, kind: str, seconds: float) -> None:
        now_ns = self.world.now_ns
        self.evidence.spans.append(Span(target, kind, now_ns, now_ns + round(seconds * 1e9)))

    def _happen(self, step: Step) -> None:
        if step.target == "desk":
            self.world.note("desk", str(step))
            self._order(step)
            return
        if step.target not in self.works:
            return
        self.world.note(step.target, str(step))
        self._befell(step.target, step.kind, step.seconds)
        self._do(self._fault(step))

    async def _fault(self, step: Step) -> None:
        """Let one fault happen, and be over."""
        await getattr(self, f"_{step.kind.replace('-', '_')}")(step)

    async def _kill(self, step: Step) -> None:
        await self._down_for(step, self.world.kill(step.target))

    async def _stop(self, step: Step) -> None:
        is_up = not self._down[step.target]
        await self._down_for(step, (self.world.stop if is_up else self.world.kill)(step.target))

    async def _power(self, step: Step) -> None:
        self.world.network.switch(step.target, on=False)

        async def cut() -> None:
            await self.world.kill(step.target)
            disk = self.world.disks.of(step.target)
            disk.is_failing = disk.is_full = False
            self.world.disks.cut_power(step.target)

        await self._down_for(step, cut())

    async def _down_for(self, step: Step, ends: Coroutine[Any, Any, None]) -> None:
        """End a process, and start it again when nothing keeps it down any more."""
        self._down[step.target] += 1
        await ends
        await asyncio.sleep(step.seconds)
        self._down[step.target] -= 1
        if not self._down[step.target]:
            self._start(step.target)

    async def _kill_at_disk_step(self, step: Step) -> None:
        if (one := self.world.processes[step.target]).is_alive:
            self.world.disks.kill_after[one] = max(1, round(step.value))

    async def _freeze(self, step: Step) -> None:
        one = self.world.processes[step.target]
        self.world.freeze(step.target)
        await asyncio.sleep(step.seconds)
        self.world.thaw(one)

    async def _cut(self, step: Step) -> None:
        self.world.network.cut(step.target, is_cut=True)
        await asyncio.sleep(step.seconds)
        self.world.network.cut(step.target, is_cut=False)

    async def _changed(self, things: Iterable[Any], name: str, value: Any, seconds: float) -> None:
        """Give things another value for a while."""
        before = [(of, getattr(of, name)) for of in things]
        for of, _ in before:
            setattr(of, name, value)
        await asyncio.sleep(seconds)
        for of, old in before:
            setattr(of, name, old)

    async def _loss(self, step: Step) -> None:
        await self._changed(self.world.network.links_of(step.target), "loss", step.value, step.seconds)

    async def _slow_link(self, step: Step) -> None:
        links = self.world.network.links_of(step.target)
        await self._changed(links, "bytes_per_s", step.value, step.seconds)

    async def _late_link(self, step: Step) -> None:
        links = self.world.network.links_of(step.target)
        await self._changed(links, "jitter_ns", step.value * 1e6, step.seconds)

    async def _disk_full(self, step: Step) -> None:
        await self._changed([self.world.disks.of(step.target)], "is_full", True, step.seconds)

    async def _disk_failing(self, step: Step) -> None:
        await self._changed([self.world.disks.of(step.target)], "is_failing", True, step.seconds)

    async def _disk_slow(self, step: Step) -> None:
        await self._changed([self.world.disks.of(step.target)], "mean_delay_s", step.value, step.seconds)

    async def _camera_stall(self, step: Step) -> None:
        await self._changed([self.devices[step.target]], "is_stalled", True, step.seconds)

    async def _camera_lost(self, step: Step) -> None:
        device, one = self.devices[step.target], self.world.processes[step.target]
        if device.opened is not None:
            self.world.within(one, device.opened.fail)
        await self._changed([device], "is_lost", True, step.seconds)

    async def _clock_slew(self, step: Step) -> None:
        self.clocks[step.target].slew(step.value, step.seconds)

    # The operator

    def _address(self) -> Address:
        """Return the leader's address that the operator tries: the one that leads, if any does."""
        machine = next(iter(self.leaders), "lead")
        return Address(self.world.network.host(machine), PORT)

    def _order(self, step: Step) -> None:
        options: dict[str, Any] = {"frames": round(step.value)}
        if step.kind == "series":
            options = {"frames": 3, "repeat": round(step.value), "every_s": step.seconds}
        elif step.kind == "recording":
            # A value is the ordered length in s; else the operator ends it after the step's seconds.
            options = {"video": True, "seconds": step.value or None}
        plan = TakePlan(wait_ready_s=5, **options)
        self.world.within(self.world.processes["desk"], lambda: self._do(self._take(step, plan)))

    async def _take(self, step: Step, plan: TakePlan) -> None:
        take = Take(step, self.world.now_ns)
        self.evidence.takes.append(take)
        taking = Taking(RigLink(self._address()), plan)
        results = []
        try:
            async for event in taking:
                if isinstance(event, Progress):
                    take.status = event.status
                if isinstance(event, Begun) and step.kind == "recording" and step.seconds:
                    self.world.loop.call_later(step.seconds, lambda: self._soon(taking.end()))
                if isinstance(event, Begun) and step.kind == "cancel":
                    self._soon(self._cancel(taking))
                if isinstance(event, Saved):
                    take.status = event.status
                    results.append("saved")
                if isinstance(event, Failed):
                    results.append(f"{type(event.error).__name__}: {event.error}")
        except SimulshotError as error:
            results.append(f"{type(error).__name__}: {error}")
        take.result = "; ".join(results) or "nothing"
        self.world.note("desk", f"{step.kind}: {take.result}; {_short(take.status)}"[:300])

    def _soon(self, work: Coroutine[Any, Any, None]) -> None:
        async def done() -> None:
            with contextlib.suppress(SimulshotError):
                await work

        self._do(done())

    async def _cancel(self, taking: Taking) -> None:
        for of in self.evidence.bursts:
            if any(status.burst == of.key[1] for status in taking._active.values()):
                of.cancelled = True
        await taking.cancel()

    async def _follow(self) -> None:
        """Follow one leader's status and log after the other, as a screen does."""
        while True:
            async with contextlib.aclosing(RigLink(self._address()).updates()) as updates:
                async for update in updates:
                    if isinstance(update, LinkLost):
                        break
            await asyncio.sleep(1)

    async def _watch(self) -> None:
        """Ask for the status at intervals, and see that it comes."""
        following = asyncio.create_task(self._follow())
        while not following.done():
            await asyncio.sleep(5)
            asked_ns, undisturbed = self.world.now_ns, self.undisturbed_since("lead", "lead2", "relay")
            try:
                async with asyncio.timeout(30):
                    await ask_status(self._address())
            except (SimulshotError, TimeoutError) as error:
                late, why = True, f"{type(error).__name__}: {error}"
            else:
                late, why = self.world.now_ns - asked_ns > 3e9, "late"
            if late and undisturbed > 15 and self.undisturbed_since("lead", "lead2", "relay") > 15:
                self.world.fail(f"a status asked for at {(asked_ns - 10**12) / 1e9:.1f} s: {why}")

    def undisturbed_since(self, *targets: str) -> float:
        """Return for how long nothing has befallen these machines, s."""
        now_ns = self.world.now_ns
        ends = [min(span.until_ns, now_ns) for span in self.evidence.spans if span.target in targets]
        return (now_ns - max(ends, default=10**12)) / 1e9

    # What is noted

    @contextlib.contextmanager
    def observed(self) -> Iterator[None]:
        """Note orders and confirmations within the block, and let liars lie."""
        rig = self
        order = ActiveBursts.order

        async def ordering(bursts: ActiveBursts, *arguments: Any, **options: Any) -> BurstSession:
            ready = tuple(
                member.name
                for member in bursts._engine.roster.by_name()
                if member.report.state in (NodeState.READY, NodeState.DEGRADED)
            )
            ordered_ns = rig.world.now_ns
            session: BurstSession = await order(bursts, *arguments, **options)
            one = process.get()
            assert one is not None
            rig.evidence.bursts.append(
                OrderedBurst(
                    (bursts._engine.config.instance, session.burst.number),
                    session.status.name,
                    session.burst,
                    bursts._options.clock,
                    ordered_ns,
                    tuple(name for name in ready if name in session.burst.clients),
                    session.folder,
                    one.machine,
                    session,
                )
            )
            return session

        confirm = burst_upload.Upload.confirm

        def confirming(upload: burst_upload.Upload, stored: Any) -> Any:
            here = upload.images
            for instant, sha256 in stored.items():
                if instant in here and here[instant].record.sha256 == sha256:
                    report = upload.report
                    rig.evidence.confirmed[report.leader, report.burst, report.camera, instant] = sha256
            return confirm(upload, stored)

        send = Channel.send

        async def sending(channel: Channel[Any], message: Any, *payloads: Any, **options: Any) -> None:
            lie = rig.plan.liars.get(getattr(process.get(), "name", ""), "")
            if isinstance(message, CameraReport):
                rig.reported[channel] = message
            while lie == "silent" and isinstance(message, ImageUpload | FilmPart):
                # It says again and again what it has, and sends nothing of it.
                await asyncio.sleep(5)
                await send(channel, rig.reported[channel])
            is_short = isinstance(message, CameraReport) and message.plan.picked is None
            if lie in ("nothing", "partial") and is_short and not message.plan.picking:
                left = message.plan.instants[:1] if lie == "partial" else ()
                message = message.with_plan(instants=left, missing=())
            await send(channel, message, *payloads, **options)

        def estimated(schedule: poll_schedule.SteadySchedule, now_ns: int) -> None:
            schedule.estimate_due_ns = now_ns + ESTIMATE_EVERY_NS

        # Exchanges are most of the work of a rig at rest: these nodes ask as seldom as among thousands.
        with (
            patch.object(ActiveBursts, "order", ordering),
            patch.object(burst_upload.Upload, "confirm", confirming),
            patch.object(Channel, "send", sending),
            patch.object(joining, "power_saving_towards", lambda _: None),
            patch.object(poll_schedule.SteadySchedule.__init__, "__kwdefaults__", dict(RARE)),
            patch.object(poll_schedule.SteadySchedule, "estimated", estimated),
            patch.multiple(poll_schedule, **FEW),
            patch.object(frame_line, "EVERY_FRAMES", SEARCH_EVERY_FRAMES),
        ):
            yield


def _short(status: BurstStatus | None) -> str:
    if status is None:
        return "no status"
    return f"{status.name} {status.received}/{status.expected} {status.message[:120]}"


def _as_wifi(source: str, target: str, link: Link) -> None:
    link.base_ns, link.jitter_ns = 800_000, 1_500_000
    link.loss, link.double, link.bytes_per_s = 0.01, 0.002, 2e6
