import struct

import pytest

from capture_app.companions.interop.rpicam import PACKET, READY_EVERY_NS, SEND_EVERY_NS, sync_packet
from capture_app.sync.phase.frame_grid import FrameGrid
from tests.unit.companions.interop.rpicam_client import RpicamClient

S = 1_000_000_000
WALL_NS = 1_790_000_000 * S
GOAL = FrameGrid(123_456_789, 33_333_000)


def wall(leader_ns: int) -> int:
    return leader_ns + WALL_NS


def test_a_packet_has_the_latest_instant_and_the_next_mark() -> None:
    now_ns = 5000 * S + 7
    duration, _, frame_us, _, ready_us = PACKET.unpack(sync_packet(GOAL, now_ns, wall))
    frame_ns, ready_ns = frame_us * 1000 - WALL_NS, ready_us * 1000 - WALL_NS
    assert duration == 33_333
    assert 0 <= now_ns - frame_ns < GOAL.period_ns
    assert abs(GOAL.phase_error(frame_ns)) <= 500
    assert abs(GOAL.phase_error(ready_ns)) <= 500
    assert abs(ready_ns - 5010 * S) <= GOAL.period_ns // 2 + 500
    later_us = PACKET.unpack(sync_packet(GOAL, now_ns + READY_EVERY_NS - 100, wall))[4]
    assert later_us == ready_us


def test_a_packet_is_what_the_pi_reads() -> None:
    packet = sync_packet(GOAL, 5000 * S, wall)
    assert len(packet) == 40
    assert struct.unpack_from("<I", packet)[0] == 33_333
    assert struct.unpack_from("<Q", packet, 16)[0] == PACKET.unpack(packet)[2]


@pytest.mark.parametrize("ppm", [-35.0, 0.0, 50.0])
def test_a_pi_that_follows_exposes_at_the_rigs_instants(ppm: float) -> None:
    # The Pi's clocks are the true time here; the stamp of a Pi is the end of its first row's exposure.
    now_ns = 5000 * S
    client = RpicamClient(7, ppm=ppm, start_true_ns=now_ns + WALL_NS)
    shutter_ns = client.sensor.profile.exposure_ns
    while now_ns < 5030 * S:
        client.receive(sync_packet(GOAL, now_ns, wall, shutter_ns=shutter_ns))
        now_ns += SEND_EVERY_NS
        client.run_until(now_ns + WALL_NS)
    errors = [abs(GOAL.phase_error(f.start_true_ns - WALL_NS)) for f in client.frames]
    assert max(errors[:10]) > 1_000_000
    assert max(errors[120:]) < 120_000
    assert client.ready_us is not None
