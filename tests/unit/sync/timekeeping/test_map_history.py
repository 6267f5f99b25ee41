"""What a wrong time map has touched, by the better one that contradicts it."""

from dataclasses import replace

import pytest

from capture_app.common.bounds import CENTURY_NS, MAX_COUNT
from capture_app.sync.clock.time_map import TimeMap
from capture_app.sync.timekeeping.map_history import HISTORY_NS, MapHistory

S, US = 1_000_000_000, 1_000
RIGHT = TimeMap(
    epoch_local_ns=0,
    offset_ns=0,
    skew=0.0,
    uncertainty_ns=50.0 * US,
    hard_bound_ns=500.0 * US,
    skew_uncertainty=0.0,
    skew_bound=0.0,
    samples=100,
    round_trip_ns=1_000 * US,
)


def history(*maps: TimeMap) -> MapHistory:
    """One map a second, from 0 s on."""
    made = MapHistory()
    for second, time_map in enumerate(maps):
        made.add(time_map, second * S)
    return made


def test_maps_that_agree_within_their_bars_doubt_nothing() -> None:
    assert MapHistory().doubt(RIGHT, S) is None
    assert history(RIGHT, RIGHT).doubt(replace(RIGHT, offset_ns=90 * US), 2 * S) is None


def test_a_step_doubts_all_times_since_the_last_sample_that_agreed() -> None:
    found = history(RIGHT, RIGHT, RIGHT).doubt(replace(RIGHT, offset_ns=-S), 3 * S, after_ns=round(1.5 * S))
    assert found is not None
    assert (found.from_local_ns, found.until_local_ns, found.jumped) == (round(1.5 * S), 3 * S, True)
    assert found.error_ns == S + 50 * US
    assert found.hard_bound_ns == S + 500 * US


def test_a_step_of_ages_is_said_in_numbers_that_a_session_can_hold() -> None:
    found = history(RIGHT).doubt(replace(RIGHT, offset_ns=-CENTURY_NS), S)
    assert found is not None
    assert (found.error_ns, found.hard_bound_ns) == (MAX_COUNT, MAX_COUNT)


def test_a_slew_doubts_times_since_the_new_line_crosses_the_old_one() -> None:
    slewed = replace(RIGHT, epoch_local_ns=round(1.25 * S), skew=500e-6)
    found = history(RIGHT, RIGHT, RIGHT).doubt(slewed, 3 * S)
    assert found is not None
    assert found.from_local_ns == pytest.approx(1.25 * S, abs=S // 100)
    assert found.error_ns == pytest.approx(500e-6 * 1.75 * S + 50 * US, rel=0.01)
    assert not found.jumped


def test_a_change_that_is_certain_doubts_what_a_bar_alone_does_not_contain() -> None:
    new = replace(RIGHT, offset_ns=80 * US)
    assert history(RIGHT).doubt(new, S) is None
    found = history(RIGHT).doubt(new, S, is_changed=True)
    assert found is not None
    assert found.error_ns == 130 * US


def test_a_slew_that_is_certain_doubts_for_as_long_again_before() -> None:
    """A slope from a second of samples may be half the true one, and leaves the old line too late."""
    slewed = replace(RIGHT, epoch_local_ns=2 * S, skew=250e-6)
    found = history(RIGHT, RIGHT, RIGHT).doubt(slewed, 3 * S, is_changed=True)
    assert found is not None
    assert found.from_local_ns == pytest.approx(S, abs=S // 100)


def test_times_of_a_long_holdover_are_doubted_too() -> None:
    made = history(RIGHT)
    made.add(RIGHT, 2 * HISTORY_NS)
    doubted = made.doubt(replace(RIGHT, offset_ns=S), 2 * HISTORY_NS + S)
    assert doubted is not None
    assert doubted.from_local_ns == 0


def test_maps_before_one_that_agreed_are_not_doubted() -> None:
    new = replace(RIGHT, offset_ns=S)
    found = history(RIGHT, new, RIGHT).doubt(new, 3 * S)
    assert found is not None
    assert found.from_local_ns == 2 * S


def test_in_holdover_the_last_map_stays_however_old() -> None:
    old = history(RIGHT)
    found = old.doubt(replace(RIGHT, offset_ns=-60 * S), 1000 * S, after_ns=10 * S)
    assert found is not None
    assert found.from_local_ns == 10 * S
    for second in range(1, 400):
        old.add(RIGHT, second * S)
    assert len(old._maps) <= 93
