"""The clock filter against simulated exchanges whose truth is known."""

import random
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from capture_app.sync.clock.clock_filter import STEP_SAMPLES, ClockFilter, ClockSample, PathAsymmetry
from capture_app.sync.clock.time_map import TimeMap

MS, HOUR_NS = 1_000_000, 3_600_000_000_000
S = 1_000_000_000


class Link:
    """A leader's clock over a local one: offset, skew (ppm), and from `bend_ns` on another skew."""

    def __init__(self, *, offset_ns: int, skew_ppm: float, epoch_ns: int) -> None:
        self.offset_ns, self.skew_ppm, self.epoch_ns = offset_ns, skew_ppm, epoch_ns

    def leader(self, local_ns: int) -> int:
        return local_ns + self.offset_ns + round(self.skew_ppm * 1e-6 * (local_ns - self.epoch_ns))

    def exchange(self, t0_ns: int, there_ns: int, back_ns: int, turnaround_ns: int = 20_000) -> ClockSample:
        arrives, leaves = t0_ns + there_ns, t0_ns + there_ns + turnaround_ns
        return ClockSample(t0_ns, self.leader(arrives), self.leader(leaves), leaves + back_ns)


def paper_delays(rng: random.Random) -> tuple[int, int]:
    """Gamma-2 delays of the paper's link: minimum 479 / 517 us, mean 1878 / 1133 us."""
    there = 479_000 + rng.gammavariate(2, 699_500)
    back = 517_000 + rng.gammavariate(2, 308_000)
    return int(there), int(back)


def error_ns(time_map: TimeMap, link: Link, local_ns: int) -> int:
    return abs(time_map.leader_from_local(local_ns) - link.leader(local_ns))


def run(link: Link, start_ns: int, seed: int, seconds: float) -> tuple[ClockFilter, int]:
    """300 exchanges 3 ms apart, then one each 35 ms; returns the filter and the local time of the end."""
    rng, clock = random.Random(seed), ClockFilter()
    t_ns, end_ns = start_ns, start_ns + int(seconds * S)
    for i in range(100_000):
        if t_ns >= end_ns:
            break
        assert clock.add(link.exchange(t_ns, *paper_delays(rng)))
        t_ns += 3 * MS if i < 300 else 35 * MS
    return clock, t_ns


def test_a_sample_bounds_the_offset_from_both_sides() -> None:
    sample = ClockSample(t0_ns=1000, t1_ns=5600, t2_ns=5700, t3_ns=1500)
    assert sample.round_trip_ns == 400
    assert sample.lower_ns == 4200 <= 4400 <= sample.upper_ns == 4600


def test_there_is_no_map_before_the_first_sample_or_after_a_reset() -> None:
    clock = ClockFilter()
    assert clock.time_map(0) is None
    clock.add(ClockSample(0, 100, 110, 50))
    assert clock.time_map(0) is not None
    clock.reset()
    assert clock.time_map(0) is None
    assert clock.samples == 0


def test_one_sample_gives_the_middle_and_half_the_round_trip() -> None:
    link = Link(offset_ns=7 * 3600 * S, skew_ppm=0, epoch_ns=0)
    clock = ClockFilter()
    clock.add(link.exchange(S, 200_000, 300_000))
    time_map = clock.time_map(S + 260_000)
    assert time_map is not None
    assert error_ns(time_map, link, S + 260_000) == pytest.approx(50_000, abs=5)
    assert time_map.hard_bound_ns == pytest.approx(250_000, abs=600)
    assert time_map.uncertainty_ns <= time_map.hard_bound_ns
    assert time_map.round_trip_ns == 500_000


def test_a_second_of_the_papers_link_comes_within_tens_of_microseconds() -> None:
    errors = []
    for seed in range(12):
        link = Link(offset_ns=-(10**13), skew_ppm=random.Random(seed).uniform(-40, 40), epoch_ns=0)
        clock, now_ns = run(link, 10**12, seed, 0.9)
        time_map = clock.time_map(now_ns)
        assert time_map is not None
        errors.append(error_ns(time_map, link, now_ns))
        assert errors[-1] <= time_map.hard_bound_ns
    assert sum(errors) / len(errors) < 35_000
    assert max(errors) < 90_000


@pytest.mark.parametrize("skew_ppm", [-800.0, -80.0, 80.0])
def test_background_samples_learn_the_skew(skew_ppm: float) -> None:
    link = Link(offset_ns=10**13, skew_ppm=skew_ppm, epoch_ns=0)
    clock, now_ns = run(link, 10**12, seed=4, seconds=40)
    time_map = clock.time_map(now_ns)
    assert time_map is not None
    assert time_map.skew * 1e6 == pytest.approx(skew_ppm, abs=4)
    for ahead_ns in (0, 2 * S, 10 * S):
        error = error_ns(time_map, link, now_ns + ahead_ns)
        assert error < 150_000
        assert error <= time_map.uncertainty_at(now_ns + ahead_ns)
        assert error <= time_map.hard_bound_at(now_ns + ahead_ns)


def test_bound_and_uncertainty_grow_with_age() -> None:
    link = Link(offset_ns=0, skew_ppm=10, epoch_ns=0)
    clock, now_ns = run(link, 10**12, seed=1, seconds=5)
    maps = [clock.time_map(now_ns + age * S) for age in (0, 5, 20)]
    bounds = [m.hard_bound_ns for m in maps if m]
    uncertainties = [m.uncertainty_ns for m in maps if m]
    assert bounds == sorted(bounds)
    assert uncertainties == sorted(uncertainties)
    assert bounds[2] > bounds[0] + 100_000


def test_the_uncertainty_is_honest() -> None:
    inside = []
    for seed in range(30):
        rng = random.Random(seed)
        link = Link(offset_ns=rng.randrange(10**13), skew_ppm=rng.uniform(-80, 80), epoch_ns=0)
        clock, now_ns = run(link, 10**12, seed, rng.choice((0.5, 0.9, 3.0)))
        time_map = clock.time_map(now_ns)
        assert time_map is not None
        inside.append(error_ns(time_map, link, now_ns) <= time_map.uncertainty_ns)
    assert sum(inside) >= 28


delays = st.integers(min_value=0, max_value=3 * S)
exchanges = st.lists(
    st.tuples(st.integers(0, 20 * S), delays, delays, st.integers(0, 1000 * MS)), min_size=1, max_size=60
)


@settings(max_examples=150, deadline=None)
@given(
    exchanges=exchanges,
    offset_ns=st.integers(-(10**14), 10**14),
    skew_ppm=st.floats(-999.9, 999.9),
    asked=st.lists(st.integers(-5 * S, 60 * S), min_size=1, max_size=5),
    order=st.randoms(use_true_random=False),
)
def test_the_hard_bound_covers_the_truth_whatever_the_network_does(
    exchanges: list[tuple[int, int, int, int]],
    offset_ns: int,
    skew_ppm: float,
    asked: list[int],
    order: random.Random,
) -> None:
    """Any delays, any order, any duplicates; losses are the exchanges that are not in the list."""
    link = Link(offset_ns=offset_ns, skew_ppm=skew_ppm, epoch_ns=10**12)
    samples = [link.exchange(10**12 + t, there, back, turn) for t, there, back, turn in exchanges]
    samples += order.choices(samples, k=len(samples) // 2)
    order.shuffle(samples)
    clock = ClockFilter()
    for i, sample in enumerate(samples):
        assert clock.add(sample), "nothing stepped"
        if i % 7 and i + 1 < len(samples):
            continue
        for after in asked:
            local_ns = 10**12 + after
            time_map = clock.time_map(local_ns)
            if time_map is None:  # the skew alone can make a round trip of nothing negative
                continue
            for distance_ns in (0, -S, 3 * S):
                at_ns = local_ns + distance_ns
                assert error_ns(time_map, link, at_ns) <= time_map.hard_bound_at(at_ns) + 2
                assert time_map.uncertainty_at(at_ns) <= time_map.hard_bound_at(at_ns)


times = st.integers(min_value=-(2**63), max_value=2**63 - 1)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.builds(ClockSample, times, times, times, times), max_size=30), times)
def test_nonsense_never_raises(samples: list[ClockSample], now_ns: int) -> None:
    clock = ClockFilter()
    for sample in samples:
        clock.add(sample)
        clock.time_map(now_ns)


def test_a_sample_with_a_negative_round_trip_is_ignored() -> None:
    clock = ClockFilter()
    assert clock.add(ClockSample(0, 100, 500, 300))
    assert clock.samples == 0


@pytest.mark.parametrize("step_ns", [-5 * MS, 5 * MS, 3600 * S])
def test_a_step_is_reported_and_restarts_the_filter(step_ns: int) -> None:
    link = Link(offset_ns=10**10, skew_ppm=30, epoch_ns=0)
    clock, now_ns = run(link, 10**12, seed=2, seconds=3)
    on_its_way = link.exchange(now_ns - 30 * MS, 5 * MS, 24 * MS)
    link.offset_ns += step_ns
    before = clock.samples
    for i in range(STEP_SAMPLES - 1):
        assert clock.add(link.exchange(now_ns + 3 * MS * i, 600_000, 600_000))
        assert clock.samples == before, "one alone may be a lie"
    assert not clock.add(link.exchange(now_ns + 3 * MS * (STEP_SAMPLES - 1), 600_000, 600_000))
    assert clock.samples == STEP_SAMPLES
    assert clock.add(on_its_way), "a late message of before the step must not count as another step"
    assert clock.samples == STEP_SAMPLES
    for i in range(STEP_SAMPLES, 100):
        assert clock.add(link.exchange(now_ns + 3 * MS * i, 600_000, 700_000))
    time_map = clock.time_map(now_ns + 300 * MS)
    assert time_map is not None
    assert error_ns(time_map, link, now_ns + 300 * MS) <= time_map.hard_bound_ns < 1.5 * MS


@pytest.mark.parametrize("lies", range(1, STEP_SAMPLES))
def test_a_step_that_the_next_samples_do_not_confirm_is_refused(lies: int) -> None:
    link = Link(offset_ns=10**10, skew_ppm=30, epoch_ns=0)
    clock, now_ns = run(link, 10**12, seed=2, seconds=3)
    for _ in range(5):
        map_before = clock.time_map(now_ns)
        for _ in range(lies):
            true = link.exchange(now_ns, 600_000, 600_000)
            assert clock.add(replace(true, t1_ns=true.t1_ns + HOUR_NS, t2_ns=true.t2_ns + HOUR_NS))
        assert clock.time_map(now_ns) == map_before
        assert clock.add(link.exchange(now_ns, 10 * MS, 10 * MS))
    assert clock.refused_steps == 5
    time_map = clock.time_map(now_ns)
    assert time_map is not None
    assert error_ns(time_map, link, now_ns) <= time_map.hard_bound_ns


def test_samples_of_different_steps_confirm_none() -> None:
    link = Link(offset_ns=10**10, skew_ppm=30, epoch_ns=0)
    clock, now_ns = run(link, 10**12, seed=2, seconds=3)
    map_before = clock.time_map(now_ns)
    for hours in range(1, 20):
        true = link.exchange(now_ns, 600_000, 600_000)
        assert clock.add(
            replace(true, t1_ns=true.t1_ns + hours * HOUR_NS, t2_ns=true.t2_ns + hours * HOUR_NS)
        )
    assert clock.time_map(now_ns) == map_before


def test_slow_wander_forgets_the_old_and_is_not_a_step() -> None:
    """A skew that turns by 60 ppm within a minute, 100 times what a warming crystal does."""
    clock, rng = ClockFilter(), random.Random(3)
    offset = 0.0
    t_ns = 10**12
    for i in range(2400):
        skew_ppm = 60.0 * i / 2400
        offset += skew_ppm * 1e-6 * 25 * MS
        there, back = 50_000 + int(rng.expovariate(1e-4)), 50_000 + int(rng.expovariate(1e-4))
        shift = round(offset)
        sample = ClockSample(t_ns, t_ns + there + shift, t_ns + there + shift, t_ns + there + back)
        assert clock.add(sample)
        if i % 4 == 0:
            clock.time_map(t_ns)
        t_ns += 25 * MS
    time_map = clock.time_map(t_ns)
    assert time_map is not None
    assert abs(time_map.leader_from_local(t_ns) - t_ns - offset) < 60_000
    assert time_map.skew * 1e6 == pytest.approx(60, abs=15)
    assert clock.changes.rate_changed_ns is None, "it is no host that is slewed"


@pytest.mark.parametrize("slew_ppm", [-500, 100, 500])
def test_a_slewed_leader_is_reported_and_followed(slew_ppm: int) -> None:
    """Another rate from one moment on, as when an NTP daemon slews a clock."""
    link = Link(offset_ns=10**10, skew_ppm=20, epoch_ns=0)
    clock, now_ns = run(link, 10**12, seed=5, seconds=20)
    assert clock.time_map(now_ns) is not None
    assert clock.changes.rate_changed_ns is None
    link.offset_ns, link.skew_ppm, link.epoch_ns = link.leader(now_ns) - now_ns, 20 + slew_ppm, now_ns
    rng, end_ns = random.Random(6), now_ns + 16 * S
    for t_ns in range(now_ns, end_ns, 25 * MS):
        assert clock.add(link.exchange(t_ns, *paper_delays(rng)))
        time_map = clock.time_map(t_ns)
        assert time_map is not None
        assert error_ns(time_map, link, t_ns) <= time_map.hard_bound_ns
    changed_ns = clock.changes.rate_changed_ns
    assert changed_ns is not None
    assert now_ns < changed_ns <= now_ns + 8 * S
    assert time_map is not None
    assert time_map.skew * 1e6 == pytest.approx(20 + slew_ppm, abs=30)
    time_map = clock.time_map(end_ns)
    assert time_map is not None
    assert error_ns(time_map, link, end_ns) <= time_map.uncertainty_ns


def unequal_clock(asymmetry: PathAsymmetry | None, *, shorter_ns: int = 0) -> tuple[float, TimeMap]:
    """A second on a link whose least delays are 400 us there and 800 us back; the error, and the map."""
    link, rng, clock = Link(offset_ns=HOUR_NS, skew_ppm=8.0, epoch_ns=0), random.Random(4), ClockFilter()
    clock.asymmetry = asymmetry
    for i in range(300):
        there, back = (least + rng.gammavariate(2, 300_000) for least in (400_000, 800_000 - shorter_ns))
        assert clock.add(link.exchange(i * 3 * MS, int(there), int(back)))
    time_map = clock.time_map(900 * MS)
    assert time_map is not None
    return time_map.leader_from_local(900 * MS) - link.leader(900 * MS), time_map


def test_a_link_that_was_measured_keeps_what_messages_cannot_show() -> None:
    error, unknown = unequal_clock(None)
    assert error == pytest.approx(-200_000, abs=30_000), "half of what the way back is longer"
    assert abs(error) > unknown.uncertainty_ns
    error, known = unequal_clock(PathAsymmetry(200_000, 20_000, 1_210_000))
    assert abs(error) < known.uncertainty_ns < unknown.uncertainty_ns
    assert abs(error) <= known.hard_bound_ns < unknown.hard_bound_ns + 201_000
    error, unsure = unequal_clock(PathAsymmetry(200_000, 110_000, 1_210_000))
    assert abs(error) < 60_000 < unsure.uncertainty_ns, "three and a half sigma from a usual link"


def test_an_asymmetry_less_certain_than_the_default_or_of_another_link_is_ignored() -> None:
    assert unequal_clock(PathAsymmetry(200_000, 400_000, 1_210_000)) == unequal_clock(None)
    # The leader moved: the round trip is now another one, and so may be what the two ways differ by.
    measured = PathAsymmetry(200_000, 20_000, 1_210_000)
    assert unequal_clock(measured, shorter_ns=400_000) == unequal_clock(None, shorter_ns=400_000)


def test_what_was_measured_moves_no_clock_out_of_its_bounds() -> None:
    for late_ns in (10**9, -1e300):
        error, time_map = unequal_clock(PathAsymmetry(late_ns, 1, 1_210_000))
        assert abs(error) <= time_map.hard_bound_ns
