"""The wire format: round trips, limits, what comes from strangers."""

from contextlib import suppress

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs

from capture_app.common.bounds import CENTURY_NS
from capture_app.common.camera_facts import (
    CameraFacts,
    PhaseControl,
    StampAccuracy,
    StampSource,
    TimestampSource,
)
from capture_app.common.node_state import NodeState
from capture_app.sync.wire.codec import MAGIC, MAX_DATAGRAM, VERSION, Message, WireError, decode, encode
from capture_app.sync.wire.datagrams import (
    MAX_OTHERS,
    ControlMessage,
    Goodbye,
    Heartbeat,
    HeartbeatAck,
    Hello,
    JoinRefusal,
    MemberReports,
    Notice,
    Report,
    RigConfigMessage,
    TimeReply,
    TimeRequest,
    Trigger,
    TriggerAck,
    Welcome,
)
from tests.facts import make_facts

u32 = st.integers(0, 2**32 - 1)
i64 = st.integers(-(2**63), 2**63 - 1)
times = st.integers(-CENTURY_NS, CENTURY_NS)
ports = st.integers(0, 65535)
positive = st.integers(1, 10**18)
text = st.text(st.characters(exclude_categories=("C", "Z")), max_size=200)
names = st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", fullmatch=True)
cameras = st.builds(
    CameraFacts,
    kind=text,
    model=text,
    width=st.integers(0, 1 << 20),
    height=st.integers(0, 1 << 20),
    period_ns=positive,
    phase_control=st.sampled_from(PhaseControl),
    timestamp_source=st.sampled_from(TimestampSource),
    row_time_ns=st.none() | st.integers(0, 10**9),
)
floats = st.none() | st.floats(-1e6, 1e6)
reports = st.builds(
    Report, state=st.sampled_from(NodeState), message=text, offset_ns=st.none() | times, skew_ppm=floats
)
config = st.builds(RigConfigMessage, leader=u32, anchor_leader_ns=times, period_ns=positive)
others = st.lists(st.integers(0, 2**32 - 1), max_size=MAX_OTHERS).map(tuple)
control: st.SearchStrategy[ControlMessage] = st.one_of(
    st.builds(Welcome, u32, u32, ports, config),
    st.builds(JoinRefusal, u32, text),
    st.builds(Heartbeat, u32, reports),
    st.builds(MemberReports, st.lists(st.tuples(u32, reports), max_size=1).map(tuple)),
    st.builds(HeartbeatAck, u32, config),
    st.builds(Trigger, u32, u32, u32, times, positive, u32, others=others),
    st.builds(TriggerAck, u32, u32, u32, others=others),
    st.builds(TriggerAck, u32, u32, u32, text),
    st.builds(Notice, u32, text),
)
CONFIG = RigConfigMessage(leader=2, anchor_leader_ns=5, period_ns=33_333_333)
HEADER = MAGIC + bytes([VERSION, 3])


@settings(max_examples=200)
@given(st.builds(TimeRequest, u32, u32, i64) | st.builds(TimeReply, u32, u32, i64, i64, i64) | control)
def test_a_message_survives_the_wire(message: Message) -> None:
    data = encode(message)
    assert decode(data) == message
    assert len(data) <= MAX_DATAGRAM


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
    with pytest.raises(WireError, match=f"protocol version 9, this is version {VERSION}"):
        decode(bytes(data))


@pytest.mark.parametrize("name", ["../etc", "a/b", "", ".hidden", "a" * 65, "a\x00b"])
def test_a_name_that_could_leave_its_folder_is_refused(name: str) -> None:
    camera = make_facts(width=1, height=1, period_ns=1, timestamp_source=TimestampSource.UNKNOWN)
    with pytest.raises(WireError):
        decode(encode(Hello(name, 1, camera)))


@pytest.mark.parametrize("slot", [-0.1, 1.0, "5", None])
def test_values_that_cannot_be_are_refused(slot: object) -> None:
    welcome = msgspec.to_builtins(Welcome(1, 3, 4, CONFIG, slot=0.5))
    assert decode(HEADER + msgspec.msgpack.encode(welcome)) == Welcome(1, 3, 4, CONFIG, slot=0.5)
    with pytest.raises(WireError, match="malformed"):
        decode(HEADER + msgspec.msgpack.encode(welcome | {"slot": slot}))


CLEAR_SCREEN = "\x1b[2J\x1b]0;owned\x07\u009b31m"


def test_no_text_of_a_datagram_steers_a_terminal() -> None:
    stamp = StampAccuracy(bias_ns=0, uncertainty_ns=1, source=StampSource.MOTION, against=CLEAR_SCREEN)
    facts = structs.replace(
        make_facts(), kind=CLEAR_SCREEN, model=CLEAR_SCREEN, pixel_format="\r\n", stamp=stamp
    )
    shown = Report(state=NodeState.READY, message=f"fine {CLEAR_SCREEN}")
    told: list[Hello | Heartbeat | MemberReports | JoinRefusal | TriggerAck] = [
        Hello("cam", 1, facts),
        Heartbeat(1, shown),
        MemberReports(((7, shown),)),
        JoinRefusal(1, CLEAR_SCREEN),
        TriggerAck(1, 2, 3, CLEAR_SCREEN),
    ]
    hello, heartbeat, sums, refusal, ack = (decode(encode(message)) for message in told)
    assert isinstance(hello, Hello)
    assert isinstance(heartbeat, Heartbeat)
    assert isinstance(sums, MemberReports)
    assert isinstance(refusal, JoinRefusal)
    assert isinstance(ack, TriggerAck)
    assert hello.camera.stamp is not None
    texts = (hello.camera.kind, hello.camera.model, hello.camera.pixel_format, hello.camera.stamp.against)
    for text in (*texts, heartbeat.report.message, sums.reports[0][1].message, refusal.reason, ack.refusal):
        assert text.isprintable()
    assert heartbeat.report.message.startswith("fine ")
    assert hello.camera.width == facts.width
    usual = Heartbeat(1, Report(state=NodeState.READY, message="±12 µs – schön"))
    assert decode(encode(usual)) == usual


@pytest.mark.parametrize("nesting", [b"\x91", b"\x81\xa1x", b"\xdd\x00\x00\x00\x01"])
def test_nested_messages_are_malformed_and_no_error_of_python(nesting: bytes) -> None:
    header = encode(Goodbye(1))[:4]
    for begin in (b"", b"\x82\xa4type\xa7goodbye\xa1y"):
        deep = header + begin + nesting * (1_200 // len(nesting))
        with pytest.raises(WireError, match="malformed"):
            decode(deep)
