"""Links in virtual time: each law has the minimum and mean it says, and memory where it says so."""

import random
from itertools import pairwise

import pytest

from benchmarks.simulated.link_spells import ReplayedDelay
from benchmarks.simulated.links import Link
from benchmarks.simulated.wireless import PAPER_LINK, GammaDelay, TroubleSpells, WirelessLink

MS, S = 1_000_000, 1_000_000_000
STEADY = GammaDelay(500_000, 500_001, 1.0)


def test_a_channel_without_memory_draws_as_its_link_does() -> None:
    link = Link(PAPER_LINK.to_leader, PAPER_LINK.to_client, loss=0.2, duplication=0.2)
    one, other, channel = random.Random(3), random.Random(3), link.open()

    def expected() -> list[int]:
        if other.random() < link.loss:
            return []
        copies = 2 if other.random() < link.duplication else 1
        return [link.to_client.draw(other) for _ in range(copies)]

    for i in range(100):
        assert channel.deliveries("to_client", i, one) == expected()


def test_trouble_comes_in_bursts() -> None:
    spells = TroubleSpells(calm_ns=2 * S, trouble_ns=S, extra_ns=5 * MS, loss=0.0)
    channel, rng = WirelessLink(STEADY, STEADY, spells=spells).open(), random.Random(2)
    late = [channel.deliveries("to_leader", t * 10 * MS, rng)[0] > 600_000 for t in range(60_000)]
    share = sum(late) / len(late)
    assert share == pytest.approx(1 / 3, abs=0.06)
    after_late = sum(b for a, b in pairwise(late) if a) / sum(late)
    assert after_late > 0.9


def test_a_replayed_law_goes_by_the_time() -> None:
    law, rng = ReplayedDelay((5, 6, 7), 100, start=1), random.Random(1)
    assert [law.draw(rng, t) for t in (0, 99, 100, 200, 300)] == [6, 6, 7, 5, 6]
