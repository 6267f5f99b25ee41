"""Every state of a node and of a rig has its own word and glyph on the screen."""

from msgspec.structs import replace

from capture_app.common.node_state import NodeState
from capture_app.protocol.status import REPORT_LOST_NS
from capture_app.tui.signs import SIGNS, rig_sign
from tests.unit.tui.fake_rig import FakeRig, make_node


def test_every_state_can_be_shown_and_told_from_the_others() -> None:
    assert set(SIGNS) == set(NodeState)
    assert len({sign.glyph for sign in SIGNS.values()}) == len(SIGNS)


def test_a_rig_that_has_just_lost_a_camera_is_not_simply_ready() -> None:
    rig = FakeRig(2)
    lost = make_node("extra", NodeState.LOST, last_seen_ns=REPORT_LOST_NS)
    rig.nodes += (lost,)
    sign = rig_sign(rig.status())
    assert (str(sign), sign.style) == ("! 2 of 2 ready, 1 lost", "$warning")
    rig.nodes = (*rig.nodes[:2], replace(lost, last_seen_ns=REPORT_LOST_NS + 1))
    assert str(rig_sign(rig.status())) == "● 2 of 2 ready"
