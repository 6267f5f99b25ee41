"""Malformed protocol messages as an untrusted peer sends them, by datagram and by stream."""

import random
import struct
from contextlib import suppress
from typing import Any

import msgspec

from capture_app.common.camera_facts import EXACT_STAMPS, CameraFacts, PhaseControl, TimestampSource
from capture_app.common.node_state import NodeState
from capture_app.protocol import messages as wire
from capture_app.protocol import orders
from capture_app.session.format.burst_plan import CameraPlan
from capture_app.session.format.manifest import CameraRecord
from capture_app.sync.wire import datagrams
from capture_app.sync.wire.codec import encode

NASTY: tuple[Any, ...] = (
    None, True, 0, -1, 1, 2**31, 2**63 - 1, -(2**63), 2**64 - 1, 1e308, float("nan"), float("inf"), "", "a",
    "\x1b[2J\x1b]0;owned\x07", "x" * 300, b"\xff\xfe", [], [[[]]], {}, {"type": "hello"}, 33_333_333,
)  # fmt: skip
FACTS = CameraFacts(
    kind="sim",
    model="stranger",
    width=640,
    height=480,
    period_ns=33_333_333,
    phase_control=PhaseControl.INJECTION,
    timestamp_source=TimestampSource.START_OF_EXPOSURE,
)
CONFIG = datagrams.RigConfigMessage(
    leader=1, anchor_leader_ns=0, period_ns=60_000_000_000, poll_interval_ns=60_000_000_000
)
INSIDER = datagrams.Hello("insider", 3, FACTS)
DATAGRAMS: tuple[Any, ...] = (
    INSIDER,
    datagrams.Hello("stranger", 1, FACTS),
    datagrams.Hello("cam1", 2, FACTS),
    datagrams.Heartbeat(1, datagrams.Report(state=NodeState.READY, frame_leader_ns=5)),
    datagrams.MemberReports(((1, datagrams.Report(state=NodeState.LOST)),)),
    datagrams.TriggerAck(1, 2, 3, "no", (4, 5)),
    datagrams.Goodbye(1),
    datagrams.Welcome(1, 1, 47010, CONFIG),
    datagrams.HeartbeatAck(1, CONFIG),
    datagrams.Trigger(1, 1, 1, 0, 1, 1, others=(4, 5)),
    datagrams.UnknownMember(1),
    datagrams.JoinRefusal(1, "no"),
)
RECORD = CameraRecord(name="cam1", facts=FACTS)
FRAMES: tuple[Any, ...] = (
    wire.NodeStream(camera="cam1", instance=1),
    wire.CameraReport(leader=1, burst=1, plan=CameraPlan(camera=RECORD, instants=(0, 1))),
    wire.SpoolSpace(camera="cam1", free_bytes=0, spool="/"),
    wire.StatusRequest(),
    wire.BurstRequest(frames=1, at_leader_ns=2**70, name="../.."),
    orders.WatchRequest(),
    orders.DetailRequest(camera="cam1"),
    orders.SaveStamp(camera="cam1", stamp=EXACT_STAMPS),
    wire.NodeStream(camera="cam1", instance=1, shows=True),
    orders.CancelBurst(burst=10**9),
    orders.RemoveCamera(name="nobody"),
)


def mutated(value: Any, rng: random.Random) -> Any:
    """Return plain data with one of its values replaced."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        key = rng.choice([*value])
        return {**value, key: mutated(value[key], rng)}
    if isinstance(value, list) and value and rng.random() < 0.7:
        place = rng.randrange(len(value))
        return [*value[:place], mutated(value[place], rng), *value[place + 1 :]]
    return rng.choice(NASTY)


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Return bytes that are cut, changed, followed by deep nesting, or unchanged."""
    kind = rng.randrange(6)
    if kind == 0:
        return data[: rng.randrange(len(data) + 1)]
    if kind == 1 and data:
        place = rng.randrange(len(data))
        return data[:place] + rng.randbytes(1) + data[place + 1 :]
    if kind == 2:
        return data + b"\x91" * rng.randrange(1_000)
    return data


def hostile_datagram(rng: random.Random) -> bytes:
    """Return a datagram: noise, a time message, or a malformed control message."""
    kind = rng.randrange(8)
    if kind == 0:
        return rng.randbytes(rng.randrange(1_400))
    if kind == 1:
        return struct.pack(">2sBB", b"sS", 1, rng.randrange(4)) + rng.randbytes(rng.choice([0, 32, 31]))
    head = encode(datagrams.Goodbye(1))[:4]
    plain = mutated(msgspec.to_builtins(rng.choice(DATAGRAMS)), rng)
    with suppress(OverflowError, TypeError):
        return damaged(head + msgspec.msgpack.encode(plain), rng)
    return head


def hostile_frame(rng: random.Random) -> bytes:
    """Return the bytes of a malformed stream message."""
    plain = msgspec.to_builtins(rng.choice(FRAMES))
    if rng.random() < 0.8:
        plain = mutated(plain, rng)
    header = damaged(msgspec.json.encode(plain), rng)
    if rng.random() < 0.1:
        header = b'{"type":"camera-report","events":' + b"[" * rng.randrange(60_000)
    payload = rng.choice([0, 0, 0, 5, 2**40])
    return struct.pack(">4sIQ", b"SSH1", len(header), payload) + header + bytes(min(payload, 5))
