"""How often a client asks for the time."""

import pytest

from capture_app.sync.rig.poll_schedule import (
    EASING_PACES_NS,
    EASING_SAMPLES,
    FIRST_PACE_NS,
    FIRST_SAMPLES,
    PACE_NS,
)
from capture_app.sync.rig.terms import LeaderTerms
from capture_app.sync.rig.timekeeper import Timekeeper
from capture_app.sync.wire.codec import decode
from capture_app.sync.wire.messages import Terms, TimeReply, TimeRequest

S = 1_000_000_000
DELAY_NS = 1_000_000


def asked_ns(seconds: float, *, told_pace_ns: int = 0, lose_each: int = 0) -> list[int]:
    """Let a client ask a leader a millisecond away; return when its requests went out."""
    keeper = Timekeeper(7)
    told = Terms(leader=2, anchor_leader_ns=0, period_ns=33_333_333, pace_ns=told_pace_ns)
    terms = LeaderTerms.of_message(told)
    assert terms is not None
    keeper.follow(terms, 3, 0.25, 0)
    sent_ns: list[int] = []
    replies: list[tuple[int, TimeReply]] = []
    now_ns = 0
    while now_ns < seconds * S:
        if replies and replies[0][0] <= now_ns:
            assert keeper.take_reply(replies.pop(0)[1], now_ns)
        keeper.handle_timer(now_ns)
        data = keeper.request_to_send(now_ns)
        if data is not None:
            request = decode(data)
            assert isinstance(request, TimeRequest)
            sent_ns.append(now_ns)
            if not lose_each or len(sent_ns) % lose_each:
                t1_ns = now_ns + DELAY_NS + S
                reply = TimeReply(request.client, request.sequence, request.t0_ns, t1_ns, t1_ns)
                replies.append((now_ns + 2 * DELAY_NS, reply))
        now_ns = max(now_ns + 1, min([keeper.next_timer(), *(at_ns for at_ns, _ in replies)]))
    return sent_ns


def pace_at(sent_ns: list[int], from_s: float, to_s: float) -> float:
    """Mean time in ns between two requests that went out in this span of seconds."""
    within = [t for t in sent_ns if from_s * S <= t < to_s * S]
    return (within[-1] - within[0]) / (len(within) - 1)


@pytest.mark.parametrize("lose_each", [0, 10])
def test_it_asks_in_quick_succession_then_less_and_less_often(lose_each: int) -> None:
    sent_ns = asked_ns(12.0, lose_each=lose_each)
    more = lose_each / (lose_each - 1) if lose_each else 1.0
    begin_s = 0.0
    for pace_ns, count in (
        (FIRST_PACE_NS, FIRST_SAMPLES),
        *((pace_ns, EASING_SAMPLES) for pace_ns in EASING_PACES_NS),
    ):
        end_s = begin_s + count * pace_ns * more / S
        assert pace_at(sent_ns, begin_s + 0.1, end_s - 0.1) == pytest.approx(pace_ns, rel=0.03)
        begin_s = end_s
    assert pace_at(sent_ns, begin_s + 0.2, 12.0) == pytest.approx(PACE_NS, rel=0.03)


def test_a_leader_of_many_is_asked_no_more_often_than_it_says() -> None:
    sent_ns = asked_ns(12.0, told_pace_ns=100_000_000)
    synced_s = FIRST_SAMPLES * FIRST_PACE_NS / S
    assert pace_at(sent_ns, synced_s + 0.2, 12.0) == pytest.approx(100_000_000, rel=0.03)
