"""States in words."""

from capture_app.common.node_state import NodeState


def test_a_ready_node_says_how_large_its_error_may_be() -> None:
    assert NodeState.READY.with_error(180_000) == "ready, ±180 µs"
    assert NodeState.DEGRADED.with_error(2_400_000) == "degraded, ±2.4 ms"
    assert NodeState.READY.with_error(None) == "ready"
    assert NodeState.SYNCING.with_error(180_000) == "syncing"
