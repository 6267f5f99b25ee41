"""A staggered rig of real nodes in virtual time: what its session says, and what is made of it."""

from itertools import pairwise
from pathlib import Path

import pytest
from click.testing import CliRunner

from capture_app.cli import app
from capture_app.common.errors import BadInputError
from capture_app.node.leader.leader_node import LeaderNode
from capture_app.protocol.messages import BurstRequest
from capture_app.protocol.orders import StaggerCameras
from capture_app.rig.rig_link import RigLink
from capture_app.session.reading.take_sheet import TakeSheet, contact_sheet
from capture_app.session.reading.verify import verify
from tests.cheap_rig import take_session
from tests.unit.node.leader.test_staggered_burst import (
    NAMES,
    STEP_NS,
    leader,  # noqa: F401 - a fixture
)

pytestmark = pytest.mark.virtual
TOLERANCE_NS = 100_000
"""Of the phase; a step may be off by two of them."""


@pytest.mark.parametrize("video", [False, True])
async def test_a_session_tells_instants_and_the_sequence(leader: LeaderNode, video: bool) -> None:
    assert leader.status().order == "stagger: even, steps of 8.33 ms"
    session = await take_session(leader, BurstRequest(frames=5, video=video))
    assert verify(session) == []
    assert session.is_staggered
    delays_ns = [session.cameras[name].record.delay_ns for name in NAMES]
    assert delays_ns == pytest.approx([place * STEP_NS for place in range(4)], abs=1_000)
    assert [len(instant.frames) for instant in session.instants] == [4] * 5
    assert [frame.camera for frame in session.sequence] == [*NAMES] * 5
    for before, after in pairwise(session.sequence):
        assert after.leader_ns - before.leader_ns == pytest.approx(STEP_NS, abs=2 * TOLERANCE_NS)
    assert abs(session.times("residual_ns")).max() <= TOLERANCE_NS
    assert not any(image.late for image in session.manifest.images)


async def test_nothing_says_that_its_images_are_of_one_moment(leader: LeaderNode) -> None:
    session = await take_session(leader, BurstRequest(frames=5))
    verdict = session.verdict
    assert verdict.headline.startswith("staggered, steps of 8.33 ms: ")
    assert "beside the planned steps" in verdict.sentence
    assert verdict.motion_px_per_s is None
    assert verdict.spread_ns is not None
    assert verdict.spread_ns <= 2 * TOLERANCE_NS
    sheet = TakeSheet(session)
    assert [sheet.heading(name) for name in NAMES][1] == "cam1 +8.33 ms"
    assert contact_sheet(sheet, 64).any()
    shown = CliRunner().invoke(app, ["sessions", "show", str(session.folder)]).output
    assert "staggered: steps of 8.33 ms; beside these, images of one instant are" in shown


async def test_an_operator_can_put_a_rig_in_step_and_stagger_it_again(leader: LeaderNode) -> None:
    link = RigLink(leader.own_address)
    for order, delays_ns in (
        ("", {0}),
        ("cam1=5.0ms", {0, 5_000_000}),
        ("even", {place * STEP_NS for place in range(4)}),
    ):
        await link.order(StaggerCameras(order=order))
        assert leader.status().stagger == order
        session = await take_session(leader, BurstRequest(frames=2, wait_ready_s=30.0))
        assert {camera.delay_ns for camera in session.manifest.cameras} == delays_ns
        assert verify(session) == []
    with pytest.raises(BadInputError, match="stagger"):
        await link.order(StaggerCameras(order="odd"))


async def test_an_mp4_of_all_cameras_has_four_times_the_rate(leader: LeaderNode, tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    session = await take_session(leader, BurstRequest(frames=5))
    arguments = ["sessions", "export", str(session.folder), "--to", "mp4", "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    assert "the session is staggered: steps of 8.33 ms" in done.output
    with av.open(str(tmp_path / "out" / "sequence.mp4")) as container:
        times_us = [round(float(frame.pts * frame.time_base) * 1e6) for frame in container.decode(video=0)]
    assert len(times_us) == 20
    for before, after in pairwise(times_us):
        assert after - before == pytest.approx(STEP_NS / 1000, abs=2 * TOLERANCE_NS / 1000)
