"""`capture-app rig`: rigs in the background, as started and left running by the terminal UI."""

import asyncio
from pathlib import Path

import click

from capture_app.commands.shared_options import (
    cameras_option,
    host_option,
    leader_option,
    rig_port_option,
    sessions_option,
    stagger_option,
)
from capture_app.common.address import Address
from capture_app.common.stagger import OFF, Stagger
from capture_app.console.terminal import ParsedType, answer, json_option, table, talk
from capture_app.console.usage import examples


@click.group(epilog=examples("capture-app rig list"))
def rig() -> None:
    """Start, list and stop rigs that run in the background of this machine.

    The terminal UI attaches to the newest of them, and starts one if there is none.
    """


@rig.command(epilog=examples("capture-app rig start", "capture-app rig start --camera v4l2:/dev/video0"))
@host_option
@rig_port_option
@sessions_option
@cameras_option
@stagger_option
@json_option
def start(
    host: str,
    port: int | None,
    sessions: Path,
    cameras: tuple[str, ...],
    stagger: Stagger | None,
    as_json: bool,
) -> None:
    """Start a rig that keeps running, and print its address."""
    from capture_app.machine.doctor import warnings_for_leader
    from capture_app.rig.process import start_rig

    starting = start_rig(sessions=sessions, host=host, port=port, cameras=cameras, stagger=stagger)
    started = asyncio.run(starting)
    for warning in warnings_for_leader(host, started.address.port, sessions):
        talk(warning)
    until = f"it runs until: capture-app rig stop --leader {started.leader}"
    answer(as_json, started, [started.leader], said=until)


@rig.command(
    "list",
    epilog=examples("capture-app rig list"),
)
@json_option
def list_command(as_json: bool) -> None:
    """List the running rigs of this machine, newest first."""
    from capture_app.rig.process import list_rigs

    rigs = list_rigs()
    rows = [
        (record.leader, str(record.pid), record.sessions, record.log or "on its terminal") for record in rigs
    ]
    answer(
        as_json,
        {"rigs": rigs},
        [table(("leader", "process", "sessions", "log"), rows)] if rows else [],
        said="" if rigs else "no rig runs on this machine",
    )


@rig.command(epilog=examples("capture-app rig stagger even", "capture-app rig stagger off"))
@click.argument("order", type=ParsedType("text", Stagger.parse_or_off))
@leader_option
@json_option
def stagger(order: Stagger | None, leader: Address, as_json: bool) -> None:
    """Take the frames of a running rig one after the other, or all at one instant again.

    ORDER is even, a delay for each camera as cam0=0ms,cam1=8.3ms, or off. It holds until the leader stops.
    """
    from capture_app.protocol.orders import StaggerCameras
    from capture_app.rig.rig_link import give_order

    text = str(order or "")
    asyncio.run(give_order(leader, StaggerCameras(order=text)))
    answer(as_json, {"stagger": text}, said=f"{leader} staggers its cameras: {text or OFF}")


@rig.command(epilog=examples("capture-app rig stop"))
@leader_option
@json_option
def stop(leader: Address, as_json: bool) -> None:
    """Stop a rig on this or another machine: its leader, and the cameras that the leader started.

    Images received so far are saved.
    """
    from capture_app.protocol.orders import StopRig
    from capture_app.rig.rig_link import give_order

    asyncio.run(give_order(leader, StopRig()))
    answer(as_json, {"stopped": str(leader)}, said=f"{leader} stops")
