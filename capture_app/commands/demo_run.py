"""The whole path at once: simulated cameras in processes of their own, a burst, and its comparison."""

import asyncio
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec
from msgspec import Struct

from capture_app.common.child import Child, Talk
from capture_app.common.errors import BadInputError, IncompleteError, SimulshotError
from capture_app.common.tasks import first_of, has_come
from capture_app.common.text import UNREADABLE, ProgressStep
from capture_app.node.burst.plans import usual_spare
from capture_app.node.leader.leader import LeaderNode
from capture_app.node.leader.local_nodes import LocalNodes
from capture_app.node.leader.options import LeaderOptions
from capture_app.protocol.status import BurstStatus
from capture_app.session.files.durable import free_name
from capture_app.session.reading.reader import Session
from capture_app.sync.rig.orders import BurstOrder

FRAMES = 5
CAMERA_OPTIONS = "drops=0,scale=0.75,samples=2"
"""Nothing lost; pictures of 480x360, two rays a pixel, show all that finer ones do, and are quickly made."""
QUICK = ("--max-multiview-instants", "3", "--multiview-width", "320")
"""Depth from all cameras of small pictures: as telling, in a fifth of the time."""
TOLERANCE_US = 50
READY_TIMEOUT_S = 90.0
LOOK_EVERY_S = 0.2


class NodeErrors(Struct, frozen=True, kw_only=True):
    """One node's errors against the simulator's truth, at the instant where the total is worst; in ns."""

    name: str
    clock_error_ns: int
    """Leader time of the frame's timestamp as estimated, minus what it truly was."""
    phase_error_ns: int
    """The frame's leader time as recorded, minus its instant."""
    total_error_ns: int
    """True start of the frame minus the instant."""
    hard_bound_ns: int


class SyncErrors(Struct, frozen=True, kw_only=True):
    """How well a simulated rig took its pictures at the same time."""

    nodes: tuple[NodeErrors, ...]
    max_total_error_ns: int


class DemoResult(Struct, frozen=True, kw_only=True):
    """What `capture-app demo --json` prints; `compare` is the comparison's `metrics.json`."""

    session: str
    report: str
    seconds: float
    sync: SyncErrors
    compare: dict[str, Any]


async def run_demo(out: Path, cameras: int, talk: Talk) -> DemoResult:
    """Take a burst of `cameras` simulated cameras into a session in `out`, and compare it.

    Raises SimulshotError where a part of it fails; what is saved by then stays.
    """
    began_s = time.monotonic()
    session = await capture(out, cameras, talk)
    report = free_name(out / "compare")
    compared = await compare(session.folder, report, talk)
    return DemoResult(
        session=str(session.folder),
        report=str(report / "report.html"),
        seconds=round(time.monotonic() - began_s, 2),
        sync=measure_sync_errors(session),
        compare=compared,
    )


async def capture(out: Path, cameras: int, talk: Talk, *, scene: str = "studio") -> Session:
    """Start a leader and simulated nodes, take one burst when all are ready, and return its session."""

    options = LeaderOptions(sessions=out, host="127.0.0.1", port=0)
    with TemporaryDirectory(prefix="simulshot-spool-") as spool:
        async with (
            await LeaderNode.start(options) as leader,
            LocalNodes(leader.own_address, Path(spool), leader.news) as nodes,
        ):
            talk(f"starting {cameras} simulated cameras, each a process with a clock of its own")
            await nodes.add_simulated(cameras, scene, options=CAMERA_OPTIONS, tolerance_us=TOLERANCE_US)
            failure, burst = await first_of(nodes.wait_for_failure(), _take_burst(leader, cameras, talk))
            if burst.cancelled():
                raise failure.result()
            saved = burst.result()
    if saved.session is None:
        raise IncompleteError(saved.message)
    if saved.message:
        talk(saved.message)
    return Session.open(Path(saved.session))


async def _take_burst(leader: LeaderNode, cameras: int, talk: Talk) -> BurstStatus:
    waiting = asyncio.create_task(leader.wait_until_ready(READY_TIMEOUT_S, nodes=cameras))
    try:
        shown = ""
        while not (await asyncio.wait((waiting,), timeout=0.5))[0]:
            states = [str(node.state) for node in leader.status().nodes]
            counts = ", ".join(f"{states.count(state)} {state}" for state in dict.fromkeys(states))
            if counts and counts != shown:
                shown = counts
                talk(counts)
        waiting.result()
    finally:
        waiting.cancel()
    talk(f"taking a burst of {FRAMES} instants; the pictures are rendered as they are saved")
    order = BurstOrder(frames=FRAMES, spare=usual_spare(FRAMES))
    burst, saved = await leader.bursts.order(order), 0
    while not burst.finished.is_set():
        await has_come(burst.finished, LOOK_EVERY_S)
        if burst.status.received > saved:
            saved = burst.status.received
            talk(str(ProgressStep(saved, burst.status.expected, "images saved")))
    return burst.status


async def compare(session: Path, out: Path, talk: Talk) -> dict[str, Any]:
    """Run `reconstruct compare` in a process of its own, pass its progress on, and return its metrics."""
    arguments = ("compare", str(session), *QUICK, "--out", str(out), "--json")
    child = await Child.start("reconstruct compare", ("reconstruction.cli", *arguments), on_line=talk)
    try:
        printed = await child.output()
    finally:
        await child.stop()
    try:
        metrics: dict[str, Any] = msgspec.json.decode(printed, type=dict[str, Any])
    except UNREADABLE as error:
        raise SimulshotError(f"reconstruct compare printed no JSON: {error}") from error
    return metrics


def measure_sync_errors(session: Session) -> SyncErrors:
    """Hold a simulated session against its own truth; the leader's clock is the host's, which is true time.

    Raises BadInputError where the session has no ground truth.
    """
    truth = session.true_times()
    if truth is None or not truth.clocks:
        raise BadInputError(f"{session.folder} has no ground truth", hint="only simulated sessions have it")
    true_ns = {(time.camera, time.instant): time.true_ns for time in truth.images}
    worst: dict[str, NodeErrors] = {}
    for image in session.manifest.images:
        instant_ns = session.manifest.burst.instants_ns[image.instant]
        assert image.local_ns is not None
        errors = NodeErrors(
            name=image.camera,
            clock_error_ns=image.leader_ns - truth.clocks[image.camera].true_from_local(image.local_ns),
            phase_error_ns=image.leader_ns - instant_ns,
            total_error_ns=true_ns[image.camera, image.instant] - instant_ns,
            hard_bound_ns=image.hard_bound_ns or 0,
        )
        known = worst.get(image.camera)
        if known is None or abs(errors.total_error_ns) > abs(known.total_error_ns):
            worst[image.camera] = errors
    nodes = tuple(worst[name] for name in sorted(worst))
    return SyncErrors(nodes=nodes, max_total_error_ns=max(abs(node.total_error_ns) for node in nodes))
