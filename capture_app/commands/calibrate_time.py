"""`capture-app cameras calibrate-time`: delays of a rig's cameras."""

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

import click

from capture_app.commands.shared_options import F, leader_option, together
from capture_app.commands.take import require_whole, take
from capture_app.common.address import Address
from capture_app.common.errors import IncompleteError, NotApplicableError
from capture_app.common.plugins import load_plugin, load_plugins, plugin_names
from capture_app.common.templates import render_rows
from capture_app.console.option_rules import Rule, RuledCommand
from capture_app.console.terminal import SESSION, answer, json_option, table, talk
from capture_app.console.usage import examples

if TYPE_CHECKING:
    from capture_app.commands.take import TakeEnd
    from capture_app.protocol.orders import SaveStamp
    from capture_app.rig.camera_times import MeasuredTimes

NAME = "calibrate-time"
MOTION_S, LIGHT_S = 2.0, 8.0
WAIT_READY_S = 20.0
MEASURES = "simulshot.delay_measures"
"""Group of entry points: modules with `HELP`, `TODO` and `measure`; each becomes an option of its name."""
MOVE = "move in front of all cameras"
BLINK = "switch a torch on and off repeatedly in front of all cameras"


def _by_plugins(command: F) -> F:
    """Add an option for each plugin that measures delays."""
    options = (
        click.option(f"--{name}", "by", flag_value=name, help=plugin.HELP)
        for name, plugin in load_plugins(MEASURES, "HELP", "TODO", "measure").items()
    )
    return together(*options)(command)


@click.command(
    NAME,
    cls=RuledCommand,
    rules=(
        Rule("--light", "!--session", ": a take decides by what it shows"),
        *(Rule("--light", f"!--{name}") for name in plugin_names(MEASURES)),
    ),
    epilog=examples(
        "capture-app cameras calibrate-time",
        "capture-app cameras calibrate-time --light",
        *(f"capture-app cameras calibrate-time --{name}" for name in plugin_names(MEASURES)),
        "capture-app cameras calibrate-time --session sessions/calibrate-time-001",
    ),
)
@leader_option
@click.option(
    "--light", is_flag=True, help="Measure with a torch that blinks about eight times, instead of motion."
)
@_by_plugins
@click.option(
    "--session",
    "folder",
    type=SESSION,
    metavar="SESSION",
    help="Use this session of the running cameras instead of a new take.",
)
@json_option
def calibrate_time(
    leader: Address,
    light: bool,
    folder: Path | None,
    as_json: bool,
    by: str | None = None,
) -> None:
    """Measure the timestamp delay of each camera, and correct for it from now on.

    All cameras must see a person who moves for two seconds, up and down as well as across. With --light, all
    must see a torch switched on and off eight times, at least half a second each. The delay is stored for
    each camera and mode on its machine. For cameras with known timestamps, the remaining difference is stored
    as the asymmetry of the path to the leader. Motion and light require reconstruct on this machine.
    """
    from capture_app.rig.camera_times import calibrate
    from capture_app.session.reading.reader import Session

    plugin = None if by is None else load_plugin(MEASURES, by)
    if folder is None:
        seconds = LIGHT_S if light else MOTION_S
        todo = plugin.TODO if plugin is not None else BLINK if light else MOVE
        folder = _take(leader, seconds, todo)
    session = Session.open(folder)
    talk("measuring")
    delays, orders, saved = asyncio.run(calibrate(leader, session, plugin and plugin.measure(session)))
    cameras = {
        name: {
            "measured": time,
            "stamp": orders[name].stamp if name in orders else None,
            "way": orders[name].asymmetry if name in orders else None,
            "kept": saved.get(name, False),
        }
        for name, time in delays.cameras.items()
    }
    answer(
        as_json,
        {"session": str(folder), "reference": delays.reference, "cameras": cameras},
        [table(("camera", "timestamp delay"), _rows_of(delays, orders, saved))],
    )
    if reason := next((camera.reason for camera in delays.cameras.values() if camera.reason), ""):
        missing = ", ".join(name for name, camera in delays.cameras.items() if camera.reason)
        raise NotApplicableError(
            f"the timestamp delay of {missing} cannot be measured: {reason}",
            hint="move up and down in front of all cameras, or use a blinking torch: --light",
        )


def _take(leader: Address, seconds: float, todo: str) -> Path:
    """Record pictures for some seconds once the rig is ready, and return their session's folder."""
    from capture_app.rig.rig_link import RigLink
    from capture_app.rig.taking import TakePlan

    talk(f"taking pictures for {seconds:g} s: {todo}")
    note = "taken to measure timestamp delays"
    plan = TakePlan(seconds=seconds, name=NAME, note=note, wait_ready_s=WAIT_READY_S)
    taken: list[TakeEnd] = []
    asyncio.run(take(RigLink(leader), plan, taken, silent=True))
    require_whole(taken[0], 100.0)
    where = (taken[0].status and taken[0].status.session) or "its phones"
    if not Path(where).is_dir():
        raise IncompleteError(
            f"the pictures are on the leader's machine, in {where}",
            hint="run capture-app cameras calibrate-time there",
        )
    return Path(where)


def _rows_of(
    measured: "MeasuredTimes", orders: "dict[str, SaveStamp]", saved: dict[str, bool]
) -> list[tuple[str, ...]]:
    from capture_app.common.camera_facts import describe_stamp

    view = {"found": measured, "orders": orders, "saved": saved, "describe_stamp": describe_stamp}
    return render_rows("measured_times.txt", __package__, **view)
