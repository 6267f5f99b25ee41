"""A seal: what was sealed is opened once; what was changed, made up, sent back or came before is refused."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from capture_app.sync.wire.codec import MAX_DATAGRAM, WireError, decode, encode
from capture_app.sync.wire.datagrams import TimeRequest
from capture_app.trust.sealing import (
    KEY_BYTES,
    OVERHEAD_BYTES,
    WINDOW,
    Refused,
    ReplayWindow,
    Seal,
    SealError,
    key_of,
    unknown_key,
    unknown_key_of,
)

KEY = bytes(range(KEY_BYTES))


def client(key: bytes = KEY, key_id: int = 7) -> Seal:
    return Seal(key_id, key, of_leader=False)


def leader(key: bytes = KEY, key_id: int = 7) -> Seal:
    return Seal(key_id, key, of_leader=True)


def why_refused(seal: Seal, data: bytes) -> Refused:
    with pytest.raises(SealError) as refused:
        seal.open(data)
    return refused.value.why


@given(st.lists(st.binary(max_size=MAX_DATAGRAM), max_size=5))
def test_what_was_sealed_is_opened_in_both_directions(messages: list[bytes]) -> None:
    one, other = client(), leader()
    for message in messages:
        data = one.seal(message)
        assert key_of(data) == 7
        assert len(data) == len(message) + OVERHEAD_BYTES
        assert other.open(data) == message
        assert one.open(other.seal(message)) == message


def test_a_seal_fits_the_smallest_ipv6_link() -> None:
    ipv6_and_udp = 48
    assert MAX_DATAGRAM + OVERHEAD_BYTES + ipv6_and_udp <= 1280


def test_every_changed_bit_is_noticed() -> None:
    data = client().seal(encode(TimeRequest(1, 2, 3)))
    end = leader()
    for place in range(8 * len(data)):
        changed = bytearray(data)
        changed[place // 8] ^= 1 << place % 8
        assert why_refused(end, bytes(changed)) is not Refused.REPLAYED
    assert end.open(data) == encode(TimeRequest(1, 2, 3))


def test_every_cut_and_every_longer_datagram_is_noticed() -> None:
    data = client().seal(b"message")
    end = leader()
    for size in range(len(data)):
        assert why_refused(end, data[:size]) in (Refused.UNSEALED, Refused.FORGED)
    assert why_refused(end, data + b"\0") is Refused.FORGED


def test_other_keys_and_other_sides_forge() -> None:
    other = bytes(reversed(KEY))
    assert why_refused(leader(), client(other).seal(b"m")) is Refused.FORGED
    assert why_refused(leader(), client(KEY, 8).seal(b"m")) is Refused.UNKNOWN_KEY
    # What somebody on the way sends back.
    assert why_refused(leader(), leader().seal(b"m")) is Refused.FORGED


@given(st.binary(max_size=200))
def test_noise_is_refused(data: bytes) -> None:
    assert why_refused(leader(), data) is Refused.UNSEALED


def test_a_datagram_counts_once() -> None:
    one, other = client(), leader()
    data = one.seal(b"first")
    other.open(data)
    assert why_refused(other, data) is Refused.REPLAYED
    assert other.open(one.seal(b"second")) == b"second"
    assert why_refused(other, data) is Refused.REPLAYED


def test_datagrams_that_overtake_each_other_are_taken_within_the_window() -> None:
    one, other = client(), leader()
    sent = [one.seal(bytes([number % 256])) for number in range(WINDOW)]
    order = random.Random(1).sample(range(WINDOW), WINDOW)
    assert [other.open(sent[number])[0] for number in order] == [number % 256 for number in order]
    assert {why_refused(other, data) for data in sent} == {Refused.REPLAYED}


def test_a_datagram_that_was_held_back_for_long_is_refused() -> None:
    one, other = client(), leader()
    held = [one.seal(b"held"), one.seal(b"held")]
    for _ in range(WINDOW - 1):
        other.open(one.seal(b"younger"))
    assert other.open(held[1]) == b"held"
    assert why_refused(other, held[0]) is Refused.REPLAYED


def test_a_forged_number_does_not_move_the_window() -> None:
    one, other = client(), leader()
    data = bytearray(one.seal(b"first"))
    data[8:16] = b"\xff" * 8
    assert why_refused(other, bytes(data)) is Refused.FORGED
    assert other.open(one.seal(b"second")) == b"second"


@given(st.lists(st.integers(1, 2**64 - 1) | st.integers(1, 3 * WINDOW), max_size=60))
def test_the_window_takes_no_number_twice(numbers: list[int]) -> None:
    window, taken = ReplayWindow(), set()
    for number in numbers:
        if window.is_new(number):
            assert number not in taken
            window.add(number)
            taken.add(number)
        else:
            assert number in taken or number <= max(taken) - WINDOW


def test_a_key_of_another_length_is_no_key() -> None:
    with pytest.raises(ValueError, match="31 bytes"):
        client(KEY[1:])


def test_an_unknown_key_is_told_in_fewer_bytes_and_only_for_what_was_sent() -> None:
    one = client()
    data = one.seal(b"")
    notice = unknown_key(data)
    assert len(notice) < len(data)
    assert unknown_key_of(notice) == 7
    assert one.has_sent(notice)
    assert not client().has_sent(notice)
    for other in (data, data[: len(notice)], notice + b"0", notice[:-1]):
        assert unknown_key_of(other) is None
    assert why_refused(one, notice) is Refused.UNSEALED


def test_a_notice_about_a_datagram_of_long_ago_is_not_believed() -> None:
    one = client()
    old = unknown_key(one.seal(b""))
    for _ in range(WINDOW - 1):
        one.seal(b"")
    assert one.has_sent(old)
    one.seal(b"")
    assert not one.has_sent(old)


def test_an_end_without_seals_takes_nothing_sealed() -> None:
    one = client()
    data = one.seal(encode(TimeRequest(1, 2, 3)))
    for datagram in (data, unknown_key(data)):
        with pytest.raises(WireError):
            decode(datagram)
