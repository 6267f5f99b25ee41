"""What the server of rpicam-apps (`rpicam-vid --sync server`) tells its clients, made of a rig's grid.

A packet of 40 bytes, little-endian, by raspberrypi/libcamera, src/ipa/rpi/controller/rpi/sync.h: frame
duration (32 bits, and 32 of padding), time of a frame by the kernel's clock, the same by the wall clock, time
when clients are ready by the kernel's clock, the same by the wall clock; in us. Clients use the duration and
the wall clock's two. They synchronize no clocks: a packet is in the wall clock of those who receive it.
"""

import struct
from collections.abc import Callable

from capture_app.sync.phase.goal import Goal

GROUP, PORT = "239.255.255.250", 10_000
PACKET = struct.Struct("<I4xQQQQ")
SEND_EVERY_NS = 500_000_000
"""A client obeys each packet by one longer or shorter frame, some frames later: not much more often."""
READY_EVERY_NS = 10_000_000_000
"""Clients begin to record together at the first such mark of leader time after they have heard of it."""


def sync_packet(
    goal: Goal, leader_ns: int, wall_from_leader: Callable[[int], int], *, shutter_ns: int = 0
) -> bytes:
    """Return the packet of the latest instant of a grid; `wall_from_leader` is for the receiver's wall clock.

    A Pi stamps a frame at the end of its first row's exposure, which is `shutter_ns` after its start.
    """
    latest_ns = goal.instant(goal.index_of(leader_ns - goal.period_ns // 2))
    mark_ns = (leader_ns // READY_EVERY_NS + 1) * READY_EVERY_NS
    frame_us, ready_us = (
        round((wall_from_leader(instant_ns) + shutter_ns) / 1000)
        for instant_ns in (latest_ns, goal.instant(goal.index_of(mark_ns)))
    )
    return PACKET.pack(round(goal.period_ns / 1000), 0, frame_us, 0, ready_us)
