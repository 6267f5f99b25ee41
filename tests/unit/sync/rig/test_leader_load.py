"""A leader that has too much to do asks its clients for less, and for more when it has room again."""

import random

from capture_app.sync.rig.leader_engine import Leader, LeaderConfig
from capture_app.sync.rig.rig_config import RequestedConfig
from capture_app.sync.wire.codec import decode, encode, request_at, request_before_t0
from capture_app.sync.wire.datagrams import CLOCK, Hello, Welcome

MS, S = 1_000_000, 1_000_000_000
CLIENTS = 100


def leader_of_many() -> tuple[Leader, int]:
    leader = Leader(LeaderConfig(1, 0, RequestedConfig(period_ns=33_333_333)), random.Random(1))
    for i in range(CLIENTS):
        leader.receive_datagram(encode(Hello(f"n{i}", i + 1, CLOCK)), ("n", i), 0)
    welcome = decode(leader.datagrams_to_send(0)[0][0])
    assert isinstance(welcome, Welcome)
    return leader, welcome.client


def ask(leader: Leader, client: int, from_ns: int, *, waits_ns: int) -> int:
    """Ask for five seconds, each request being answered so late; return when that is over."""
    for sequence in range(1000):
        now_ns = from_ns + sequence * 5 * MS
        leader.receive_datagram(request_at(request_before_t0(client, sequence), now_ns), ("n", 0), now_ns)
        leader.datagrams_to_send(now_ns + waits_ns)
    return from_ns + 5 * S


def test_the_request_rate_follows_the_queueing_delay() -> None:
    leader, client = leader_of_many()
    free_ns = leader.poll_interval_ns
    assert free_ns == CLIENTS * S // 20_000
    at_ns = ask(leader, client, S, waits_ns=MS // 10)
    assert leader.poll_interval_ns == free_ns
    at_ns = ask(leader, client, at_ns, waits_ns=10 * MS)
    assert leader.poll_interval_ns > 10 * free_ns
    ask(leader, client, ask(leader, client, ask(leader, client, at_ns, waits_ns=0), waits_ns=0), waits_ns=0)
    ask(leader, client, at_ns + 15 * S, waits_ns=0)
    assert leader.poll_interval_ns == free_ns
