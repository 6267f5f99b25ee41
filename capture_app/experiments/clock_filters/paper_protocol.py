"""Section 4 as the paper ran it: the leader begins, 10,000 messages in 34.3 s, no skew between the clocks.

Ours differs in who begins: its clients ask, each when it likes, and the leader only answers. An offset is
known as well either way; who begins decides who knows it first, and whether a leader has to take turns.
"""

import random
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import mean

from capture_app.simulation.exchanges import START_TRUE_NS, TURNAROUND_NS
from capture_app.simulation.links import Channel, Link
from capture_app.simulation.paper_link import LATE_NS, PACE_NS, PAPER_LINK

MESSAGES = 10_000


@dataclass(frozen=True, slots=True)
class Message:
    """One-way times of a message and its answer, in us."""

    to_client_us: float
    to_leader_us: float

    @property
    def round_trip_us(self) -> float:
        """Both ways together."""
        return self.to_client_us + self.to_leader_us

    @property
    def offset_error_us(self) -> float:
        """How far the offset is off that this message gives by itself."""
        return (self.to_client_us - self.to_leader_us) / 2.0


def leader_first(
    link: Link, rng: random.Random, *, count: int = MESSAGES, pace_ns: int = PACE_NS
) -> Iterator[Message]:
    """Yield messages that a leader begins, one each `pace_ns`; those that are lost are left out."""
    channel = Channel(link)
    for sent_ns in range(START_TRUE_NS, START_TRUE_NS + count * pace_ns, pace_ns):
        for there_ns in channel.deliveries("to_client", sent_ns, rng)[:1]:
            answered_ns = sent_ns + there_ns + TURNAROUND_NS
            for back_ns in channel.deliveries("to_leader", answered_ns, rng)[:1]:
                yield Message(there_ns / 1000.0, back_ns / 1000.0)


def run_of_messages(seed: str, count: int = MESSAGES) -> list[Message]:
    """The messages of a run on the paper's link."""
    return list(leader_first(PAPER_LINK, random.Random(seed), count=count))


def quickest(messages: Sequence[Message]) -> Message:
    """The message with the least round trip."""
    return min(messages, key=lambda message: message.round_trip_us)


def one_way_table(messages: Sequence[Message]) -> Mapping[str, float]:
    """Table III of a run, by the names of `paper_values.TABLE_3`; in us."""
    kept = [message for message in messages if message.round_trip_us <= LATE_NS / 1000.0]
    best = quickest(messages)
    to_client_us, to_leader_us = mean(m.to_client_us for m in kept), mean(m.to_leader_us for m in kept)
    return {
        "to_client.mean": to_client_us,
        "to_leader.mean": to_leader_us,
        "difference.mean": abs(to_client_us - to_leader_us),
        "round_trip.mean": to_client_us + to_leader_us,
        "bias.mean": abs(to_client_us - to_leader_us) / 2.0,
        "to_client.least": best.to_client_us,
        "to_leader.least": best.to_leader_us,
        "difference.least": abs(best.to_client_us - best.to_leader_us),
        "round_trip.least": best.round_trip_us,
        "bias.least": abs(best.offset_error_us),
        "messages": float(len(messages)),
        "left_out": float(len(messages) - len(kept)),
    }


def mean_table(tables: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The means of the figures of some runs."""
    return {name: mean(table[name] for table in tables) for name in tables[0]}


def least_round_trips(seed: str, counts: Mapping[int, int]) -> dict[int, list[float]]:
    """The least round trips in us of runs of so many messages; `counts` says how many runs of each length."""
    return {
        count: [quickest(run_of_messages(f"{seed} {count} {i}", count)).round_trip_us for i in range(runs)]
        for count, runs in counts.items()
    }
