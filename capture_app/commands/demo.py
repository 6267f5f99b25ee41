"""`capture-app demo`: simulated cameras in separate processes, a burst, and its comparison."""

import textwrap
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from capture_app.commands.shared_options import FOLDER, run_until_stopped, stagger_option
from capture_app.common import system
from capture_app.common.child import ask_reconstruct
from capture_app.common.errors import BadInputError
from capture_app.common.stagger import Stagger
from capture_app.common.text import ProgressStep, Talk
from capture_app.common.timeouts import READY_TIMEOUT_S
from capture_app.console.terminal import answer, json_option, show_progress, table, talk
from capture_app.console.usage import examples
from capture_app.session.files.durable import free_name

if TYPE_CHECKING:
    from capture_app.session.reading.reader import Session

FRAMES = 5
CAMERA_OPTIONS = "drops=0,scale=0.75,samples=2"
"""Nothing lost; pictures of 480x360, two rays a pixel, show all that finer ones do, and are quickly made."""
QUICK = ("--max-multiview-instants", "3", "--multiview-width", "320")
"""Depth from all cameras of small pictures: as telling, in a fifth of the time."""


@click.command(
    epilog=examples(
        "capture-app demo", "capture-app demo --cameras 3 --out /tmp/demo", "capture-app demo --stagger even"
    )
)
@click.option("--cameras", type=click.IntRange(2, 7), default=5, metavar="N", help="Simulated cameras.")
@click.option(
    "--out",
    type=FOLDER,
    default=Path("demo"),
    metavar="DIR",
    help="Folder for the session and the comparison.",
)
@stagger_option
@json_option
def demo(cameras: int, out: Path, stagger: Stagger | None, as_json: bool) -> None:
    """Synchronize simulated cameras, take a burst, and compare synchronized with delayed pictures.

    Each camera is a process whose clock is hours off; they communicate over this machine's network.
    """
    result = run_until_stopped(run_demo(out, cameras, _show_line, stagger))
    answer(as_json, result, _lines(result), said=f"done in {result['seconds']:.0f} s")


def _show_line(line: str) -> None:
    if step := ProgressStep.parse(line):
        show_progress(step)
    else:
        talk(line)


def _lines(result: dict[str, Any]) -> Iterator[str]:
    nodes = (node.values() for node in result["sync"]["nodes"])
    yield table(
        ("camera", "clock error µs", "phase error µs", "total error µs", "hard bound µs"),
        [(name, *(f"{time_ns / 1000:.1f}" for time_ns in words)) for name, *words in nodes],
    )
    yield "\n" + textwrap.fill(str(result["compare"].get("verdict", "")), 88) + "\n"
    yield f"session  {result['session']}"
    yield f"report   {result['report']}"


async def run_demo(out: Path, cameras: int, talk: Talk, stagger: Stagger | None = None) -> dict[str, Any]:
    """Take a burst of `cameras` simulated cameras into a session in `out`, compare it, and return the result.

    `compare` is the comparison's `metrics.json`.

    Raises SimulshotError where a part of it fails; what is saved by then stays.
    """
    began_s = system.monotonic_s()
    session = await capture(out, cameras, talk, stagger=stagger)
    report = free_name(out / "compare")
    arguments = ("compare", str(session.folder), *QUICK, "--out", str(report))
    compared = await ask_reconstruct(arguments, dict[str, Any], on_line=talk)
    nodes = measure_sync_errors(session)
    return {
        "session": str(session.folder),
        "report": str(report / "report.html"),
        "seconds": round(system.monotonic_s() - began_s, 2),
        "sync": {"nodes": nodes, "max_total_error_ns": max(abs(node["total_error_ns"]) for node in nodes)},
        "compare": compared,
    }


async def capture(
    out: Path, cameras: int, talk: Talk, *, scene: str = "studio", stagger: Stagger | None = None
) -> "Session":
    """Start a rig of simulated cameras, take one burst when all are ready, and return its session."""
    from capture_app.protocol.orders import AddSimulated
    from capture_app.rig import taking
    from capture_app.rig.rig import AsyncRig
    from capture_app.rig.rig_link import give_order
    from capture_app.session.reading.reader import Session

    waited_for = ""
    plan = taking.TakePlan(frames=FRAMES, wait_ready_s=READY_TIMEOUT_S, nodes=cameras)
    async with AsyncRig(sessions=out, stagger=None if stagger is None else str(stagger)) as rig:
        talk(f"starting {cameras} simulated cameras, each a process with a clock of its own")
        order = AddSimulated(cameras=cameras, scene=scene, options=CAMERA_OPTIONS, tolerance_us=50)
        await give_order(rig.address, order)
        async for event in rig.take(plan):
            match event:
                case taking.Waiting(reason=reason) if reason != waited_for:
                    talk(waited_for := reason)
                case taking.Begun():
                    talk(f"taking a burst of {FRAMES} instants; the pictures are rendered as they are saved")
                case taking.Progress(status=status) if status.received:
                    talk(str(ProgressStep(status.received, status.expected, "images saved")))
                case taking.Failed(error=error):
                    raise error
                case taking.Saved(status=status):
                    session = Session.open(Path(status.session or ""))
                    if status.message:
                        talk(status.message)
    return session


def measure_sync_errors(session: "Session") -> list[dict[str, Any]]:
    """Return each camera's errors (ns) at its worst image in a simulated session, against the ground truth.

    The clock error is of the timestamp's estimated leader time, the phase error the frame's recorded
    leader time minus its planned time, and the total error the frame's true start minus that time: its
    instant, and in a staggered rig its camera's delay. The leader's clock is the host's, which is the true
    time. Raises BadInputError where the session has no ground truth.
    """
    truth = session.true_times()
    if truth is None or not truth.clocks:
        raise BadInputError(
            f"{session.folder} has no ground truth",
            hint="give a simulated session, such as sample_sessions/jumper",
        )
    true_ns = {(time.camera, time.instant): time.true_ns for time in truth.images}
    errors = defaultdict[str, list[dict[str, Any]]](list)
    for image in session.manifest.images:
        delay_ns = session.camera(image.camera).delay_ns
        planned_ns = session.manifest.burst.instants_ns[image.instant] + delay_ns
        assert image.local_ns is not None
        of_image = {
            "name": image.camera,
            "clock_error_ns": image.leader_ns - truth.clocks[image.camera].true_from_local(image.local_ns),
            "phase_error_ns": image.leader_ns - planned_ns,
            "total_error_ns": true_ns[image.camera, image.instant] - planned_ns,
            "hard_bound_ns": image.hard_bound_ns or 0,
        }
        errors[image.camera].append(of_image)
    return [max(errors[name], key=lambda error: abs(error["total_error_ns"])) for name in sorted(errors)]
