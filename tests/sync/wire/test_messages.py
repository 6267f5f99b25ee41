"""The wire format: round trips, limits, and what comes from strangers."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_app.camera_facts import CameraFacts, PhaseControl, TimestampSource
from capture_app.sync.wire.codec import MAGIC, MAX_DATAGRAM, VERSION, Message, WireError, decode, encode
from capture_app.sync.wire.messages import (
    ControlMessage,
    Heartbeat,
    HeartbeatAck,
    Hello,
    JoinRefusal,
    NodeState,
    Report,
    Terms,
    TimeReply,
    TimeRequest,
    Trigger,
    TriggerAck,
    Welcome,
)
from tests.facts import make_facts

u32 = st.integers(0, 2**32 - 1)
i64 = st.integers(-(2**63), 2**63 - 1)
text = st.text(max_size=200)
names = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", fullmatch=True)
cameras = st.builds(
    CameraFacts,
    kind=text,
    model=text,
    width=u32,
    height=u32,
    period_ns=st.integers(1, 2**63 - 1),
    phase_control=st.sampled_from(PhaseControl),
    timestamp_source=st.sampled_from(TimestampSource),
    row_time_ns=st.none() | st.integers(0, 2**63 - 1),
)
floats = st.none() | st.floats(allow_nan=False)
reports = st.builds(
    Report, state=st.sampled_from(NodeState), message=text, offset_ns=st.none() | i64, skew_ppm=floats
)
terms = st.builds(Terms, leader=u32, anchor_leader_ns=i64, period_ns=i64)
control: st.SearchStrategy[ControlMessage] = st.one_of(
    st.builds(Welcome, u32, u32, u32, terms),
    st.builds(JoinRefusal, u32, text),
    st.builds(Heartbeat, u32, reports),
    st.builds(HeartbeatAck, u32, terms),
    st.builds(Trigger, u32, u32, u32, i64, i64, u32),
    st.builds(TriggerAck, u32, u32, u32, text),
)


@given(st.builds(TimeRequest, u32, u32, i64) | st.builds(TimeReply, u32, u32, i64, i64, i64) | control)
def test_a_message_survives_the_wire(message: Message) -> None:
    assert decode(encode(message)) == message


@given(name=names, instance=u32, camera=cameras)
def test_hello_survives_or_is_refused_whole(name: str, instance: int, camera: CameraFacts) -> None:
    hello = Hello(name, instance, camera)
    try:
        data = encode(hello)
    except WireError:
        return  # four long texts of wide characters do not fit a datagram
    assert len(data) <= MAX_DATAGRAM
    assert decode(data) == hello


def test_a_reply_is_no_larger_than_its_request() -> None:
    assert len(encode(TimeReply(1, 2, 3, 4, 5))) <= len(encode(TimeRequest(1, 2, 3)))


@given(st.binary(max_size=200))
def test_noise_is_refused(data: bytes) -> None:
    with pytest.raises(WireError):
        decode(data)


@given(st.binary(max_size=200), st.sampled_from([1, 2, 3, 4]))
def test_noise_behind_a_good_header_never_raises_anything_else(data: bytes, kind: int) -> None:
    with suppress(WireError):
        decode(MAGIC + bytes([VERSION, kind]) + data)


def test_another_version_is_named() -> None:
    data = bytearray(encode(TimeRequest(1, 2, 3)))
    data[2] = 9
    with pytest.raises(WireError, match="protocol version 9, this is version 1"):
        decode(bytes(data))


@pytest.mark.parametrize("name", ["../etc", "a/b", "", ".hidden", "a" * 65, "a\x00b"])
def test_a_name_that_could_leave_its_folder_is_refused(name: str) -> None:
    camera = make_facts(width=1, height=1, period_ns=1, timestamp_source=TimestampSource.UNKNOWN)
    with pytest.raises(WireError):
        decode(encode(Hello(name, 1, camera)))
