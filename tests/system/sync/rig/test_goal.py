"""Goals that the leader moves to suit some, and exposure centres, through the real messages."""

from tests.unit.sync.rig.rigs import S, ready_rig
from tests.unit.sync.rig.test_goal import node


def test_webcams_agree_and_a_burst_finds_them_together() -> None:
    rig = ready_rig([node(f"webcam{n}", "webcam", 1_000_000) for n in range(3)], seed=7, limit_s=90)
    burst = rig.trigger(frames=1)
    rig.run_for(3 * S)
    starts = [n.bursts[burst.number].frames[0].frame.start_true_ns for n in rig.nodes.values()]
    assert max(starts) - min(starts) < 2_200_000
