"""What a node tells of itself in detail."""

from capture_app.node.camera.camera_node import NodeJournal
from capture_app.node.news import Log
from capture_app.node.wire.operating import Vitals
from capture_app.sync.clock.clock_filter import ClockSample


def test_the_drift_of_a_clock_is_taken_off_its_samples() -> None:
    journal = NodeJournal(Log(name="cam00"))
    for second in range(5):
        local_ns = second * 1_000_000_000
        leader_ns = local_ns + 7_000_000_000 + second * 30_000  # it gains 30 ppm
        journal.add_sample(ClockSample(local_ns, leader_ns + 50_000, leader_ns + 50_000, local_ns + 100_000))
    detail = journal.detail(Vitals(), skew_ppm=30.0, phase_errors_ns=(), newest=None, spool=None)
    assert {trip for _, trip in detail.samples} == {100_000}
    offsets = [offset for offset, _ in detail.samples]
    assert max(offsets) - min(offsets) <= 3
    assert abs(offsets[-1] - 7_000_120_000) <= 3
