"""Ranked leaders in virtual time: killed, back again, split and healed; time and bursts go on."""

import random
from collections.abc import Callable, Iterator
from functools import cache

from benchmarks.simulated.clock_tree import Tree, TreeSpec
from benchmarks.simulated.ranked_leaders import Machine, add_leaders
from capture_app.sync.rig.burst_orders import BurstOrder
from capture_app.sync.rig.client import Client, ClientConfig
from capture_app.sync.rig.frame_selection import Burst
from capture_app.sync.sync_engine import Address
from capture_app.sync.tree.succession import Succession
from tests.unit.sync.tree.relay_rig import CAMERA, Camera, copy_of

S = 1_000_000_000


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


def test_one_that_stops_in_order_sends_all_on_at_once() -> None:
    rig = ready_rig()
    rig.machines["a"].leave()
    rig.tree.act("a")
    rig.kill("a")
    assert rig.until(lambda: rig.all_follow("b")) < 1.0
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


def test_all_that_start_together_find_one_leader() -> None:
    rig = StandbyRig("abc", cameras=1)
    led = [rig.leading() for _ in rig.steps(20.0)]
    assert led[-1] == "a"
    assert set(led) == {"", "a"}


def test_without_a_synchronized_clock_it_leads_in_its_own_time() -> None:
    rig = StandbyRig(cameras=1)
    rig.kill("a")
    rig.until(lambda: rig.all_follow("b"))
    assert rig.machines["b"].succession.continued is None
    rig.until(rig.all_ready)
    rig.check_burst("b")


def test_one_that_was_suspended_does_not_lead_on() -> None:
    """Its members have left, and may follow another leader by now."""
    one, now_ns = Succession("a", 1, (("b", 0),), 0, random.Random(1)), 0
    while not one.leads:
        assert now_ns < 60 * S
        one.handle_timer(now_ns := now_ns + S // 4)
    one.handle_timer(now_ns + S // 4)
    assert one.leads
    one.handle_timer(now_ns + 60 * S)
    assert not one.leads
