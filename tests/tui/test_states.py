"""Every state of a node has its own word and glyph on the screen."""

from capture_app.sync.wire.messages import NodeState
from capture_app.tui.states import SIGNS


def test_every_state_can_be_shown_and_told_from_the_others() -> None:
    assert set(SIGNS) == set(NodeState)
    assert len({sign.glyph for sign in SIGNS.values()}) == len(SIGNS)
