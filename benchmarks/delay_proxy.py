"""Carry datagrams between clients and a leader, each delayed by a law of its own, until stopped.

Every WAY is an address of this machine that one client takes for the leader, at the leader's port, and the
delays to the leader and back, in us: `HOST:MEAN/LEAST,MEAN/LEAST`. A delay is the least and a Gamma of shape
2. Datagrams overtake each other as their delays will. What the machine needs to wake up comes on top.
"""

import argparse
import heapq
import random
import select
import socket
import time
from dataclasses import dataclass

SHAPE = 2.0
Address = tuple[str, int]


@dataclass(frozen=True, slots=True)
class Delay:
    """A law of delays, in us."""

    mean_us: float
    least_us: float

    def draw_s(self, rng: random.Random) -> float:
        """Draw one, in s."""
        return (self.least_us + rng.gammavariate(SHAPE, (self.mean_us - self.least_us) / SHAPE)) / 1e6


@dataclass(slots=True)
class Way:
    """One client's: it knows the front, the leader knows the back."""

    front: socket.socket
    back: socket.socket
    there: Delay
    home: Delay
    client: Address | None = None


def main() -> None:
    """Read the ways and carry."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("leader", metavar="HOST:PORT")
    parser.add_argument("ways", nargs="+", metavar="WAY")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    host, port = options.leader.split(":")
    carry([open_way(way, int(port)) for way in options.ways], (host, int(port)), random.Random(options.seed))


def open_way(text: str, port: int) -> Way:
    """Open the sockets of a way."""
    host, delays = text.split(":")
    there, home = (Delay(*map(float, delay.split("/"))) for delay in delays.split(","))
    front, back = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
    front.bind((host, port))
    back.bind((host, 0))
    return Way(front, back, there, home)


def carry(ways: list[Way], leader: Address, rng: random.Random) -> None:
    """Take in what comes, and send what is due, for ever."""
    by_socket = {sock: way for way in ways for sock in (way.front, way.back)}
    waiting: list[tuple[float, int, socket.socket, bytes, Address]] = []
    count = 0
    while True:
        wait_s = max(0.0, waiting[0][0] - time.monotonic()) if waiting else None
        for sock in select.select(list(by_socket), [], [], wait_s)[0]:
            data, sender = sock.recvfrom(2048)
            way, count = by_socket[sock], count + 1
            if sock is way.front:
                way.client = sender
                entry = time.monotonic() + way.there.draw_s(rng), count, way.back, data, leader
                heapq.heappush(waiting, entry)
            elif way.client is not None:
                entry = time.monotonic() + way.home.draw_s(rng), count, way.front, data, way.client
                heapq.heappush(waiting, entry)
        while waiting and waiting[0][0] <= time.monotonic():
            _, _, out, data, to = heapq.heappop(waiting)
            out.sendto(data, to)


if __name__ == "__main__":
    main()
