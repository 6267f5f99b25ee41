"""Thousands of cameras below relays whose leader is killed: a trigger's time, and what the root is asked.

In virtual time, on the paper's link, with the engine's own leaders, relays and memberships. The cameras send
heartbeats twice a second, ask their relay for the time as relays do, and confirm triggers, but have no
frames; their times are compared with the leader's at each burst. After all have joined, messages of the root
are counted for some seconds, a burst is ordered, and the leader of two that are ranked is killed; then
messages of the one that takes over are counted by the half second, and a burst is ordered again. With
`--relays 0` all are nodes of one leader, and keep the time as a camera's node does.
"""

import random
import sys
from argparse import Namespace
from collections import Counter
from math import isqrt
from time import process_time
from typing import Any

from benchmarks.report import new_parser, print_report, print_table, talk
from benchmarks.simulated.clock_tree import OnceASecond, Tree, TreeSpec
from benchmarks.simulated.ranked_leaders import Machine, add_leaders
from capture_app.common.camera_facts import SIMULATED, CameraFacts, PhaseControl, TimestampSource
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.rig.client import CLOCK_TOLERANCE_NS
from capture_app.sync.rig.events import BurstAnswered
from capture_app.sync.rig.failover import LeaderChoice
from capture_app.sync.rig.leader_engine import LeaderConfig
from capture_app.sync.rig.time_client import TimeClient
from capture_app.sync.sync_engine import Address
from capture_app.sync.timekeeping.poll_schedule import AccuracyTarget, SteadySchedule, TreeSchedule
from capture_app.sync.timekeeping.timekeeper import Timekeeper
from capture_app.sync.tree.member import TreeMember
from capture_app.sync.tree.relay_engine import OF_CAMERAS, Relay
from capture_app.sync.wire.datagrams import Trigger, TriggerAck

S = 1_000_000_000
MEMBERS = 1000
SETTLE_S, COUNT_S, AFTER_S = 25.0, 5.0, 9.0
BIN_S = 0.5
FLAT_FROM_S = 5.0
CAMERA = CameraFacts(
    kind=SIMULATED,
    model="none",
    width=0,
    height=0,
    period_ns=33_333_333,
    phase_control=PhaseControl.NONE,
    timestamp_source=TimestampSource.UNKNOWN,
)


class Member:
    """A camera's node without its frames: membership, clock, and an answer to each trigger."""

    def __init__(
        self,
        name: str,
        rng: random.Random,
        leaders: tuple[Address, ...],
        tree: Tree,
        schedule: SteadySchedule | None = None,
    ) -> None:
        keeper = Timekeeper(rng.getrandbits(32), schedule, target=AccuracyTarget(CLOCK_TOLERANCE_NS))
        self.time = TimeClient(name, rng.getrandbits(32), keeper, CAMERA)
        self.choice = LeaderChoice(leaders, self.time)
        self.next_timer = self.time.next_timer
        self.triggered_ns: dict[int, int] = {}
        """True times at which the first trigger of each burst arrived, by the instance of its leader."""
        self.clock = tree.add(name, self, rng, leaders)
        self._tree = tree

    def receive_datagram(self, data: bytes, address: Address, now_ns: int) -> None:
        """Process one datagram."""
        message = self.time.decode(data) if address == self.choice.leader else None
        if message is None:
            return
        self.time.receive_message(message, now_ns)
        self.choice.update(now_ns)
        root = None if self.time.followed is None else self.time.followed.path[0]
        if isinstance(message, Trigger) and self.time.is_addressed(message) and message.leader == root:
            self.triggered_ns.setdefault(message.leader, self._tree.now_true_ns)
            self.time.send(TriggerAck(message.client, message.leader, message.burst))

    def handle_timer(self, now_ns: int) -> None:
        """Run the timers that are due."""
        self.time.handle_timer(now_ns)
        self.choice.update(now_ns)

    def datagrams_to_send(self, now_ns: int) -> list[tuple[bytes, Address]]:
        """Return the datagrams that are due, stamped with `now_ns`."""
        return [(data, self.choice.leader) for data in self.time.datagrams_to_send(now_ns)]


class BigRig:
    """Two ranked leaders, relays, and members below them."""

    def __init__(self, members: int, relays: int, seed: int, below: type[SteadySchedule]) -> None:
        """Build the rig; members ask their relays for the time by the schedule `below`."""
        self.tree = Tree(TreeSpec(0, 0), seed=seed)
        self.machines = add_leaders(self.tree, "ab")
        leaders = tuple((name, 0) for name in self.machines)
        self.relays, self.members = [], []
        for i in range(relays):
            rng = random.Random(f"{seed} relay{i}")
            member = TreeMember(f"relay{i}", rng.getrandbits(32), leaders, rng, OF_CAMERAS)
            relay = Relay(member, LeaderConfig(0, 0, exchanges_per_s=max(1.0, members / relays)), rng)
            self.relays.append(relay)
            self.tree.add(f"relay{i}", relay, rng, leaders, member)
        for i in range(members):
            rng = random.Random(f"{seed} cam{i}")
            above = ((f"relay{i % relays}", 0),) if relays else leaders
            self.members.append(Member(f"cam{i}", rng, above, self.tree, below() if relays else None))

    @property
    def now_s(self) -> float:
        """Return the true time in s."""
        return self.tree.now_true_ns / 1e9

    def run(self, seconds: float) -> None:
        """Advance the simulation."""
        self.tree.run_until(self.tree.now_true_ns + round(seconds * S))

    def have_leader(self, name: str) -> bool:
        """Return whether all relays follow that machine; without relays, all members."""
        choices = [(r.member.time, r.member.parent) for r in self.relays] or [
            (m.time, m.choice.leader) for m in self.members
        ]
        return all(time.is_member and parent == (name, 0) for time, parent in choices)

    def is_complete(self, name: str) -> bool:
        """Return whether the leader on that machine knows all members as present."""
        leader = self.machines[name].leader
        return leader is not None and len(leader.roster.cameras()) == len(self.members)

    def until(self, done: str, name: str, limit_s: float = 30.0) -> float:
        """Advance until the named condition holds for a machine; return the elapsed time in s."""
        began_s = self.now_s
        while not getattr(self, done)(name):
            if self.now_s - began_s > limit_s:
                return float("inf")
            self.run(0.05)
        return self.now_s - began_s

    def datagrams(self) -> int:
        """Return the number of datagrams that the leaders have received and sent."""
        return sum(self.tree.nodes[name, 0].datagrams for name in self.machines)

    def errors_us(self, machine: Machine) -> list[float]:
        """Return the members' time errors against that leader, in us, in ascending order."""
        true_ns = self.tree.now_true_ns
        leader_ns = machine.leader_ns(machine.clock.local_from_true(true_ns))
        maps = [(m.time.time_map, m.clock.local_from_true(true_ns)) for m in self.members]
        return sorted(abs(m.leader_from_local(local) - leader_ns) / 1e3 for m, local in maps if m is not None)

    def order(self, name: str) -> dict[str, Any]:
        """Order a burst; measure when all members have received it, and when the leader knows that."""
        machine = self.machines[name]
        assert machine.leader is not None
        for _ in iter(machine.leader.next_event, None):
            pass
        errors_us = self.errors_us(machine)
        before, before_kinds = self.datagrams(), Counter(machine.received)
        began_ns, began_s = self.tree.now_true_ns, process_time()
        now_ns = machine.leader_ns(machine.clock.local_from_true(began_ns))
        burst = machine.leader.trigger(now_ns, BurstOrder(frames=3))
        self.tree.act(name)
        answered: set[str] = set()
        while len(answered) < len(burst.clients) and self.tree.now_true_ns < began_ns + 6 * S:
            self.run(0.005)
            for event in iter(machine.leader.next_event, None):
                if isinstance(event, BurstAnswered) and not event.refusal:
                    answered.add(event.name)
        run = machine.leader.config.instance
        heard_ns = sorted(m.triggered_ns[run] - began_ns for m in self.members if run in m.triggered_ns)
        kinds = machine.received - before_kinds
        return {
            "cameras": len(burst.clients),
            "heard": len(heard_ns),
            "answered": len(answered),
            "error_us": {"median": errors_us[len(errors_us) // 2], "largest": errors_us[-1]},
            "heard_ms": {"median": heard_ns[len(heard_ns) // 2] / 1e6, "all": heard_ns[-1] / 1e6},
            "all_acknowledged_ms": (self.tree.now_true_ns - began_ns) / 1e6,
            "root_messages": self.datagrams() - before,
            "acknowledgements": kinds["TriggerAck"],
            "simulated_in_s": process_time() - began_s,
        }

    def count(self, machine: Machine, seconds: float) -> dict[str, float]:
        """Return the messages per second that a leader receives, by kind, and its totals both ways."""
        before, kinds = self.datagrams(), Counter(machine.received)
        self.run(seconds)
        rates = {kind: count / seconds for kind, count in (machine.received - kinds).items()}
        return {"all": (self.datagrams() - before) / seconds, **rates}


def measure(
    members: int, relays: int, seed: int, below: type[SteadySchedule] = TreeSchedule
) -> dict[str, Any]:
    """Let all members join, count, order a burst, kill the leader, and count and order again."""
    began_s, rig = process_time(), BigRig(members, relays, seed, below)
    first, second = rig.machines.values()
    joined_s = rig.until("is_complete", "a", 60.0)
    rig.run(max(0.0, SETTLE_S - rig.now_s))
    talk(f"{members} members joined after {joined_s:.1f} s ({process_time() - began_s:.0f} s of processor)")
    steady = rig.count(first, COUNT_S)
    trigger = rig.order("a")
    rig.tree.kill("a")
    first.leader = None
    killed_s, bins, back = rig.now_s, [], {}
    while rig.now_s < killed_s + AFTER_S:
        before, kinds, bin_end_s = rig.datagrams(), Counter(second.received), rig.now_s + BIN_S
        while rig.now_s < bin_end_s - 1e-6:
            rig.run(0.05)
            for what in ("have_leader", "is_complete"):
                if what not in back and getattr(rig, what)("b"):
                    back[what] = rig.now_s - killed_s
        rates = {kind: n / BIN_S for kind, n in (second.received - kinds).items()}
        bins.append({"until_s": rig.now_s - killed_s, "all": (rig.datagrams() - before) / BIN_S, **rates})
    late = [one["all"] for one in bins if one["until_s"] > FLAT_FROM_S]
    return {
        "kind": "simulated",
        "seed": seed,
        "members": members,
        "relays": relays,
        "joined_s": joined_s,
        "root_messages_per_s": steady,
        "trigger": trigger,
        "all_have_a_leader_s": back.get("have_leader", float("inf")),
        "leader_knows_all_s": back.get("is_complete", float("inf")),
        "from_5_s_on": {"least": min(late), "most": max(late)},
        "half_seconds": bins,
        "trigger_after": rig.order("b"),
        "processor_s": process_time() - began_s,
    }


def _print(report: dict[str, Any]) -> None:
    late = report["from_5_s_on"]
    rows = [
        ("members, relays", f"{report['members']}, {report['relays']}"),
        ("root, messages/s", _rates(report["root_messages_per_s"])),
        ("all have a leader after, s", f"{report['all_have_a_leader_s']:.2f}"),
        ("it knows all after, s", f"{report['leader_knows_all_s']:.2f}"),
        ("root from 5 s on, messages/s", f"{late['least']:.0f} to {late['most']:.0f}"),
        ("processor, s", f"{report['processor_s']:.0f}"),
    ]
    print_table(("figure", "value"), rows)
    print_table(
        (
            "trigger",
            "answered",
            "half heard, ms",
            "all",
            "all acknowledged",
            "root's messages",
            "clocks off by, us",
            "at most",
        ),
        [
            (
                when,
                str(one["answered"]),
                f"{one['heard_ms']['median']:.1f}",
                f"{one['heard_ms']['all']:.1f}",
                f"{one['all_acknowledged_ms']:.0f}",
                str(one["root_messages"]),
                f"{one['error_us']['median']:.0f}",
                f"{one['error_us']['largest']:.0f}",
            )
            for when, one in (("before", report["trigger"]), ("after", report["trigger_after"]))
        ],
    )
    bins = [(f"{one['until_s']:.1f}", _rates(one)) for one in report["half_seconds"]]
    print_table(("s after the kill", "messages/s"), bins)


def _rates(rates: dict[str, float]) -> str:
    kinds = sorted((k for k in rates if k not in ("all", "until_s")), key=lambda k: -rates[k])
    return f"{rates['all']:.0f}: " + ", ".join(f"{kind} {rates[kind]:.0f}" for kind in kinds)


def main() -> int:
    """Run it; return 0 if all members answered every burst and all had a leader again."""
    parser = new_parser(__doc__, seed_of="links and clocks")
    parser.add_argument("--members", type=int, default=MEMBERS, help=f"cameras ({MEMBERS})")
    parser.add_argument("--relays", type=int, help="relays below the leader (the root of that)")
    parser.add_argument(
        "--sparing",
        action="store_true",
        help="members ask once a second from the start: for tens of thousands",
    )
    options: Namespace = parser.parse_args()
    relays = isqrt(options.members) if options.relays is None else options.relays
    report = measure(options.members, relays, options.seed, OnceASecond if options.sparing else TreeSchedule)
    print_report(report, _print, as_json=options.json)
    whole = all(one["answered"] == options.members for one in (report["trigger"], report["trigger_after"]))
    return 0 if whole and report["leader_knows_all_s"] < AFTER_S else 1


if __name__ == "__main__":
    sys.exit(main())
