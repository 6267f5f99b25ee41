"""The leader's side of the reference broadcast: beacons at their pace, answers to those who tell."""

import random

from capture_app.sync.reference_broadcast import BEACON_EVERY_NS, FORGOTTEN_NS, Broadcaster
from capture_app.sync.wire.messages import ArrivalReport, Beacon, Group

MS = 1_000_000
GROUP = Group("239.255.47.10", 47011)


def sent(broadcaster: Broadcaster, now_ns: int, listeners: int = 2) -> Beacon | None:
    broadcaster.handle_timer(now_ns, listeners)
    return broadcaster.beacon_to_send()


def told(client: int, wrong_ns: int, *, beacons: range = range(1, 25), seed: int = 0) -> ArrivalReport:
    rng = random.Random(seed + client)
    arrivals = tuple((n, n * BEACON_EVERY_NS + wrong_ns + rng.randrange(10_000)) for n in beacons)
    return ArrivalReport(client, 60_000, 500_000, arrivals)


def after_beacons(count: int = 24, *, fully: bool = True) -> tuple[Broadcaster, int]:
    broadcaster = Broadcaster(99, GROUP, fully=fully)
    for k in range(count):
        assert sent(broadcaster, k * BEACON_EVERY_NS) == Beacon(99, k + 1)
    return broadcaster, count * BEACON_EVERY_NS


def test_beacons_come_at_their_pace_while_two_can_hear_them() -> None:
    broadcaster = Broadcaster(99, GROUP)
    assert sent(broadcaster, 0, listeners=1) is None
    assert broadcaster.due_ns is None
    assert sent(broadcaster, 10) == Beacon(99, 1)
    assert broadcaster.due_ns == 10 + BEACON_EVERY_NS
    assert sent(broadcaster, 9 + BEACON_EVERY_NS) is None
    assert sent(broadcaster, 10 + BEACON_EVERY_NS) == Beacon(99, 2)


def test_without_a_group_nothing_is_sent_or_answered() -> None:
    broadcaster = Broadcaster(99, None)
    assert sent(broadcaster, 0) is None
    assert broadcaster.due_ns is None
    assert broadcaster.answer(told(1, 0), 0) is None


def test_two_are_moved_towards_each_other() -> None:
    broadcaster, now_ns = after_beacons()
    assert broadcaster.answer(told(1, -100_000), now_ns) is None, "nobody to agree with yet"
    now_ns += 500 * MS
    second = broadcaster.answer(told(2, 100_000), now_ns)
    first = broadcaster.answer(told(1, -100_000), now_ns)
    assert first is not None
    assert second is not None
    assert (first.client, first.number, second.number) == (1, 24, 24)
    assert abs(first.leader_ns - second.leader_ns) < 25_000, "their own jitter at this beacon only"
    assert 0 < first.relative_uncertainty_ns < 10_000
    assert first.uncertainty_ns >= 60_000


def test_who_falls_silent_counts_no_more() -> None:
    broadcaster, now_ns = after_beacons()
    broadcaster.answer(told(1, 0), now_ns)
    assert broadcaster.answer(told(2, 0), now_ns + 500 * MS) is not None
    assert broadcaster.answer(told(2, 0), now_ns + FORGOTTEN_NS) is None


def test_beacons_that_were_never_sent_are_not_believed() -> None:
    broadcaster, now_ns = after_beacons(count=10)
    broadcaster.answer(told(1, 0), now_ns)
    assert broadcaster.answer(told(2, 0), now_ns + 500 * MS) is None, "of 24 only 10 are known"
    assert broadcaster.answer(ArrivalReport(3, 1, 1, ()), now_ns + 500 * MS) is None


def test_the_same_reports_give_the_same_answers() -> None:
    answers = []
    for _ in range(2):
        broadcaster, now_ns = after_beacons()
        turns = [(k % 12, now_ns + k * 100 * MS) for k in range(24)]
        answers.append([broadcaster.answer(told(c, c * 7000), at_ns) for c, at_ns in turns])
    assert answers[0] == answers[1]
    assert sum(answer is not None for answer in answers[0]) > 12


def test_without_being_asked_nobody_is_moved_beyond_the_error_that_it_states() -> None:
    answers = {}
    for fully in (True, False):
        broadcaster, now_ns = after_beacons(fully=fully)
        assert broadcaster.answer(told(1, -200_000), now_ns) is None, "nobody to agree with yet"
        now_ns += 500 * MS
        assert broadcaster.answer(told(2, 200_000), now_ns) is not None
        answers[fully] = broadcaster.answer(told(1, -200_000), now_ns)
    asked, by_itself = answers[True], answers[False]
    assert asked is not None
    assert by_itself is not None
    own_ns = told(1, -200_000).arrivals[-1][1]
    assert asked.leader_ns - own_ns > 190_000
    assert by_itself.leader_ns - own_ns == 60_000
    assert by_itself.relative_uncertainty_ns > 130_000, "the rest is not agreed on"
