"""A client's side of the reference broadcast: told when due, moved slowly, never beyond what is proven."""

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.reference_broadcast import (
    KEPT_BEACONS,
    LEAST_COMMON,
    MAX_AGE_NS,
    REPORT_EVERY_NS,
    SLEW,
    Listener,
)
from capture_app.sync.wire.messages import AgreedArrival, ArrivalReport

MS = 1_000_000
S = 1000 * MS
BEACON_NS = 250 * MS
OFFSET_NS = 7 * 3600 * S
OWN = TimeMap(0, OFFSET_NS, 0.0, 40_000.0, 500_000.0, 0.0, 0.0, samples=300, round_trip_ns=1_000_000)


def at(now_ns: int, offset_ns: int = OFFSET_NS) -> TimeMap:
    return replace(OWN, epoch_local_ns=now_ns, offset_ns=offset_ns)


def heard_some() -> tuple[Listener, int]:
    """A listener that has heard beacons 1 to 24, and the time of the last one."""
    listener = Listener()
    for number in range(1, KEPT_BEACONS + 1):
        listener.add_arrival(number, number * BEACON_NS)
    return listener, KEPT_BEACONS * BEACON_NS


def agree(listener: Listener, heard_ns: int, late_ns: int, relative_uncertainty_ns: int = 5000) -> None:
    agreed_ns = heard_ns + OFFSET_NS - late_ns
    listener.accept(AgreedArrival(1, heard_ns // BEACON_NS, agreed_ns, 30_000, relative_uncertainty_ns))


def test_nothing_is_told_before_enough_was_heard() -> None:
    listener = Listener()
    for number in range(1, LEAST_COMMON):
        listener.add_arrival(number, number * BEACON_NS)
    assert listener.next_timer() is None
    listener.add_arrival(LEAST_COMMON, LEAST_COMMON * BEACON_NS)
    now_ns = LEAST_COMMON * BEACON_NS
    told = listener.report_due(7, at(now_ns), now_ns)
    assert isinstance(told, ArrivalReport)
    assert (told.client, told.uncertainty_ns, told.hard_bound_ns) == (7, 40_000, 500_000)
    assert told.arrivals[0] == (1, BEACON_NS + OFFSET_NS)
    assert len(told.arrivals) == LEAST_COMMON


def test_it_is_told_once_a_second_and_only_with_news() -> None:
    listener, now_ns = heard_some()
    assert listener.report_due(7, at(now_ns), now_ns) is not None
    assert listener.next_timer() is None, "no news"
    listener.add_arrival(KEPT_BEACONS + 1, now_ns + 1)
    assert listener.next_timer() == now_ns + REPORT_EVERY_NS
    assert listener.report_due(7, at(now_ns), now_ns + REPORT_EVERY_NS - 1) is None
    told = listener.report_due(7, at(now_ns), now_ns + REPORT_EVERY_NS)
    assert told is not None
    assert len(told.arrivals) == KEPT_BEACONS, "the oldest goes"


def test_of_copies_the_first_counts() -> None:
    listener, now_ns = heard_some()
    listener.add_arrival(KEPT_BEACONS, now_ns + 300_000)
    told = listener.report_due(7, at(now_ns), now_ns)
    assert told is not None
    assert told.arrivals[-1] == (KEPT_BEACONS, now_ns + OFFSET_NS)


def test_without_an_agreement_the_estimate_is_left_as_it_is() -> None:
    listener, now_ns = heard_some()
    own = at(now_ns)
    assert listener.correct(own, now_ns) is own
    listener.accept(AgreedArrival(1, KEPT_BEACONS + 9, 0, 0, 0))
    assert listener.correct(own, now_ns) is own, "a beacon that was not heard here"


def test_a_clock_is_moved_slowly_and_says_what_is_left() -> None:
    listener, now_ns = heard_some()
    agree(listener, now_ns, late_ns=50_000)
    moved = listener.correct(at(now_ns), now_ns)
    assert moved.offset_ns == OFFSET_NS
    assert listener.corrected is not None
    assert listener.corrected.relative_uncertainty_ns == 55_000
    for _ in range(5):
        now_ns += 100 * MS
        before = moved
        moved = listener.correct(at(now_ns), now_ns)
        assert 0 < before.offset_ns - moved.offset_ns <= SLEW * 100 * MS
    assert moved.offset_ns == OFFSET_NS - 50_000
    assert listener.corrected is not None
    assert listener.corrected.reference_correction_ns == -50_000
    assert listener.corrected.relative_uncertainty_ns == 5000
    assert moved.uncertainty_ns == 30_000.0, "what the cell knows together"
    assert moved.hard_bound_ns == 550_000.0, "the proof is of the estimate, not of where it was moved"


def test_an_estimate_that_jumps_does_not_take_the_clock_along() -> None:
    listener, now_ns = heard_some()
    agree(listener, now_ns, late_ns=10_000)
    for _ in range(3):
        now_ns += 100 * MS
        settled = listener.correct(at(now_ns), now_ns)
    jumped = listener.correct(at(now_ns + 100 * MS, OFFSET_NS + 60_000), now_ns + 100 * MS)
    assert settled.offset_ns == jumped.offset_ns == OFFSET_NS - 10_000


def test_an_agreement_fades_when_no_more_is_heard() -> None:
    listener, heard_ns = heard_some()
    agree(listener, heard_ns, late_ns=20_000)
    now_ns = heard_ns
    while now_ns < heard_ns + MAX_AGE_NS:
        now_ns += 100 * MS
        last = listener.correct(at(now_ns), now_ns)
    assert last.offset_ns == OFFSET_NS - 20_000
    for _ in range(4):
        now_ns += 100 * MS
        last = listener.correct(at(now_ns), now_ns)
    assert last == at(now_ns)
    assert listener.corrected is None


def test_what_is_proven_impossible_is_not_believed() -> None:
    listener, now_ns = heard_some()
    agree(listener, now_ns, late_ns=500_001)
    for _ in range(30):
        now_ns += 100 * MS
        own = at(now_ns)
        assert listener.correct(own, now_ns) is own


def test_a_leader_that_changed_takes_its_agreements_along() -> None:
    listener, now_ns = heard_some()
    agree(listener, now_ns, late_ns=10_000)
    listener.correct(at(now_ns + 100 * MS), now_ns + 100 * MS)
    listener.reset()
    assert listener.correct(own := at(now_ns + 200 * MS), now_ns + 200 * MS) is own
    assert listener.next_timer() is None


steps = st.lists(
    st.tuples(
        st.integers(0, 3 * S),
        st.integers(-600_000, 600_000),
        st.none()
        | st.tuples(st.integers(1, 40), st.integers(-(10**6), 10**6) | st.integers(-(2**63), 2**63 - 1)),
    ),
    max_size=40,
)


@given(steps)
def test_no_answer_moves_a_clock_out_of_its_hard_bound(
    steps: list[tuple[int, int, tuple[int, int] | None]],
) -> None:
    """Whatever the leader says and however the estimate jumps: the true time stays within what is told."""
    listener, now_ns = heard_some()
    for wait_ns, error_ns, answer in steps:
        now_ns += wait_ns
        if answer is not None:
            number, off_ns = answer
            near_ns = number * BEACON_NS + OFFSET_NS + off_ns if abs(off_ns) < 10**7 else off_ns
            listener.accept(AgreedArrival(1, number, near_ns, 10_000, 1000))
        own = replace(at(now_ns, OFFSET_NS + error_ns), hard_bound_ns=600_000.0)
        moved = listener.correct(own, now_ns)
        assert abs(moved.offset_ns - own.offset_ns) <= own.hard_bound_ns
        assert abs(moved.offset_ns - OFFSET_NS) <= moved.hard_bound_ns
        assert moved.uncertainty_ns <= moved.hard_bound_ns
