"""`capture-app cameras calibrate-time`: how late each camera's stamps are, by pictures of what all see."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from capture_app.commands.operator.take import ready_options, take_burst
from capture_app.commands.options import leader_option
from capture_app.errors import IncompleteError, NotApplicableError
from capture_app.net.address import Address
from capture_app.terminal import FiniteRange, json_option, print_json, print_table, talk
from capture_app.usage import examples

if TYPE_CHECKING:
    from capture_app.camera_facts import StampAccuracy
    from capture_app.node.operator.stamp_calibration import MeasuredTimes
    from capture_app.session.reading.reader import Session

NAME = "calibrate-time"
MOTION_S, LIGHT_S = 2.0, 8.0


@click.command(
    NAME,
    epilog=examples(
        "capture-app cameras calibrate-time",
        "capture-app cameras calibrate-time --light",
        "capture-app cameras calibrate-time --session sessions/calibrate-time-001",
    ),
)
@leader_option
@click.option(
    "--light", is_flag=True, help="A torch is to blink some eight times, instead of somebody to move."
)
@click.option(
    "--seconds",
    type=FiniteRange(0.5, 60.0),
    metavar="S",
    show_default=f"{MOTION_S:g}, with --light {LIGHT_S:g}",
    help="How long pictures are taken.",
)
@click.option(
    "--session",
    "folder",
    type=click.Path(path_type=Path),
    metavar="SESSION",
    help="Take no pictures: those of this session are of the cameras as they run now.",
)
@ready_options
@json_option
def calibrate_time(
    leader: Address,
    light: bool,
    seconds: float | None,
    folder: Path | None,
    wait_s: float,
    min_nodes: int,
    as_json: bool,
) -> None:
    """Measure how late each camera's stamps are, and let the rig go by that from now on.

    All cameras must see somebody who moves for two seconds, up and down as well as across; with --light a
    torch that is switched on and off eight times, half a second or more each. What is found is kept for each
    camera in its mode, on its machine. Needs reconstruct on this machine.
    """
    from capture_app.session.reading.reader import Session

    if folder is None:
        seconds = seconds or (LIGHT_S if light else MOTION_S)
        folder = _take(leader, seconds, light, wait_s, min_nodes)
    session = Session.open(folder)
    found, stamps, kept = asyncio.run(_calibrate(leader, session))
    if as_json:
        cameras: dict[str, Any] = {
            name: {"measured": time, "stamp": stamps.get(name), "kept": kept.get(name, False)}
            for name, time in found.cameras.items()
        }
        print_json({"session": str(folder), "reference": found.reference, "cameras": cameras})
    else:
        _show(found, stamps, kept)
    if reason := next((one.reason for one in found.cameras.values() if one.reason), ""):
        missing = ", ".join(name for name, one in found.cameras.items() if one.reason)
        raise NotApplicableError(
            f"how late the stamps of {missing} are cannot be told: {reason}",
            hint="somebody has to move up and down before all cameras, or a torch to blink (--light)",
        )


def _take(leader: Address, seconds: float, light: bool, wait_s: float, min_nodes: int) -> Path:
    """Take the pictures; the folder of their session."""
    from capture_app.node.wire.messages import BurstRequest

    todo = "switch a torch on and off before all cameras, again and again" if light else (
        "somebody has to move before all cameras"
    )  # fmt: skip
    talk(f"{seconds:g} s of pictures: {todo}")
    request = BurstRequest(
        seconds=seconds,
        spare=0,
        name=NAME,
        note="taken to measure how late the cameras' stamps are",
        wait_ready_s=wait_s,
        nodes=min_nodes,
    )
    done = asyncio.run(take_burst(leader, request))
    if done.session is None:
        raise IncompleteError(f"no pictures were saved: {done.message}")
    if not Path(done.session).is_dir():
        raise IncompleteError(
            f"the pictures are on the leader's machine, in {done.session}", hint="calibrate there"
        )
    return Path(done.session)


async def _calibrate(
    leader: Address, session: "Session"
) -> "tuple[MeasuredTimes, dict[str, StampAccuracy], dict[str, bool]]":
    """Measure, and tell each camera's node; what was found, the stamps, and by whom they are kept."""
    from capture_app.node.operator.requests import tell_stamp
    from capture_app.node.operator.stamp_calibration import choose_reference, measure_session, measured_stamps

    records = {record.name: record for record in session.manifest.cameras}
    talk("measuring")
    reference = choose_reference({name: record.facts for name, record in records.items()})
    found = await measure_session(session.folder, reference)
    stamps = measured_stamps(records, found)
    kept = {name: await tell_stamp(leader, name, stamp) for name, stamp in stamps.items()}
    return found, stamps, kept


def _show(found: "MeasuredTimes", stamps: "dict[str, StampAccuracy]", kept: dict[str, bool]) -> None:
    from capture_app.session.reading.stamp_words import describe_stamp

    rows = []
    for name, time in found.cameras.items():
        if name in stamps:
            said = describe_stamp(stamps[name]) + ("" if kept[name] else "; could not be kept")
        elif time.offset_ms is not None:
            said = "as they were known: that is surer"
        else:
            said = f"cannot be told: {time.reason}"
        rows.append((name, said))
    print_table(("camera", "stamps are late by"), rows)
