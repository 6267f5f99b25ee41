"""What an oracle knows of a clock, and what the message with the least round trip does."""

import random
from statistics import fmean

from benchmarks.paper.panel_trial import minimum_filter_error_ns, oracle_error_ns
from benchmarks.simulated.wireless import GammaDelay
from capture_app.simulation.links import Link


def test_an_oracle_knows_the_clock_better_than_the_message_with_the_least_round_trip() -> None:
    rng = random.Random(3)
    laws = GammaDelay(900_000, 1_900_000), GammaDelay(900_000, 1_100_000)
    oracle, least = [], []
    for _ in range(4):
        to_leader, to_client = ([law.draw(rng) for _ in range(300)] for law in laws)
        oracle.append(abs(oracle_error_ns(to_leader, to_client, Link(*laws))))
        least.append(abs(minimum_filter_error_ns(to_leader, to_client)))
    assert fmean(oracle) < 15_000
    assert fmean(oracle) < fmean(least)


def test_what_came_late_says_nothing() -> None:
    law = GammaDelay(900_000, 1_100_000, 2.0, 0.01, 10_000_000)
    rng = random.Random(1)
    ways = [[GammaDelay(900_000, 1_100_000).draw(rng) for _ in range(100)] for _ in range(2)]
    link = Link(law, law)
    without = oracle_error_ns(ways[0], ways[1], link)
    assert oracle_error_ns([*ways[0], 15_000_000], [*ways[1], 12_000_000], link) == without
