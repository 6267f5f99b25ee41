"""Looks for a leader that this machine can reach: its own first, then those that are announced."""

import asyncio
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from capture_app.net.address import Address
from capture_app.net.discovery.browser import FoundLeader, LeaderBrowser
from capture_app.net.reach import find_obstacle, first_to_answer
from capture_app.trust.known_machines import Role
from capture_app.trust.trust import Trust

OWN_S = 0.5
"""How long this machine's own leaders may take to answer."""
OTHERS_S = 0.6
"""How long to listen for further leaders: all of one network have answered by then."""
ANSWER_S = 1.0
SAY_S = 2.0
LOOK_EVERY_S = 0.2
NOBODY = (
    "no leader is found in this network yet: start one with: capture-app (on the machine that is to save the"
    " pictures), or give its address: --leader HOST:PORT"
)


@dataclass(frozen=True, slots=True)
class ReachableLeader:
    """A leader that answers at an address."""

    name: str
    address: Address
    version: str = ""
    """Of its simulshot, as it says; empty for one of this machine."""
    is_known: bool = True
    """Whether this machine knows a leader of the pin that it says it has, or asks nobody for a pin."""
    is_relay: bool = False


async def search_leaders(
    own: Callable[[], Sequence[Address]], tell: Callable[[str], None], *, trust: Trust | None = None
) -> list[ReachableLeader]:
    """Wait until there is a leader that answers, and return all of them; relays only where there is none.

    Where `trust`, else that of this user, knows some of them, these are all. `own` are the addresses at which
    this machine may have one: the first that answers is the only one returned. `tell` gets a sentence about
    what is in the way, when there is a new one.
    """
    began_s, said = time.monotonic(), ""
    async with LeaderBrowser() as browser:
        while True:
            asked_s = time.monotonic()
            await browser.refresh()
            mine = await first_to_answer(own(), OWN_S)
            if mine is not None:
                return [ReachableLeader("this machine", mine)]
            await asyncio.sleep(max(0.0, began_s + OTHERS_S - time.monotonic()))
            found = browser.found
            answered = await _answering(found, trust or Trust.of_user())
            is_late = time.monotonic() - began_s >= SAY_S
            # A relay, or a stranger's leader, may only have been quicker.
            if any(one.is_known and not one.is_relay for one in answered) or (answered and is_late):
                return _best(answered)
            if is_late:
                sentence = await _what_is_in_the_way(found)
                if sentence != said:
                    tell(sentence)
                    said = sentence
            await asyncio.sleep(max(0.0, asked_s + LOOK_EVERY_S - time.monotonic()))


async def _answering(found: Sequence[FoundLeader], trust: Trust) -> list[ReachableLeader]:
    """Return those that answer, each at the address that answers first."""
    addresses = await asyncio.gather(*(first_to_answer(leader.addresses, ANSWER_S) for leader in found))
    return [
        ReachableLeader(
            name=leader.name,
            address=address,
            version=leader.version,
            is_known=_knows(trust, leader.pin),
            is_relay=leader.is_relay,
        )
        for leader, address in zip(found, addresses, strict=True)
        if address is not None
    ]


def _best(answered: Sequence[ReachableLeader]) -> list[ReachableLeader]:
    """Return those that are known, where some are, and of these the leaders, where some are."""
    known = [one for one in answered if one.is_known] or list(answered)
    return [one for one in known if not one.is_relay] or known


def _knows(trust: Trust, pin: str) -> bool:
    if trust.is_open:
        return True
    machine = trust.known.find(pin)
    return pin == trust.identity.pin or (machine is not None and Role.LEADER in machine.roles)


async def _what_is_in_the_way(found: Sequence[FoundLeader]) -> str:
    obstacles = await asyncio.gather(
        *(find_obstacle(address) for leader in found for address in leader.addresses[:1])
    )
    return "; ".join(str(obstacle) for obstacle in obstacles if obstacle is not None) or NOBODY
