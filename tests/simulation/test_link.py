"""Links in virtual time: each law has the minimum and mean it says, and memory where it says so."""

import csv
import random
from itertools import pairwise
from pathlib import Path

import pytest

from benchmarks.simulated.wireless import PAPER_LINK, GammaDelay, TroubleSpells, WirelessLink
from capture_app.common.errors import BadInputError
from capture_app.simulation.links import Link, ReplayedDelay, read_trace

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


def test_a_recorded_link_is_split_into_its_two_directions(tmp_path: Path) -> None:
    path = tmp_path / "link.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("t_s", "rtt_ms"))
        for i in range(100):
            writer.writerow((i * 0.2, 3.0 if i == 50 else 2.0))
    link, rng = read_trace(path, random.Random(1)), random.Random(2)
    ways = [law.draw(rng, 50 * 200 * MS) for law in (link.to_leader, link.to_client)]
    assert sum(ways) == pytest.approx(3.0 * MS, abs=2)
    assert min(ways) > 1.0 * MS
    assert link.to_client.draw(rng, 40 * 200 * MS) == link.to_leader.draw(rng, 40 * 200 * MS) == MS


@pytest.mark.parametrize("text", ["", "t_s,rtt_ms\n1,2\n", "t_s,rtt_ms\n1,x\n", "t_s\n1\n"])
def test_what_is_no_recorded_link_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "link.csv"
    path.write_text(text)
    with pytest.raises(BadInputError, match=r"link\.csv"):
        read_trace(path, random.Random(1))


@pytest.mark.shared
def test_the_recording_of_a_real_link_is_read(shared: Path) -> None:
    link = read_trace(shared / "footage" / "timing" / "wifi_rtt_offset_good.csv", random.Random(1))
    assert isinstance(link.to_leader, ReplayedDelay)
    assert len(link.to_leader.delays_ns) == 2987
    assert link.to_leader.every_ns == pytest.approx(200 * MS, rel=0.05)
    assert min(link.to_leader.delays_ns) > 0
