"""Tasks of a node, a relay or a standby that joins: it requests keys, and looks for leaders that are lost.

A leader is known by its key, and its address may change: its pin, which its streams prove, or in an open rig
the instance number of its run.
"""

import asyncio
import contextlib
import itertools
from collections.abc import Callable, Collection, Mapping, Sequence
from types import MappingProxyType

from capture_app.common.address import Address
from capture_app.common.errors import NetworkError, SimulshotError, UnknownMachineError
from capture_app.net.asking import ask
from capture_app.net.channel import connect
from capture_app.net.discovery import MAX_ADDRESSES, MAX_LEADERS, LeaderBrowser
from capture_app.net.local_network import power_saving, power_saving_towards
from capture_app.net.reachability import find_obstacle, proves_key
from capture_app.net.udp import Pump
from capture_app.node.enrolment import ask_to_enrol
from capture_app.protocol.log import Log
from capture_app.protocol.messages import FromLeader, KeyAnswer, KeyRequest
from capture_app.protocol.pairing_messages import FoundLeader
from capture_app.sync.rig.failover import LeaderChoice
from capture_app.sync.tree.succession import Succession
from capture_app.trust.datagram_keys import LeaderKeys
from capture_app.trust.trust import Trust

KEY_AGAIN_S = 0.3
"""Interval between two requests for a key to one leader, whatever the result of the first."""
LOOK_EVERY_S = 0.25
UNANSWERED = 2
"""Number of unanswered hellos after which the leaders are looked for elsewhere."""
REFUSED_S = 5.0
"""The same where another machine answers at their address, and refuses this one."""
FIND_EVERY_S, EXAMINED_EVERY, FIRST_EXAMINED = 1.0, 10, 3
"""Interval between two looks for a lost leader, number of looks between two examinations of the path, and
before the first one: a leader whose address changes is announced some seconds later."""

Followed = Mapping[str, tuple[Address, ...]]
"""Addresses of each leader that was followed, by its key; both newest last."""


class Joining:
    """What a process does to join leaders: it requests datagram keys, and looks for leaders that are lost."""

    def __init__(
        self,
        choice: LeaderChoice,
        keys: LeaderKeys,
        pump: Pump,
        trust: Trust,
        log: Log,
        leaders: Sequence[Address] = (),
        *,
        is_relay: bool = False,
        succession: Succession | None = None,
        followed: Followed = MappingProxyType({}),
        remember: Callable[[Followed], object] = lambda _: None,
    ) -> None:
        """`leaders`, as they were given, are looked for while none of them answers.

        `remember` stores, blocking on the disk, which leaders the node `followed`, for its next start.

        A node adopts the machines and names that its leaders vouch for. A machine that may lead itself, by
        `succession`, adopts only those of the leader that it follows, as another standby might only claim to
        lead.
        """
        self._choice, self._keys, self._pump, self._trust = choice, keys, pump, trust
        self._time = time = choice.time
        self._log, self._leaders, self._succession = log, leaders, succession
        self._request = KeyRequest(name=time.name, instance=time.instance, is_relay=is_relay)
        self._missing = asyncio.Event()
        self._asked: set[tuple[str, int]] = set()
        self._now_ns = 0
        self._pins: dict[tuple[str, int], str] = {}
        """Pin that the leader at an address has proven."""
        self._followed, self._remember = dict(followed), remember
        """Addresses of each leader that was followed, by its key; both newest last."""

    def look(self, now_ns: int) -> None:
        """Wake `run` if a datagram key is missing."""
        self._now_ns = now_ns
        if self._keys.missing:
            self._missing.set()

    def ask_again(self, leader: tuple[str, int]) -> None:
        """Request another key from a leader, whose answer also has the machines that it knows."""
        if not self._trust.is_open:
            self._keys.missing.add(leader)
            self._missing.set()

    async def run(self) -> None:
        """Request missing keys until cancelled, from all leaders concurrently, and watch the path to them."""
        async with asyncio.TaskGroup() as tasks:
            if self._leaders:
                tasks.create_task(self.watch())
            while True:
                for leader in self._keys.missing - self._asked:
                    self._asked.add(leader)
                    tasks.create_task(self._ask(leader))
                self._keys.missing.clear()
                await self._missing.wait()
                self._missing.clear()

    async def _ask(self, leader: tuple[str, int]) -> None:
        try:
            async with await connect(Address(*leader), FromLeader, trust=self._trust) as channel:
                answer = await ask(channel, self._request, KeyAnswer)
            self._pins[leader] = channel.who.pin
            self._keys.hold(leader, answer.grant)
            self._pump.turn()
            if self._succession is None or self._succession.leader == leader:
                await asyncio.to_thread(self._trust.take_trust_of, channel.who, answer.machines, answer.names)
        except SimulshotError as error:
            # Reachability of the leader is checked elsewhere.
            if isinstance(error, UnknownMachineError) or not isinstance(error, NetworkError):
                self._time.note_refusal(str(error))
                with contextlib.suppress(SimulshotError):
                    # This machine's pin may have been added at the leader. A leader with a full disk cannot
                    # store it yet.
                    await ask_to_enrol(Address(*leader), self._trust)
        await asyncio.sleep(KEY_AGAIN_S)
        self._asked.discard(leader)

    async def watch(self) -> None:
        """Remember which leader is followed, and look for it elsewhere while it is lost, until cancelled."""
        loop, looked = asyncio.get_running_loop(), False
        member_s = loop.time()
        while True:
            if self._time.is_member:
                member_s = loop.time()
                await self._note_leader()
                if not looked:
                    looked = True
                    for leader in self._leaders:
                        if interface := await asyncio.to_thread(power_saving_towards, leader.host):
                            self._log.say("; ".join(power_saving(interface)))
                            break
            elif self._is_unanswered or loop.time() - member_s > REFUSED_S:
                await self._find()
            await asyncio.sleep(LOOK_EVERY_S)

    @property
    def _is_unanswered(self) -> bool:
        return not self._time.is_member and self._time.unanswered >= UNANSWERED

    async def _note_leader(self) -> None:
        """Remember the leader that is followed, unless it only took the address of another one."""
        leader, config = Address(*self._choice.leader), self._time.followed
        key = str(config and config.leader) if self._trust.is_open else self._pins.get(leader, "")
        known = self._key_at(leader)
        if not key or key == known == next(reversed(self._followed), None):
            return
        if known not in ("", key):
            async with LeaderBrowser() as browser:
                await browser.refresh()
                await asyncio.sleep(FIND_EVERY_S)
                if await self._move(leader, known, _announced(known, browser.found)):
                    return
        await self._keep(key, leader)

    async def _keep(self, key: str, leader: Address) -> None:
        """Remember that the leader with a key is at an address."""
        addresses = [other for other in self._followed.pop(key, ()) if other != leader]
        self._followed[key] = (*addresses[1 - MAX_ADDRESSES :], leader)
        self._followed = dict([*self._followed.items()][-MAX_LEADERS:])
        await asyncio.to_thread(self._remember, self._followed)

    def _key_at(self, leader: Address) -> str:
        """Return the key of the leader that was followed last at an address; empty for none."""
        keys = (key for key, addresses in reversed(self._followed.items()) if leader in addresses)
        return next(keys, "")

    async def _find(self) -> None:
        """Look for the lost leaders elsewhere, and log what is in the way, until one of them is joined."""
        said, lost = "", {Address(*leader): self._key_at(Address(*leader)) for leader in self._choice.leaders}
        is_known = any(lost.values())
        async with LeaderBrowser() as browser:
            for look in itertools.count():
                if look % EXAMINED_EVERY == (FIRST_EXAMINED if is_known else 0):
                    said = await self._examine({*lost.values()}, browser.found, said)
                await browser.refresh()
                await asyncio.sleep(FIND_EVERY_S)
                for leader, key in lost.items():
                    hints = _announced(key, browser.found) + self._followed.get(key, ())[::-1]
                    if self._time.is_member or (key and await self._move(leader, key, (leader, *hints))):
                        return

    async def _move(self, old: Address, key: str, places: Sequence[Address]) -> bool:
        """Join a leader at the first of these places where it answers; return whether that is another one."""
        was_member = self._time.is_member
        proven = await asyncio.gather(*(proves_key(place, key, self._trust) for place in places))
        new = next((place for place, is_there in zip(places, proven, strict=True) if is_there), old)
        if new == old or self._time.is_member is not was_member:
            return False
        self._log.say(f"the leader at {old} is now at {new}")
        self._choice.move_leader(old, new, self._now_ns)
        self._pump.turn()
        await self._keep(key, new)
        return True

    async def _examine(self, keys: Collection[str], found: Sequence[FoundLeader], said: str) -> str:
        """Log what is in the way to all leaders unless it was `said` last; return what was said last."""
        announced = [place for key in keys for place in _announced(key, found)]
        moved = [place for place in announced if place not in self._choice.leaders]
        obstacles = await asyncio.gather(*map(find_obstacle, moved or self._leaders))
        # What a leader has reported itself is already logged.
        reasons = [of for of in obstacles if of is not None and of.what not in self._time.why_joining]
        sentence = "; ".join(map(str, reasons))
        if not self._is_unanswered or not sentence:
            return said
        if moved:
            sentence = f"the leader is announced at {' and '.join(map(str, moved))}: {sentence}"
        elif self._followed and not announced:
            sentence += "; nor is the leader announced at another address"
        if sentence != said:
            self._log.say(sentence)
        return sentence


def _announced(key: str, found: Sequence[FoundLeader]) -> tuple[Address, ...]:
    return tuple(place for leader in found if key and leader.key == key for place in leader.addresses)
