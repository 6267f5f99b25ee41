"""Restarts at random and aimed ones, against start latencies of several kinds."""

import random
from collections.abc import Callable

from capture_app.sync.phase.actuators import Move, ResetActuator

MS = 1_000_000
PERIOD_NS = 33_333_333


def tries(latency: Callable[[random.Random], float], tolerance_ns: int, *, aimed: bool, rounds: int) -> float:
    """Mean number of restarts to come within the tolerance of ever new grids; the first 20 go untold."""
    rng = random.Random(7)
    reset = ResetActuator(rng=rng, aimed=aimed)
    now_ns = total = 0
    for n in range(rounds):
        target_ns = now_ns + 10**9 + rng.randrange(PERIOD_NS)
        for _ in range(2000):
            move = Move(now_ns, target_ns, 0, PERIOD_NS, tolerance_ns)
            command = reset.command(move)
            assert 0 <= command.delay_ns < PERIOD_NS
            first_ns = now_ns + command.delay_ns + round(latency(rng))
            reset.learn_start(first_ns)
            total += n >= 20
            now_ns = first_ns + 5 * PERIOD_NS
            error_ns = (first_ns - target_ns + PERIOD_NS // 2) % PERIOD_NS - PERIOD_NS // 2
            if abs(error_ns) <= tolerance_ns:
                break
    return total / (rounds - 20)


def test_a_latency_of_two_kinds_is_aimed_at_the_likelier() -> None:
    def bimodal(rng: random.Random) -> float:
        return rng.gauss(280 if rng.random() < 0.7 else 293, 2) * MS

    assert tries(bimodal, MS, aimed=True, rounds=200) < 6.5


def test_the_first_start_of_all_is_learned_from_too() -> None:
    reset = ResetActuator(rng=random.Random(1))
    reset.note_start(0, PERIOD_NS)
    reset.learn_start(280 * MS)
    command = reset.command(Move(10**9, 2 * 10**9, 0, PERIOD_NS, MS))
    first_ns = 10**9 + command.delay_ns + 280 * MS
    assert abs((first_ns - 2 * 10**9 + PERIOD_NS // 2) % PERIOD_NS - PERIOD_NS // 2) < MS
