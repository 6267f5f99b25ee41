"""Processes on the leader's machine that end with it: camera nodes, and the server for phones."""

import asyncio
import functools
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import msgspec

from capture_app.cameras.specs import parse_spec
from capture_app.common.address import Address
from capture_app.common.child import Child
from capture_app.common.errors import BadInputError, NetworkError
from capture_app.common.names import check_name, find_alike, free_name
from capture_app.common.passwords import hide_password
from capture_app.common.tasks import first_of, has_come
from capture_app.common.timeouts import (
    CHILD_STOP_TIMEOUT_S,
    NODE_START_TIMEOUT_S,
    NODE_STOP_TIMEOUT_S,
    PHONES_START_TIMEOUT_S,
)
from capture_app.protocol.log import Log
from capture_app.protocol.orders import FLAT_SCENES, MAX_NODES, VIEWS, AddSimulated, PhoneInvited
from capture_app.trust.trust import Trust


class LocalPhones:
    """Server for phones, started with the first invitation and restarted by the next if it has ended."""

    def __init__(self, leader: Address, spool: Path, host: str, log: Log, trust: Trust) -> None:
        """`host` is this machine's address for phones, `trust` applies to the process."""
        self._leader, self._spool, self._host, self._event_log = leader, spool, host, log
        self._trust = trust
        self._child: Child | None = None
        self._reading: asyncio.Task[None] | None = None
        self._invited: tuple[PhoneInvited, float] | None = None
        self._log_came = asyncio.Event()
        self._starting = asyncio.Lock()

    async def invitation(self) -> PhoneInvited:
        """Return the page for the next phone. Raises NetworkError, or the error that ended the server."""
        async with self._starting:
            if self._child is None or self._child.process.returncode is not None:
                await self._start()
        if self._invited is None:
            raise NetworkError("the phone server has not started yet", hint="ask again in a moment")
        invited, until_s = self._invited
        return msgspec.structs.replace(
            invited, good_for_s=max(0, round(until_s - asyncio.get_running_loop().time()))
        )

    async def close(self) -> None:
        """End the server for phones, if it runs."""
        if self._reading is not None:
            self._reading.cancel()
        if self._child is not None:
            await self._child.stop()

    async def _start(self) -> None:
        self._invited = None
        self._log_came.clear()
        arguments = ("capture_app.cli", "phones", "--until-eof", "--json", "--host", self._host)
        where = ("--leader", str(self._leader), "--spool", str(self._spool))
        self._child = await Child.start(
            "the phone server", (*arguments, *where), variables=self._trust.variables
        )
        self._reading = asyncio.create_task(self._read(self._child))
        if await has_come(self._log_came, PHONES_START_TIMEOUT_S) and self._invited is None:
            await self._child.process.wait()
            raise await self._child.failure()

    async def _read(self, child: Child) -> None:
        assert child.process.stdout is not None
        async for raw in child.process.stdout:
            try:
                line = msgspec.json.decode(raw)
            except ValueError:
                continue
            if line["event"] == "invitation":
                invited = PhoneInvited(
                    url=line["url"], fingerprint=line["fingerprint"], good_for_s=line["good_for_s"]
                )
                self._invited = invited, asyncio.get_running_loop().time() + invited.good_for_s
                self._log_came.set()
        if self._invited is not None:
            self._event_log.add("the phone server has ended; invite a phone to start it again", level="error")
        self._log_came.set()


RESTARTS_S = (1.0, 10.0, 60.0)
"""Delays after which a node that has ended by itself is started again, one after the other, in seconds."""
SOUND_S = 300.0
"""Time after which the delays of a node that runs begin anew, in seconds."""


class LocalNodes:
    """Camera nodes on the leader's machine: starts, ends, and starts again one that ends by itself."""

    def __init__(
        self,
        leader: Address,
        spool: Path,
        log: Log | None = None,
        host: str | None = None,
        trust: Trust | None = None,
    ) -> None:
        """`leader` is the address that they join; `spool` stores their images until the leader has them.

        `host` is this machine's address for phones, `trust` applies to all processes, by default their
        user's.
        """
        self._trust = trust or Trust.of_user()
        self._leader, self._spool, self._event_log = leader, spool, log or Log()
        self.phones = LocalPhones(leader, spool, host or leader.host, self._event_log, self._trust)
        """Server for the phones that are cameras here."""
        self._children: dict[str, Child] = {}
        self._watching: dict[str, asyncio.Task[None]] = {}
        """A watch for each node that is not being ended; a name is free again once that is over."""
        self._specs: dict[str, str] = {}
        """Spec of the camera with which each node was started, without its password."""
        self._adding = asyncio.Lock()

    @property
    def specs(self) -> Mapping[str, str]:
        """Specs of the running nodes' cameras, without passwords, by name."""
        return {name: self._specs[name] for name in self._children}

    async def add_camera(self, spec: str, name: str | None = None, taken: Collection[str] = ()) -> str:
        """Start one camera and return its name once it is open; `taken` are names of other nodes.

        If one of these nodes already has that device, its name is returned. Raises BadInputError for an
        unusable spec or name, and the node's own error if it ends.
        """
        spec = hide_password(spec)
        parsed = parse_spec(spec)
        async with self._adding:
            known = next((of for of, other in self.specs.items() if other == spec), None)
            if known is not None and parsed.kind != "sim" and name in (None, known):
                if known in self._watching:
                    return known
                await self._children[known].process.wait()  # it has the device until then
            if name is None:
                name = free_name(parsed.label, {*self._children, *taken})
            self._check(check_name(name, "camera"), taken)
            child = await self._start(name, spec, "sim" if parsed.kind == "sim" else "host")
        await _opened(child)
        return name

    async def add_simulated(self, order: AddSimulated, taken: Collection[str] = ()) -> tuple[str, ...]:
        """Start further simulated cameras and return their names once they are open.

        `taken` are names of other nodes. Raises BadInputError for a scene that does not exist or has no more
        views, and a node's own error if it ends.
        """
        cameras, scene = order.cameras, order.scene
        if scene not in VIEWS:
            raise BadInputError(f"there is no simulated scene {scene!r}", hint=f"one of {', '.join(VIEWS)}")
        flat, pool = scene in FLAT_SCENES, VIEWS[scene]
        async with self._adding:
            free = [name for name in pool if name not in taken and name not in self._children]
            if not 1 <= cameras <= len(free):
                raise BadInputError(
                    f"{cameras} further simulated cameras of the scene {scene} are not available",
                    hint=f"it has {len(pool)} views, {len(free)} of them free"
                    + ("" if flat else f"; any number can use {FLAT_SCENES[0]}"),
                )
            started = []
            for name in free[:cameras]:
                self._check(name, taken)
                model = "phone-a" if pool.index(name) < 2 else "phone-b"
                options = f"scene={scene}", "" if flat else f"view={name}", order.options
                spec = f"sim:{model},{','.join(filter(None, options))}"
                started.append(await self._start(name, spec, "sim", order.tolerance_us))
        await asyncio.gather(*map(_opened, started))
        return tuple(free[:cameras])

    async def remove(self, name: str) -> None:
        """End a node. Raises BadInputError if there is none of that name."""
        if (child := self._children.get(name)) is None:
            raise BadInputError(
                f"{name} is not a node of this leader's machine",
                hint="stop capture-app node on its own machine; capture-app status lists the cameras",
            )
        if (watching := self._watching.pop(name, None)) is None:  # it is being ended already
            await child.process.wait()
            return
        watching.cancel()
        words = f"{name} is still ending: it saves its frames first; stop again to drop them"
        saying = asyncio.get_running_loop().call_later(
            CHILD_STOP_TIMEOUT_S, functools.partial(self._event_log.say, words, camera=name)
        )
        try:
            if not await child.stop(NODE_STOP_TIMEOUT_S):
                words = f"{name} had not saved all its frames in {NODE_STOP_TIMEOUT_S:.0f} s, and was ended"
                self._event_log.say(words, camera=name, level="error")
        finally:
            saying.cancel()
            del self._children[name]

    async def aclose(self) -> None:
        """End the nodes and the server for phones."""
        await asyncio.gather(self.phones.close(), *(self.remove(name) for name in tuple(self._children)))

    def _check(self, name: str, taken: Collection[str]) -> None:
        if (alike := find_alike(name, (*self._children, *taken))) is not None:
            raise BadInputError(f"a node named {alike} already exists", hint="choose another name")
        if len(self._children) >= MAX_NODES:
            raise BadInputError(
                f"{MAX_NODES} nodes already run on this machine",
                hint="remove one: capture-app cameras remove NAME",
            )

    async def _start(self, name: str, spec: str, clock: str, tolerance_us: int | None = None) -> Child:
        arguments = [
            *("capture_app.cli", "node", "--until-eof", "--name", name, "--camera", spec),
            *("--spool", str(self._spool), "--leader", str(self._leader), "--clock", clock),
            *(() if tolerance_us is None else ("--tolerance-us", str(tolerance_us))),
        ]
        self._specs[name] = spec
        child = self._children[name] = await Child.start(name, arguments, variables=self._trust.variables)
        self._watching[name] = asyncio.create_task(self._watch(name, child, arguments))
        return child

    async def _watch(self, name: str, child: Child, arguments: Sequence[str]) -> None:
        """Start a node again that has ended, once it was open; give it up if it does not open any more."""
        now_s, delays_s, was_open = asyncio.get_running_loop().time, iter(RESTARTS_S), False
        while True:
            begun_s = now_s()
            await child.process.wait()
            error = await child.failure()
            was_open = was_open or child.spoken.is_set()
            if now_s() - begun_s >= SOUND_S:
                delays_s = iter(RESTARTS_S)
            delay_s = next(delays_s, None) if was_open else None
            again = "" if delay_s is None else f"; it is started again in {delay_s:.0f} s"
            self._event_log.add(f"{error}{again}", camera=name, level="error")
            if delay_s is None:
                del self._children[name], self._watching[name]
                return
            await asyncio.sleep(delay_s)
            child = self._children[name] = await Child.start(name, arguments, variables=self._trust.variables)


async def _opened(node: Child) -> None:
    """Wait until a node has opened its camera. Raises the node's own error if it ends."""
    with suppress(TimeoutError):
        async with asyncio.timeout(NODE_START_TIMEOUT_S):
            # Its first line comes when its camera is open.
            await first_of(node.process.wait(), node.spoken.wait())
    if node.process.returncode is not None:
        raise await node.failure()
