import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_app.common import host_clock, system
from capture_app.common.clock import HostClock, SimulatedClock, parse_clock
from capture_app.common.errors import BadInputError
from capture_app.common.host_clock import host_ns

HOUR_NS = 3_600_000_000_000
true_times_ns = st.integers(-HOUR_NS, 10_000 * HOUR_NS)


@given(
    true_ns=true_times_ns,
    offset_ns=st.integers(-100 * HOUR_NS, 100 * HOUR_NS),
    skew_ppm=st.floats(-50, 50),
    epoch_true_ns=true_times_ns,
)
def test_inverse_to_one_ns(true_ns: int, offset_ns: int, skew_ppm: float, epoch_true_ns: int) -> None:
    clock = SimulatedClock(offset_ns, skew_ppm, epoch_true_ns)
    assert abs(clock.true_from_local(clock.local_from_true(true_ns)) - true_ns) <= 1
    assert abs(clock.local_from_true(clock.true_from_local(true_ns)) - true_ns) <= 1


def test_skew_counts_from_the_epoch() -> None:
    clock = SimulatedClock(7 * HOUR_NS, 12.5, epoch_true_ns=5 * HOUR_NS)
    assert clock.local_from_true(5 * HOUR_NS) == 12 * HOUR_NS
    assert clock.local_from_true(5 * HOUR_NS + 1_000_000_000) == 12 * HOUR_NS + 1_000_012_500
    assert clock.local_from_true(4 * HOUR_NS) == 11 * HOUR_NS - 45_000_000


def test_skew_of_a_part_per_trillion_is_kept_over_a_year() -> None:
    year_ns = 365 * 24 * HOUR_NS
    assert SimulatedClock(0, 1e-6).local_from_true(year_ns) - year_ns == year_ns // 10**12


@pytest.mark.parametrize("platform", ["linux", "darwin", "win32"])
def test_the_hosts_clock_goes_on_while_the_machine_sleeps(
    monkeypatch: pytest.MonkeyPatch, platform: str
) -> None:
    """A leader that slept was behind its cameras; Windows' clock goes on by itself."""
    monkeypatch.setattr(host_clock, "_asleep_ns", [HOUR_NS])
    monkeypatch.setattr(sys, "platform", platform)
    lost_ns = []
    for asleep_ns in (HOUR_NS + 50_000_000, 2 * HOUR_NS, 2 * HOUR_NS - 80_000_000, 2 * HOUR_NS + 40_000_000):
        monkeypatch.setattr(system, "asleep_ns", lambda ns=asleep_ns: ns)
        lost_ns.append(HostClock().local_from_true(7) - 7)
        assert HostClock().true_from_local(lost_ns[-1] + 7) == 7
    assert lost_ns == ([0] * 4 if platform == "win32" else [0, *[HOUR_NS] * 3])
    assert host_clock.slept_ns() >= HOUR_NS


def test_host_clock_is_the_hosts_own() -> None:
    clock = HostClock()
    before_ns = host_ns()
    assert before_ns <= clock.now_ns() <= host_ns()
    assert clock.local_from_true(5) == clock.true_from_local(5) == 5


def test_now_is_the_map_of_the_hosts_clock() -> None:
    clock = SimulatedClock(-3 * HOUR_NS, -50.0)
    before_ns = host_ns()
    now_ns = clock.now_ns()
    assert clock.local_from_true(before_ns) <= now_ns <= clock.local_from_true(host_ns())


def test_parse() -> None:
    assert parse_clock("host", node="a") == HostClock()
    assert parse_clock("sim:offset_s=7200,skew_ppm=12.5", node="a") == SimulatedClock(2 * HOUR_NS, 12.5)
    assert parse_clock("sim:skew_ppm=-3", node="a") == SimulatedClock(0, -3.0)


def test_seeded_by_the_name() -> None:
    clocks = {name: parse_clock("sim", node=name) for name in ("left", "right", "left2")}
    assert parse_clock("sim", node="left") == clocks["left"]
    assert len({clock.local_from_true(0) for clock in clocks.values()}) == 3
    for clock in clocks.values():
        assert isinstance(clock, SimulatedClock)
        assert HOUR_NS <= clock.offset_ns <= 10 * HOUR_NS
        assert abs(clock.skew_ppm) <= 50


@pytest.mark.parametrize(
    "text",
    [
        "",
        "gps",
        "host:",
        "sim:",
        "sim:offset_s",
        "sim:offset_s=",
        "sim:offset_s=soon",
        "sim:offset=7",
        "sim:skew_ppm=nan",
        "sim:skew_ppm=5000",
        "sim:offset_s=inf",
        "sim:offset_s=nan",
    ],
)
def test_bad_clock_says_what_to_write(text: str) -> None:
    with pytest.raises(BadInputError) as error:
        parse_clock(text, node="a")
    assert error.value.hint
