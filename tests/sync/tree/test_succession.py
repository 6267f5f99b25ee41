"""Ranked leaders in virtual time: killed, back again, split and healed; time and bursts go on."""

import random
from collections.abc import Callable, Iterator
from functools import cache

import pytest

from benchmarks.simulated.clock_tree import Tree, TreeSpec
from benchmarks.simulated.ranked_leaders import Machine, add_leaders
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.rig.client import Client, ClientConfig
from capture_app.sync.rig.failover import MIN_ANSWERS
from capture_app.sync.rig.frame_selection import Burst
from capture_app.sync.rig.leader_engine import LeaderConfig
from capture_app.sync.sync_engine import Address
from capture_app.sync.tree.member import TreeMember
from capture_app.sync.tree.relay_engine import OF_CAMERAS, Relay
from tests.sync.tree.relay_rig import CAMERA, Camera, copy_of

S = 1_000_000_000
PROBED_S = MIN_ANSWERS + 2.0
"""Longer than nodes, which probe each second here, probe a better leader before they go back to it."""


class StandbyRig:
    """Ranked leaders and cameras that list all of them and probe each second, on the paper's link."""

    def __init__(self, leaders: str = "ab", cameras: int = 3, seed: int = 1) -> None:
        self.tree = Tree(TreeSpec(clients=0, relays=0, join_within_s=0.0, wander_ppm=0.1), seed=seed)
        self.addresses = tuple((name, 0) for name in leaders)
        self.machines = add_leaders(self.tree, leaders)
        self.cameras = {f"cam{i}": self.camera(f"cam{i}", self.addresses) for i in range(cameras)}

    def start(self, name: str) -> None:
        """Start a machine again as another run."""
        before = self.machines[name]
        machine = self.machines[name] = Machine(name, before.others, before.rank, before.run + 1)
        machine.clock = before.clock
        self.tree.nodes[name, 0].engine = machine
        self.tree.revive(name)

    def camera(self, name: str, leaders: tuple[Address, ...]) -> Camera:
        rng = random.Random(name)
        client: Client[int] = Client(ClientConfig(name, rng.getrandbits(32), CAMERA, 300_000, 90), rng)
        camera = Camera(client, leaders, probe_every_ns=S)
        camera.clock = self.tree.add(name, camera, rng, leaders)
        return camera

    def kill(self, name: str) -> None:
        self.tree.kill(name)
        self.machines[name].leader = None

    def freeze(self, name: str) -> None:
        """Halt a machine, like a stopped process whose sockets fill."""
        node = self.tree.nodes[name, 0]
        node.alive, node.queued = False, []

    def split(self, *pairs: str) -> None:
        """Let nothing pass between the machines of each pair, as `ab`; none heals all."""
        for machine in self.machines.values():
            machine.deaf_to = {p.replace(machine.name, "") for p in pairs if machine.name in p}

    def leading(self) -> str:
        """Names of all that lead."""
        return "".join(name for name, one in self.machines.items() if one.leader is not None)

    def followed(self, camera: Camera) -> str:
        """The machine that a camera follows; empty where it follows none that is alive."""
        name = camera.failover.leader[0]
        alive = self.machines[name].leader is not None
        return name if camera.client.is_member and alive else ""

    def all_follow(self, name: str) -> bool:
        return self.leading() == name and all(self.followed(c) == name for c in self.cameras.values())

    def all_ready(self) -> bool:
        return all(camera.client.state == "ready" for camera in self.cameras.values())

    def steps(self, seconds: float) -> Iterator[float]:
        began_ns = self.tree.now_true_ns
        for _ in range(round(seconds * 20)):
            self.tree.run_until(self.tree.now_true_ns + S // 20)
            yield (self.tree.now_true_ns - began_ns) / S

    def until(self, condition: Callable[[], bool], limit_s: float = 60.0) -> float:
        for seconds in self.steps(limit_s):
            self.check_time()
            if condition():
                return seconds
        raise AssertionError((self.leading(), {n: self.followed(c) for n, c in self.cameras.items()}))

    def check_time(self) -> None:
        """Every camera's time is its leader's, as far as its hard bound says."""
        for camera in self.cameras.values():
            time_map, name = camera.client.time_map, self.followed(camera)
            if time_map is not None and name:
                error_ns, local_ns = self.error(camera, name)
                assert abs(error_ns) <= time_map.hard_bound_at(local_ns)

    def error(self, camera: Camera, name: str) -> tuple[int, int]:
        machine, now_ns = self.machines[name], self.tree.now_true_ns
        local_ns, time_map = camera.clock.local_from_true(now_ns), camera.client.time_map
        assert time_map is not None
        leader_ns = machine.leader_ns(machine.clock.local_from_true(now_ns))
        return time_map.leader_from_local(local_ns) - leader_ns, local_ns

    def order(self, name: str) -> Burst:
        machine = self.machines[name]
        assert machine.leader is not None
        now_ns = machine.leader_ns(machine.clock.local_from_true(self.tree.now_true_ns))
        burst = machine.leader.trigger(now_ns, BurstOrder(frames=3))
        self.tree.act(name)
        return burst

    def check_burst(self, name: str) -> None:
        """Order a burst now, and hold what all cameras picked against the leader's time."""
        burst, machine = self.order(name), self.machines[name]
        assert set(burst.clients) == set(self.cameras)
        assert machine.leader is not None
        for _ in self.steps(2.0):
            pass
        within = 0
        for camera in self.cameras.values():
            ready = camera.ready[-1]
            assert (ready.trigger.leader, ready.trigger.burst) == (
                machine.leader.config.instance,
                burst.number,
            )
            assert len(ready.frames) == 3
            for pick in ready.frames:
                at_ns = machine.leader_ns(
                    machine.clock.local_from_true(camera.clock.true_from_local(pick.frame))
                )
                assert abs(pick.leader_ns - at_ns) <= pick.hard_bound_ns
                within += abs(pick.leader_ns - at_ns) <= pick.uncertainty_ns
        assert within >= 0.75 * 3 * len(self.cameras)


def ready_rig(leaders: str = "ab", *, cameras: int = 2, seed: int = 1) -> StandbyRig:
    """A rig that its first leader has led until all are ready."""
    return copy_of(run_until_ready(leaders, cameras, seed))


@cache
def run_until_ready(leaders: str, cameras: int, seed: int) -> StandbyRig:
    """The same one for all tests, which copy it."""
    rig = StandbyRig(leaders, cameras, seed)
    rig.until(lambda: rig.all_ready() and rig.leading() == leaders[0])
    rig.until(lambda: all(rig.machines[n].succession.leader == (leaders[0], 0) for n in leaders[1:]))
    for _ in rig.steps(10.0):
        pass
    return rig


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 2))])
def test_the_next_standby_leads_without_a_time_step_when_the_leader_is_lost(seed: int) -> None:
    rig = ready_rig(seed=seed)
    first, second = rig.machines["a"], rig.machines["b"]
    grid = first.leader.grid if first.leader is not None else None
    rig.kill("a")
    assert rig.until(lambda: rig.all_follow("b")) < 2.0
    continued = second.succession.continued
    assert continued is not None
    # The same time, as far as the one that goes on with it says; and the same instants.
    now_ns = rig.tree.now_true_ns
    local_ns = second.clock.local_from_true(now_ns)
    jump_ns = second.leader_ns(local_ns) - first.clock.local_from_true(now_ns)
    assert abs(jump_ns) <= continued.time_map.hard_bound_at(local_ns)
    assert abs(jump_ns) < 300_000
    assert second.leader is not None
    assert continued.grid == grid
    # These cameras cannot be moved: a leader follows what they drift.
    assert second.leader.grid is not None
    assert abs(continued.grid.phase_error(second.leader.grid.anchor_leader_ns)) < 300_000
    cameras = [camera.client for camera in rig.cameras.values()]
    ready_s = rig.until(lambda: any(client.state == "ready" for client in cameras))
    assert ready_s <= 0.1, "ten answers: the time that it knows goes on, and is accurate enough"
    assert rig.until(rig.all_ready) < 1.0
    rig.check_burst("b")


def test_a_standby_that_leads_beside_the_leader_takes_no_camera_and_no_burst() -> None:
    """Its program is changed: it leads from the first moment, whatever its rank and whoever leads."""
    rig = ready_rig()
    liar = rig.machines["b"].succession
    liar._look = lambda now_ns: setattr(liar, "leads", True)  # type: ignore[method-assign]
    for _ in rig.steps(PROBED_S):
        assert all(rig.followed(camera) == "a" for camera in rig.cameras.values())
        rig.check_time()
    assert rig.leading() == "ab"
    rig.check_burst("a")


def test_one_that_stops_in_order_sends_all_on_at_once() -> None:
    rig = ready_rig()
    rig.machines["a"].leave()
    rig.tree.act("a")
    rig.kill("a")
    assert rig.until(lambda: rig.all_follow("b")) < 1.0
    rig.check_burst("b")


def test_a_returned_leader_follows_and_may_lead_again_without_a_time_step() -> None:
    rig = ready_rig(cameras=1)
    rig.kill("a")
    rig.until(lambda: rig.all_follow("b"))
    rig.until(rig.all_ready)
    rig.start("a")
    for _ in rig.steps(PROBED_S):
        # This one only follows.
        assert rig.all_follow("b")
        rig.check_time()
    assert rig.machines["a"].succession.leader == ("b", 0)
    rig.check_burst("b")
    rig.kill("b")
    assert rig.until(lambda: rig.all_follow("a")) < 2.0
    # The leader counts a camera as here once it has answered the welcome, some milliseconds later.
    rig.until(rig.all_ready)
    rig.check_burst("a")


def test_a_split_that_heals_leaves_the_leader_of_the_better_rank() -> None:
    rig = ready_rig()
    far = rig.cameras["cam1"]
    far_receives = far.receive_datagram
    rig.split("ab")
    far.receive_datagram = lambda data, address, now_ns: (
        None if address == ("a", 0) else far_receives(data, address, now_ns)
    )
    rig.until(lambda: rig.leading() == "ab" and rig.followed(far) == "b")
    for _ in rig.steps(PROBED_S):
        rig.check_time()
        assert [rig.followed(camera) for camera in rig.cameras.values()] == ["a", "b"]
    rig.split()
    far.receive_datagram = far_receives
    assert rig.until(lambda: rig.all_follow("a")) < 6.0
    rig.until(rig.all_ready)
    for _ in rig.steps(10.0):
        assert rig.all_follow("a")
    rig.check_burst("a")


@pytest.mark.parametrize("frozen_s", [3.0, 15.0])
def test_a_frozen_leader_that_wakes_does_not_take_the_cameras_back(frozen_s: float) -> None:
    rig = ready_rig()
    rig.freeze("a")
    for _ in rig.steps(frozen_s):
        pass
    assert {rig.followed(camera) for camera in rig.cameras.values()} == {"b"}
    rig.until(rig.all_ready)
    rig.tree.revive("a")
    for _ in rig.steps(PROBED_S):
        rig.check_time()
        assert {rig.followed(camera) for camera in rig.cameras.values()} == {"b"}
    assert rig.leading() == "b"
    assert rig.machines["a"].succession.leader == ("b", 0)
    rig.check_burst("b")


def test_a_frozen_leader_without_a_standby_leads_again() -> None:
    rig = ready_rig(cameras=1)
    rig.kill("b")
    rig.freeze("a")
    for _ in rig.steps(10.0):
        pass
    rig.tree.revive("a")
    assert rig.until(lambda: rig.all_follow("a")) < 8.0
    rig.until(rig.all_ready)
    rig.check_burst("a")


def test_of_three_each_waits_for_the_better_ones() -> None:
    rig = ready_rig("abc", cameras=1)
    rig.kill("a")
    assert rig.until(lambda: rig.all_follow("b")) < 2.0
    for _ in rig.steps(5.0):
        assert rig.leading() == "b"
    assert rig.machines["c"].succession.leader == ("b", 0)
    rig.kill("b")
    rig.until(lambda: rig.all_follow("c"), limit_s=6.0)
    rig.until(rig.all_ready)
    rig.check_burst("c")


def test_all_that_start_together_find_one_leader() -> None:
    rig = StandbyRig("abc", cameras=1)
    led = [rig.leading() for _ in rig.steps(20.0)]
    assert led[-1] == "a"
    assert set(led) == {"", "a"}


def test_what_is_below_a_relay_keeps_the_time_as_well() -> None:
    rig = ready_rig(cameras=1)
    rng = random.Random("relay")
    parents = rig.addresses
    member = TreeMember("relay", 1, parents, rng, OF_CAMERAS)
    rig.tree.add("relay", Relay(member, LeaderConfig(0, 0), rng), rng, parents, member)
    below = rig.camera("below", (("relay", 0),))
    rig.until(lambda: below.client.state == "ready")
    for _ in rig.steps(10.0):
        pass
    rig.kill("a")
    rig.until(lambda: rig.all_follow("b") and member.leader == ("b", 0) and member.time.is_member)
    rig.cameras["below"] = below
    for _ in rig.steps(1.0):
        pass
    rig.check_burst("b")
    del rig.cameras["below"]
    for seconds in rig.steps(10.0):
        assert below.client.time_map is not None, seconds
        error_ns, local_ns = rig.error(below, "b")
        assert abs(error_ns) <= below.client.time_map.hard_bound_at(local_ns)
    rig.cameras["below"] = below
    rig.check_burst("b")


def test_without_a_synchronized_clock_it_leads_in_its_own_time() -> None:
    rig = StandbyRig(cameras=1)
    rig.kill("a")
    rig.until(lambda: rig.all_follow("b"))
    assert rig.machines["b"].succession.continued is None
    rig.until(rig.all_ready)
    rig.check_burst("b")
