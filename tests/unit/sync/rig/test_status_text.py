"""Why a clock is coarser than asked for, and what would help, in one sentence that holds."""

import pytest

from capture_app.sync.rig.status_text import degraded, syncing

WIRELESS_NS, LOOPBACK_NS = 3_000_000, 60_000


@pytest.mark.parametrize(
    ("error_ns", "advised"), [(600.0, 1), (1_900.0, 5), (2_200.0, 5), (3_300.0, 5), (41_000.0, 100)]
)
def test_the_advised_tolerance_has_room_and_stays_while_the_estimate_wavers(
    error_ns: float, advised: int
) -> None:
    sentence = degraded(error_ns, 500.0, WIRELESS_NS, by_relay=False)
    assert sentence.endswith(f" --clock-tolerance-us {advised}")


def test_only_what_talks_by_a_network_is_sent_nearer_to_the_access_point() -> None:
    assert "nearer the access point" in degraded(2_200.0, 1_000.0, WIRELESS_NS, by_relay=False)
    assert degraded(2_200.0, 1_000.0, LOOPBACK_NS, by_relay=False) == (
        "clock error ≤ 2.2 µs, target 1.0 µs:"
        " messages with a round trip of 60 µs are delayed at times; use --clock-tolerance-us 5"
    )
    assert degraded(110_000.0, 100_000.0, 1_600_000, by_relay=False) == (
        "clock error ≤ 110 µs, target 100 µs: even its fastest messages have a round trip of 1.6 ms,"
        " and none shows how it divides between the two directions; nearer the access point, a cable,"
        " a panel (capture-app cameras calibrate-time --panel), or --clock-tolerance-us 200"
    )
    assert "bring the relay nearer" in degraded(2_200.0, 1_000.0, LOOPBACK_NS, by_relay=True)


def test_a_clock_that_is_measured_says_how_far_that_is() -> None:
    assert syncing(169, 300, None, 1_000.0) == "measuring clock 169/300"
