"""What clients agree on from one packet that all heard: the pure combination."""

import random
from dataclasses import replace
from statistics import median

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_app.sync.reference_broadcast import LEAST_COMMON, Cell, ClientArrivals, group_into_cells

EPOCH_NS = 3 * 10**17
"""Ten years after a clock's zero, where floats have long lost their nanoseconds."""


def arrivals_by_client(
    wrong_ns: list[int], *, seed: int = 1, beacons: int = 24, jitter_ns: float = 5000.0, missed: float = 0.0
) -> dict[int, ClientArrivals]:
    """Clients whose clocks are wrong by so much hear beacons whose way takes 0 to 2 ms."""
    rng = random.Random(seed)
    heard: list[dict[int, int]] = [{} for _ in wrong_ns]
    for number in range(1, beacons + 1):
        true_ns = EPOCH_NS + number * 250_000_000 + rng.randrange(2_000_000)
        for arrivals, error_ns in zip(heard, wrong_ns, strict=True):
            arrival_ns = true_ns + error_ns + round(rng.gauss(0.0, jitter_ns))
            if rng.random() >= missed:
                arrivals[number] = arrival_ns
    return {client: ClientArrivals(arrivals, 80_000.0, 800_000.0) for client, arrivals in enumerate(heard)}


def corrected(cell: Cell, heard: dict[int, ClientArrivals], wrong_ns: list[int]) -> dict[int, float]:
    errors = {}
    for client in cell.clients:
        place = cell.offset_of(heard[client])
        assert place is not None
        errors[client] = wrong_ns[client] - place[0]
    return errors


@pytest.mark.parametrize("missed", [0.0, 0.2])
def test_clients_of_one_cell_agree_whatever_is_wrong_with_each(missed: float) -> None:
    wrong_ns = [-220_000, 165_000, 0, 40_000, 90_000]
    heard = arrivals_by_client(wrong_ns, missed=missed)
    (cell,) = group_into_cells(heard)
    assert set(cell.clients) == set(heard)
    errors = corrected(cell, heard, wrong_ns)
    assert max(errors.values()) - min(errors.values()) < 8_000
    assert median(errors.values()) == pytest.approx(40_000, abs=5_000), "the middle one stays"
    assert cell.uncertainty_ns == 80_000.0


def test_a_clock_that_drifts_is_placed_where_it_is_now() -> None:
    heard = arrivals_by_client([0, 0, 0], jitter_ns=500.0)
    first_ns = heard[2].arrivals[1]
    fast = {n: at_ns + (at_ns - first_ns) // 100_000 for n, at_ns in heard[2].arrivals.items()}
    heard[2] = replace(heard[2], arrivals=fast)
    (cell,) = group_into_cells(heard)
    newest = {n: at_ns for n, at_ns in cell.consensus_ns.items() if n <= 20}
    for known in (cell, replace(cell, consensus_ns=newest)):
        place = known.offset_of(heard[2])
        assert place is not None
        late_ns, error_ns = place
        assert late_ns == pytest.approx(23 * 2500, abs=1500), "10 us a second, 5.75 s long"
        assert error_ns < 3000


def test_a_lying_minority_moves_nobody_far() -> None:
    honest_ns = [-20_000, -10_000, 0, 10_000, 20_000]
    wrong_ns = [*honest_ns, 700_000, 650_000]
    heard = arrivals_by_client(wrong_ns)
    (cell,) = group_into_cells(heard)
    errors = corrected(cell, heard, wrong_ns)
    assert all(abs(error) <= 25_000 for error in errors.values()), "liars are moved, not the honest"


def test_a_reporter_of_noise_is_left_alone() -> None:
    heard = arrivals_by_client([0, 10_000, 20_000])
    rng = random.Random(3)
    heard[9] = ClientArrivals({n: EPOCH_NS + rng.randrange(10**9) for n in range(1, 25)}, 1e6, 1e9)
    (cell,) = group_into_cells(heard)
    assert set(cell.clients) == {0, 1, 2}


def test_cells_that_hear_apart_are_not_mixed() -> None:
    wrong_ns = [0, 50_000, -50_000, 20_000]
    heard, later = arrivals_by_client(wrong_ns, seed=1), arrivals_by_client(wrong_ns, seed=2)
    together = group_into_cells({0: heard[0], 1: heard[1], 2: later[2], 3: later[3]})
    assert sorted(cell.clients for cell in together) == [(0, 1), (2, 3)]


def test_what_the_bounds_make_unlikely_is_not_one_instant() -> None:
    heard = arrivals_by_client([0, 400_000])
    assert len(group_into_cells(heard)) == 1
    sure = {client: replace(arrivals, hard_bound_ns=380_000.0) for client, arrivals in heard.items()}
    assert group_into_cells(sure) == []


def test_copies_sent_one_after_the_other_are_not_one_instant() -> None:
    rng = random.Random(4)
    for _ in range(20):
        heard = arrivals_by_client([0, 0])
        copy = {n: at_ns + 300_000 + rng.randint(0, 15) * 9000 for n, at_ns in heard[1].arrivals.items()}
        assert group_into_cells({0: heard[0], 1: replace(heard[1], arrivals=copy)}) == []


def test_arrivals_that_scatter_more_than_they_would_mend_are_not_used() -> None:
    heard = arrivals_by_client([0, 3000], jitter_ns=5000.0)
    sure = {client: replace(arrivals, uncertainty_ns=1500.0) for client, arrivals in heard.items()}
    assert len(group_into_cells(heard)) == 1
    assert group_into_cells(sure) == [], "clocks on a cable agree better than this"


def test_too_few_in_common_say_nothing() -> None:
    heard = arrivals_by_client([0, 0], beacons=2 * LEAST_COMMON)
    odd = {n: at_ns for n, at_ns in heard[0].arrivals.items() if n % 2}
    even = {n: at_ns for n, at_ns in heard[1].arrivals.items() if n % 2 == 0}
    assert group_into_cells({0: replace(heard[0], arrivals=odd), 1: replace(heard[1], arrivals=even)}) == []


i64 = st.integers(-(2**63), 2**63 - 1)
errors_ns = st.floats(0.0, 1e18)
arrivals = st.dictionaries(st.integers(1, 40), i64, max_size=32)
anything = st.builds(ClientArrivals, arrivals, errors_ns, errors_ns)


@settings(max_examples=50, deadline=None)
@given(st.dictionaries(st.integers(0, 9), anything, max_size=6))
def test_nothing_that_is_told_raises(told: dict[int, ClientArrivals]) -> None:
    for cell in group_into_cells(told):
        for client in cell.clients:
            cell.offset_of(told[client])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32), st.lists(i64, min_size=24, max_size=24))
def test_one_liar_of_three_cannot_drag_the_others_apart(seed: int, lies: list[int]) -> None:
    wrong_ns = [-30_000, 30_000, 0]
    heard = arrivals_by_client(wrong_ns, seed=seed)
    heard[2] = ClientArrivals(dict(zip(range(1, 25), lies, strict=True)), 1e9, 1e18)
    for cell in group_into_cells(heard):
        for client, error_ns in corrected(cell, heard, wrong_ns).items():
            assert client == 2 or abs(error_ns) < 60_000
