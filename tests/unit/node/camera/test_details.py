"""What a node tells of itself in detail."""

from capture_app.node.camera.viewfinder import offsets_of
from capture_app.sync.clock.clock_filter import ClockSample


def test_the_drift_of_a_clock_is_taken_off_its_samples() -> None:
    samples = []
    for second in range(5):
        local_ns = second * 1_000_000_000
        leader_ns = local_ns + 7_000_000_000 + second * 30_000  # it gains 30 ppm
        samples.append(ClockSample(local_ns, leader_ns + 50_000, leader_ns + 50_000, local_ns + 100_000))
    told = offsets_of(samples, skew_ppm=30.0)
    assert {trip for _, trip in told} == {100_000}
    offsets = [offset for offset, _ in told]
    assert max(offsets) - min(offsets) <= 3
    assert abs(offsets[-1] - 7_000_120_000) <= 3
