"""Beacons on the wire: round trips, what is refused, and nodes of before there were any."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_app.sync.wire.beacon import MOST_ARRIVALS, AgreedArrival, ArrivalReport, Beacon, Group
from capture_app.sync.wire.codec import MAGIC, MAX_DATAGRAM, VERSION, WireError, decode, encode
from capture_app.sync.wire.messages import ControlMessage, Terms, Welcome

u32 = st.integers(0, 2**32 - 1)
numbers = st.integers(1, 2**32 - 1)
i64 = st.integers(-(2**63), 2**63 - 1)
errors = st.integers(0, 10**18)
arrivals = st.lists(st.tuples(numbers, i64), max_size=MOST_ARRIVALS).map(tuple)
TERMS = Terms(leader=2, anchor_leader_ns=5, period_ns=33_333_333)
HEADER = MAGIC + bytes([VERSION, 3])


@given(
    st.builds(Beacon, u32, numbers)
    | st.builds(ArrivalReport, u32, errors, errors, arrivals)
    | st.builds(AgreedArrival, u32, numbers, i64, errors, errors)
)
def test_a_message_survives_the_wire(message: ControlMessage) -> None:
    data = encode(message)
    assert decode(data) == message
    assert len(data) <= MAX_DATAGRAM


def test_they_are_small() -> None:
    full = tuple((2**32 - 1 - k, 2**62 + k) for k in range(24))
    assert len(encode(Beacon(2**32 - 1, 2**32 - 1))) <= 45
    assert len(encode(ArrivalReport(2**32 - 1, 10**6, 10**7, full))) <= 450
    assert len(encode(AgreedArrival(2**32 - 1, 2**32 - 1, 2**62, 10**6, 10**6))) <= 120


def test_a_group_goes_with_the_welcome() -> None:
    welcome = Welcome(1, 3, 4, TERMS, beacons=Group("239.255.47.10", 47011))
    assert decode(encode(welcome)) == welcome


@pytest.mark.parametrize(
    ("host", "port"),
    [
        ("224.0.0.251", 47011),
        ("238.255.0.1", 47011),
        ("239.256.0.1", 47011),
        ("239.1.2", 47011),
        ("239.1.2.3.4", 47011),
        ("239.255.47.10 ", 47011),
        ("example.org", 47011),
        ("239.255.47.10", 53),
        ("239.255.47.10", 65536),
    ],
)
def test_nobody_is_made_to_join_a_group_of_the_wide_world(host: str, port: int) -> None:
    with pytest.raises(WireError, match="malformed"):
        decode(encode(Welcome(1, 3, 4, TERMS, beacons=Group(host, port))))


@pytest.mark.parametrize(
    "message",
    [
        Beacon(1, 0),
        Beacon(1, 2**32),
        ArrivalReport(1, -1, 0, ()),
        ArrivalReport(1, 0, 10**18 + 1, ()),
        ArrivalReport(1, 0, 0, ((0, 5),)),
        ArrivalReport(1, 0, 0, ((1, 2**63),)),
        ArrivalReport(1, 0, 0, ((1, 5),) * (MOST_ARRIVALS + 1)),
        AgreedArrival(1, 0, 0, 0, 0),
        AgreedArrival(1, 1, 2**63, 0, 0),
        AgreedArrival(1, 1, 0, 0, -1),
    ],
)
def test_values_that_cannot_be_are_refused(message: ControlMessage) -> None:
    with pytest.raises(WireError, match="malformed"):
        decode(encode(message))


@pytest.mark.parametrize("value", [float("nan"), 1.5, "5", None])
def test_times_are_whole_numbers(value: object) -> None:
    told = {
        "type": "agreed",
        "client": 1,
        "number": 1,
        "leader_ns": value,
        "uncertainty_ns": 0,
        "relative_uncertainty_ns": 0,
    }
    with pytest.raises(WireError, match="malformed"):
        decode(HEADER + msgspec.msgpack.encode(told))


class OldTerms(msgspec.Struct, array_like=True):
    leader: int
    anchor_leader_ns: int
    period_ns: int


class OldWelcome(msgspec.Struct, frozen=True, tag="welcome"):
    """A welcome as it was before beacons."""

    instance: int
    client: int
    transfer_port: int
    terms: OldTerms


def test_a_node_of_before_understands_a_leader_of_today() -> None:
    data = encode(Welcome(1, 3, 4, TERMS, beacons=Group("239.255.47.10", 47011)))
    old = msgspec.msgpack.decode(data[len(HEADER) :], type=OldWelcome)
    assert (old.client, old.terms.period_ns) == (3, 33_333_333)


def test_a_leader_of_before_is_one_without_beacons() -> None:
    data = HEADER + msgspec.msgpack.encode(OldWelcome(1, 3, 4, OldTerms(2, 5, 33_333_333)))
    welcome = decode(data)
    assert isinstance(welcome, Welcome)
    assert welcome.beacons is None
