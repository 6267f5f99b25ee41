"""A rig of a plan, in a world: starts its processes, lets its steps happen, and looks at what is left."""

import asyncio
import contextlib
import contextvars
import functools
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Coroutine, Iterable, Iterator
from pathlib import Path
from typing import Any

from capture_app.common.address import Address
from capture_app.common.errors import SimulshotError
from capture_app.common.stagger import Stagger
from capture_app.node.camera.camera_node import CameraNode
from capture_app.node.camera.supervisor import NodeOptions
from capture_app.node.endpoint import PortOptions
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.node.leader.leader_options import LeaderOptions
from capture_app.node.leader.standby import lead_by_rank
from capture_app.node.relay_node import RelayNode
from capture_app.protocol.log import Log
from capture_app.protocol.status import BurstStatus, RigStatus
from capture_app.rig.rig_link import LinkLost, RigLink, ask_status
from capture_app.rig.rig_time import place_mark
from capture_app.rig.taking import Begun, Failed, Progress, Saved, TakePlan, Taking, local_session
from capture_app.trust.trust import Trust
from tests.virtual.cameras import Device, VirtualCamera
from tests.virtual.evidence import Evidence, MarkOfDesk, OrderedBurst, Span, Take, TimeError, Told
from tests.virtual.network import Link
from tests.virtual.observing import READY
from tests.virtual.plan import Plan, Step
from tests.virtual.world import Process, World

PORT = 47010
MAX_WAIT_S = 330.0
"""Time after everything is healed within which every burst has ended and every spool is empty."""
ASYMMETRY = 0.1
"""Standard deviation of the difference of a path's two delays, relative to their sum, as nodes assume it."""
BEACON_NS, AWAKE_NS = 102_400_000, 60_000_000
"""Interval at which a phone that saves power listens, and how long it listens after it has sent something."""
FRAME_NS = 100_000_000
"""Time that a frame takes."""
BOOT_NS = 15_000_000_000
"""Reading of a machine's clock at its start."""
RESTART_S = 2.0
"""Time after which a process that ended by itself is started again."""


class MachineClock:
    """A machine's clock: an offset, a skew, slews of an NTP daemon, and sleeps in which it stands still."""

    def __init__(self, world: World, machine: str) -> None:
        chance = world.chance("clock", machine)
        self._world = world
        offset_ns, self._ppm = round(chance.uniform(1, 9) * 3.6e12), chance.uniform(-50, 50)
        self._slews: list[tuple[int, int, float]] = []
        self._boots: list[tuple[int, int]] = [(0, offset_ns)]
        """True times of the machine's starts, each with its offset."""
        self._sleeps: list[tuple[int, int, int]] = []
        """True times of the machine's sleeps, the first one first, and the clock's error after each, ns."""

    def restart(self) -> None:
        """Begin anew, as at a start of the machine; later readings are converted only."""
        now_ns = self._world.now_ns
        self._boots.append((now_ns, BOOT_NS - now_ns))
        self._sleeps.clear()

    def sleep(self, seconds: float, error_s: float) -> None:
        """Sleep from now on, and get an error by it: that of its measured length; all of it if it stands."""
        now_ns = self._world.now_ns
        self._sleeps.append((now_ns, now_ns + round(seconds * 1e9), round(error_s * 1e9)))

    def slept_ns(self) -> int:
        """Return for how long the machine has slept, ns."""
        return sum(
            ends_ns - begins_ns for begins_ns, ends_ns, _ in self._sleeps if ends_ns <= self._world.now_ns
        )

    def _error_ns(self, true_ns: int) -> int:
        """Return the clock's error by sleeps until a true time, ns."""
        return sum(
            error_ns * min(true_ns - begins_ns, ends_ns - begins_ns) // (ends_ns - begins_ns)
            for begins_ns, ends_ns, error_ns in self._sleeps
            if true_ns > begins_ns
        )

    def slew(self, ppm: float, seconds: float) -> None:
        """Run faster by so much for a while, from now on."""
        now_ns = self._world.now_ns
        self._slews.append((now_ns, now_ns + round(seconds * 1e9), ppm))

    def is_asleep(self, true_ns: int) -> bool:
        """Return whether the machine sleeps at a true time, ns, or within a frame before or after."""
        return any(
            begins_ns - FRAME_NS <= true_ns < ends_ns + FRAME_NS for begins_ns, ends_ns, _ in self._sleeps
        )

    def local_from_true(self, true_ns: int) -> int:
        """Return the reading at a true time, ns."""
        gained = self._ppm * (true_ns - 10**12) / 1e6
        for begins_ns, ends_ns, ppm in self._slews:
            gained += ppm * max(0, min(true_ns, ends_ns) - begins_ns) / 1e6
        offset_ns = next(of for began_ns, of in reversed(self._boots) if began_ns <= true_ns)
        return true_ns + offset_ns + round(gained) + self._error_ns(true_ns)

    def true_from_local(self, local_ns: int, near_ns: int | None = None) -> int:
        """Return the true time of a reading since the machine's start, or of one `near_ns`, to some ns."""
        error_ns = sum(of for _, ends_ns, of in self._sleeps if local_ns >= self.local_from_true(ends_ns))
        _, offset_ns = self._boots[-1]
        if near_ns is not None:
            _, offset_ns = min(self._boots, key=lambda boot: abs(local_ns - boot[1] - near_ns))
        true_ns = local_ns - offset_ns - error_ns
        for _ in range(4):
            true_ns += local_ns - self.local_from_true(true_ns)
        return true_ns

    def now_ns(self) -> int:
        """Return the reading now."""
        return self.local_from_true(self._world.now_ns)


class VirtualRig:
    """The machines of a plan; `await rig.run()` in its world is its whole evening."""

    def __init__(self, world: World, plan: Plan) -> None:
        self.world, self.plan = world, plan
        self.evidence = Evidence()
        self.leaders: dict[str, LeaderNode] = {}
        """The leading nodes, by machine."""
        self.devices = {name: Device() for name in plan.cameras}
        self.nodes: dict[str, CameraNode] = {}
        """The newest node of each camera."""
        self.seen: defaultdict[int, set[str]] = defaultdict(set)
        """Cameras that an operator saw ready, by run of the leader."""
        self._values: dict[tuple[int, str], list[Any]] = {}
        """By thing and attribute: its value before faults, and those of the faults that last."""
        self.clocks: dict[str, MachineClock] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._down: Counter[str] = Counter()
        self.absent_leaders: set[str] = set()
        """Machines that do not lead in the end: images of their bursts wait for them."""
        self.foreign: dict[Path, bytes] = {}
        """Files in cameras' spools that no node wrote, and what a link there shows."""
        self.times: list[TimeError] = []
        """Error of the time of each image that was saved."""
        self.works: dict[str, Callable[[], Coroutine[Any, Any, None]]] = {}
        for machine in ("lead", "lead2", "relay", "desk", *plan.cameras):
            world.network.host(machine)
            (world.disks.of(machine).folder / "sessions").mkdir()
            if machine in plan.cameras:
                self._lay_foreign_files(machine)
            world.disks.settle(machine)
            self.clocks[machine] = MachineClock(world, machine)
        self.works["lead"] = lambda: self._lead("lead")
        if plan.has_standby:
            self.works["lead2"] = lambda: self._lead("lead2")
        if plan.behind_relay:
            self.works["relay"] = self._relay
        for name in plan.cameras:
            self.works[name] = functools.partial(self._camera, name)
        self._awake_until_ns: Counter[str] = Counter()
        world.network.shape = self._shape_link
        world.on_end = self._restart_later
        world.slept_ns = lambda machine: self.clocks[machine].slept_ns()

    def _lay_foreign_files(self, camera: str) -> None:
        """Put what no node wrote into a camera's spool: a file, a folder of another program, and a link."""
        root = self.world.disks.of(camera).folder
        burst, spool, outside = "0000beef-000001", root / "spool" / camera, root / "pictures"
        for file in (spool / "notes.txt", spool / "keep" / "report.json", outside / burst / "report.json"):
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(b"{}")
            self.foreign[file] = b"{}"
        (outside / burst / "000000.jpg").write_bytes(b"a picture")
        self.foreign[outside / burst / "000000.jpg"] = b"a picture"
        (spool / burst).symlink_to(outside / burst)

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
                stagger=Stagger.parse(self.plan.stagger) if self.plan.stagger else None,
            )

        async def lead(node: LeaderNode) -> None:
            self.leaders[machine] = node
            self.evidence.led.append((self.world.now_ns, machine))
            self.world.note(machine, "leads")
            try:
                await asyncio.Event().wait()
            finally:
                self.leaders.pop(machine, None)

        await lead_by_rank(options, self._leaders if self.plan.has_standby else (), lead)

    def _shape_link(self, source: str, target: str, link: Link) -> None:
        """Give a link the delays that the plan draws for it."""
        if self.plan.wifi:
            link.base_ns, link.jitter_ns = 800_000, 1_500_000
            link.loss, link.double, link.bytes_per_s = 0.01, 0.002, 2e6
        first, second = sorted((source, target))
        longer = max(-0.3, min(0.3, self.world.chance("asymmetry", first, second).gauss(0, ASYMMETRY)))
        link.base_ns = round(link.base_ns * (1 + (longer if source == first else -longer)))
        for camera, ms in self.plan.lopsided.items():
            if (target if ms > 0 else source) == camera:
                link.base_ns += round(abs(ms) * 1e6)
        if source in self.plan.phones:
            link.sleeps_ns = functools.partial(self._wake, source)
        elif target in self.plan.phones:
            link.sleeps_ns = functools.partial(self._until_beacon_ns, target)

    def _wake(self, phone: str) -> int:
        """Let a phone listen for a while, as it sends something."""
        self._awake_until_ns[phone] = self.world.now_ns + AWAKE_NS
        return 0

    def _until_beacon_ns(self, phone: str) -> int:
        now_ns = self.world.now_ns
        return 0 if now_ns < self._awake_until_ns[phone] else BEACON_NS - now_ns % BEACON_NS

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
                has_sound=self.plan.has_sound and name == self.plan.cameras[0],
            ),
            leaders=(relay,) if below else self._leaders,
            clock=clock,
            spool=self.world.disks.of(name).folder / "spool",
            trust=Trust.open(),
            log=self._log(name),
        )
        self.nodes[name] = CameraNode(options)
        await self.nodes[name].run()

    async def _relay(self) -> None:
        options = PortOptions(
            host=self.world.network.host("relay"),
            port=PORT,
            trust=Trust.open(),
            clock=self.clocks["relay"],
            log=self._log("relay"),
        )
        async with await RelayNode.start("relay", self._leaders, options):
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
                    for of in self.evidence.bursts:
                        if of.session is session and of.end_asked_ns is None:
                            of.end_asked_ns = self.world.now_ns
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
        for words in (*self._held_by_leaders(), *self._held_by_nodes()):
            self.world.fail(words)

    def _held_by_leaders(self) -> Iterator[str]:
        """Yield what leaders hold in memory of takes that are over."""
        for machine, node in self.leaders.items():
            over = [of.status.name for of in node.bursts._bursts.values() if of.finished.is_set()]
            if over:
                yield f"{machine} holds {len(over)} takes in memory that are over: {', '.join(over[:5])}"
            for session in (*node.bursts._bursts.values(), *node.bursts.resumed.sessions()):
                images, seconds = session._intake.waiting()
                if images and seconds > 60:
                    yield f"{machine} holds {images} images of {session.status.name} that it does not save"

    def _held_by_nodes(self) -> Iterator[str]:
        """Yield what nodes hold in memory and in their spools of takes that are over."""
        elsewhere = {of.key for of in self.evidence.bursts if of.machine in self.absent_leaders}
        over = {of.key for of in self.evidence.bursts} - elsewhere
        for name, node in self.nodes.items():
            if name in self.plan.liars or not self.world.processes[name].is_alive:
                continue
            for upload in node._uploader._bursts:
                key = upload.report.leader, upload.report.burst
                if key in over and (size := sum(map(len, upload.in_memory.values()))):
                    yield f"{name} holds {size} bytes in memory of burst {key[1]}, which is over"
            ring, newest_ns = node._engine.ring, node._engine.ring.newest_local_ns
            held_ns = 0 if newest_ns is None else newest_ns - (ring.oldest_local_ns or 0)
            if held_ns > 2 * node.options.ring_ns:
                yield f"{name} holds frames of the last {held_ns / 1e9:.1f} s"
            folders = {"{:08x}-{:06}".format(*key) for key in over}
            spool = self.world.disks.of(name).folder / "spool" / name
            left = sorted(path.name for path in spool.glob("*") if path.name in folders)
            # On a disk that fails, they stay until the node is started again.
            if left and not any(
                of.target == name and of.kind == "disk-failing" for of in self.evidence.spans
            ):
                yield f"{name} has folders of takes in its spool that are over: {', '.join(left[:5])}"

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
            if step.target in self.plan.cameras:
                self.clocks[step.target].restart()

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

    async def _sleep(self, step: Step) -> None:
        """Suspend a machine with its cameras and network; its clock is off by the value afterwards, in s."""
        self.clocks[step.target].sleep(step.seconds, step.value)
        self.world.network.cut(step.target, is_cut=True)
        await self._freeze(step)
        self.world.network.cut(step.target, is_cut=False)

    async def _cut(self, step: Step) -> None:
        self.world.network.cut(step.target, is_cut=True)
        await asyncio.sleep(step.seconds)
        self.world.network.cut(step.target, is_cut=False)

    async def _changed(self, things: Iterable[Any], name: str, value: Any, seconds: float) -> None:
        """Give things another value for a while; when several changes of one are over, it is as before."""
        changed = [(of, self._values.setdefault((id(of), name), [getattr(of, name)])) for of in things]
        for of, values in changed:
            values.append(value)
            setattr(of, name, value)
        await asyncio.sleep(seconds)
        for of, values in changed:
            values.remove(value)
            setattr(of, name, values[-1])

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
        desk = self.world.processes["desk"]
        if step.kind == "mark":
            self.world.within(desk, lambda: self._soon(self._mark(step)))
            return
        options: dict[str, Any] = {"frames": round(step.value)}
        if step.kind == "series":
            options = {"frames": 3, "repeat": round(step.value), "every_s": step.seconds}
        elif step.kind == "recording":
            # A value is the ordered length in s; else the operator ends it after the step's seconds.
            options = {"video": True, "seconds": step.value or None}
        plan = TakePlan(wait_ready_s=5, **options)
        self.world.within(desk, lambda: self._do(self._take(step, plan)))

    async def _take(self, step: Step, plan: TakePlan) -> None:
        take = Take(step, self.world.now_ns)
        self.evidence.takes.append(take)
        taking = Taking(RigLink(self._address()), plan)
        results = []
        over: dict[int, BurstStatus] = {}
        try:
            async for event in taking:
                if isinstance(event, Progress):
                    take.status = event.status
                    if event.status.done and "after its leader was lost" not in event.status.message:
                        over[event.number] = event.status
                if isinstance(event, Begun) and step.kind == "recording" and step.seconds:
                    self.world.loop.call_later(step.seconds, lambda: self._soon(self._end(taking)))
                if isinstance(event, Begun) and step.kind == "cancel":
                    self._soon(self._cancel(taking))
                if isinstance(event, Saved):
                    take.status = event.status
                    take.told.append(_told(event, over.get(event.number)))
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

    def _bursts_of(self, taking: Taking) -> list[OrderedBurst]:
        """Return the bursts that a take has begun and that are not over."""
        active = {(status.burst, status.name) for status in taking._active.values()}
        return [of for of in self.evidence.bursts if (of.key[1], of.name) in active]

    async def _cancel(self, taking: Taking) -> None:
        bursts = self._bursts_of(taking)
        for of in bursts:
            of.cancel_asked_ns = self.world.now_ns
        await taking.cancel()
        for of in bursts:
            of.cancelled_ns = self.world.now_ns

    async def _end(self, taking: Taking) -> None:
        bursts = self._bursts_of(taking)
        for of in bursts:
            # The end of the evening may have ended it already.
            of.end_asked_ns = of.end_asked_ns or self.world.now_ns
        await taking.end()
        for of in bursts:
            of.is_ended = True

    async def _mark(self, step: Step) -> None:
        machine, node = next(iter(self.leaders.items()), ("lead", None))
        text, at_ns = f"mark at {step.at_s:.3f} s", self.world.now_ns
        placed = await place_mark(self._address(), text)
        # A leader that was started meanwhile may have another time.
        if node is not None and self.leaders.get(machine) is node:
            clock = node.bursts._options.clock
            self.evidence.marks.append(MarkOfDesk(text, at_ns, self.world.now_ns, machine, clock, placed))

    async def _follow(self) -> None:
        """Follow one leader's status and log after the other, as a screen does."""
        while True:
            async with contextlib.aclosing(RigLink(self._address()).updates()) as updates:
                async for update in updates:
                    if isinstance(update, LinkLost):
                        break
                    if isinstance(update, RigStatus):
                        self._note_ready(update)
            await asyncio.sleep(1)

    def _note_ready(self, status: RigStatus) -> None:
        """Note the cameras that an operator sees ready."""
        for machine, node in self.leaders.items():
            if status.leader == str(Address(self.world.network.host(machine), PORT)):
                run = node.bursts._engine.config.instance
                self.seen[run] |= {of.name for of in status.nodes if of.state in READY}

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


def _told(event: Saved, over: BurstStatus | None) -> Told:
    """Return what an operator is told, `over` by the leader, and what is on the disk now."""
    images, missing, absent = 0, -1, tuple[str, ...]()
    with contextlib.suppress(SimulshotError):
        if (session := local_session(event.status)) is not None:
            manifest = session.manifest
            images, missing = len(manifest.images), len(manifest.missing)
            absent = tuple(camera.name for camera in manifest.burst.absent)
    counts = (0, 0) if over is None else (over.received, over.expected)
    return Told(event.status, *counts, event.verdict, images, missing, absent)


def _short(status: BurstStatus | None) -> str:
    if status is None:
        return "no status"
    return f"{status.name} {status.received}/{status.expected} {status.message[:120]}"
