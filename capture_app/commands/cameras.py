"""`capture-app cameras`: cameras of this machine and of a running rig, and the rig's controls."""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from capture_app.commands.calibrate_time import calibrate_time
from capture_app.commands.shared_options import ANY_PATH, leader_option
from capture_app.common.address import Address
from capture_app.common.camera_facts import Control, ControlValue, describe, parse_settings
from capture_app.common.plugins import CAMERA_COMMANDS, load_plugins
from capture_app.common.templates import render_rows
from capture_app.common.text import UNREADABLE, megabytes, pretty_json
from capture_app.console.option_rules import Rule, RuledCommand
from capture_app.console.terminal import answer, json_option, table, talk
from capture_app.console.usage import examples, write_plugins
from capture_app.session.files.durable import write_atomic
from capture_app.session.files.untrusted_files import read_input, rejecting

if TYPE_CHECKING:
    from capture_app.protocol.status import NodeDetail, RigStatus
    from capture_app.rig.rig_link import CamerasControls

Profile = dict[str, dict[Control, ControlValue]]
"""Target values of each camera's controls, by camera name."""
NAMES = tuple(str(control) for control in Control)


@click.command(
    epilog=examples("capture-app cameras controls", "capture-app cameras controls --save night.json")
)
@click.option("--save", type=ANY_PATH, metavar="FILE", help="Save them as a profile for `cameras set`.")
@leader_option
@json_option
def controls(save: Path | None, leader: Address, as_json: bool) -> None:
    """Show exposure, gain, white balance and focus of all cameras of a rig."""
    from capture_app.rig.rig_link import ask_status, set_cameras

    rig = asyncio.run(ask_status(leader))
    states = asyncio.run(set_cameras(leader, rig, {}))
    if save is not None:
        profile: Profile = {
            camera: {
                control.control: "auto" if control.automatic else control.value or 0.0
                for control in state.controls
                if control.automatic or control.value is not None
            }
            for camera, state in states.items()
        }
        write_atomic(save, pretty_json(profile))
    _answer(as_json, states, rig)


@click.command(
    "set",
    cls=RuledCommand,
    rules=(Rule("", "values --profile", ", as in exposure=4000"), Rule("--profile", "!values")),
    epilog=examples(
        "capture-app cameras set exposure=4000 gain=2 --camera cam1",
        "capture-app cameras set exposure=auto white-balance=auto",
        "capture-app cameras set --profile night.json",
    ),
)
@click.argument("values", nargs=-1, metavar="CONTROL=VALUE...")
@click.option(
    "--profile", type=ANY_PATH, metavar="FILE", help="Profile written by `cameras controls --save`."
)
@click.option("--camera", "cameras", multiple=True, metavar="NAME", help="Set this camera only. Repeatable.")
@leader_option
@json_option
def set_command(
    values: tuple[str, ...], profile: Path | None, cameras: tuple[str, ...], leader: Address, as_json: bool
) -> None:
    """Set controls of a rig's cameras; of all cameras without --camera.

    The rig stores the values, and sets them again on a camera that reconnects; on a new one if all agree.

    CONTROL is exposure (in µs), gain, white-balance (in K) or focus. VALUE is a number in the camera's unit,
    as shown by `cameras controls`; auto lets the camera choose; hold freezes the chosen value.
    """
    from capture_app.rig.rig_link import ask_status, camera_named, set_cameras

    chosen = {} if profile is None else _read_profile(profile)
    settings = parse_settings(values)
    rig = asyncio.run(ask_status(leader))
    if profile is None:
        states = asyncio.run(set_cameras(leader, rig, settings, cameras))
    else:
        names = [camera_named(rig, text) for text in cameras]
        states = {
            name: asyncio.run(set_cameras(leader, rig, value, [name]))[name]
            for name, value in chosen.items()
            if not names or name in names
        }
    _answer(as_json, states, rig)


@click.command(
    epilog=examples("capture-app cameras match cam1"),
)
@click.argument("camera")
@leader_option
@json_option
def match(camera: str, leader: Address, as_json: bool) -> None:
    """Set all cameras of a rig like CAMERA: freeze its values, and set them on all others.

    Values that a camera does not support are reported with the reason.
    """
    from capture_app.rig.rig_link import ask_status, match_cameras

    rig = asyncio.run(ask_status(leader))
    _answer(as_json, asyncio.run(match_cameras(leader, rig, camera)), rig)


def _read_profile(file: Path) -> Profile:
    remedy = f"make one: capture-app cameras controls --save {file}"
    with rejecting(f"{file} is not a profile", *UNREADABLE, hint=remedy):
        return msgspec.json.decode(read_input(file), type=Profile)


def _answer(as_json: bool, found: "CamerasControls", rig: "RigStatus") -> None:
    answer(
        as_json,
        {"cameras": [{"camera": camera, "state": state} for camera, state in found.items()]},
        _lines({rig.titles.get(name, name): state for name, state in found.items()}),
    )


def _lines(found: "CamerasControls") -> Iterator[str]:
    """Describe controls by what people call the cameras."""
    if found:
        rows = (
            (title, *(describe(value.state(control)) for control in Control))
            for title, value in found.items()
        )
        yield table(("camera", *NAMES), rows)
    else:
        talk("no camera has joined")
    for title, state in found.items():
        for problem in dict.fromkeys(state.problems.values()):
            talk(f"{title}: {problem}")


def _name_of(leader: Address, text: str) -> str:
    from capture_app.rig.rig_link import ask_status, camera_named

    return camera_named(asyncio.run(ask_status(leader)), text)


class CamerasGroup(click.Group):
    """A group whose help lists the kinds of cameras that have a driver here."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write how each kind's spec is written, its options and what it needs, below the commands."""
        from capture_app.machine.cameras import common_options, kinds_of_cameras

        super().format_options(ctx, formatter)
        rows = []
        for driver in kinds_of_cameras().values():
            needs = driver.NEEDS and f" Needs {driver.NEEDS}."
            options = f" Options: {', '.join(driver.OPTIONS)}." if driver.OPTIONS else ""
            rows.append((driver.SPEC, driver.HELP + needs + options))
        rows += [(f"any camera,{name}=…", text) for name, text in common_options().items()]
        write_plugins(formatter, "Cameras", rows)


@click.group(
    cls=CamerasGroup,
    invoke_without_command=True,
    epilog=examples("capture-app cameras"),
)
@json_option
@click.pass_context
def cameras(ctx: click.Context, as_json: bool) -> None:
    """List the cameras of this machine and the simulated camera models.

    With a command: start, show, measure, calibrate or remove cameras.
    """
    from capture_app.machine.cameras import list_cameras

    if ctx.invoked_subcommand is not None:
        if as_json:
            raise click.UsageError(f"--json comes after {ctx.invoked_subcommand}")
        return
    listed = list_cameras()
    rows = [(camera.spec, camera.model, camera.detail) for camera in listed]
    answer(as_json, {"cameras": listed}, [table(("spec", "model", "detail"), rows)])


@cameras.command("list", hidden=True)
@json_option
@click.pass_context
def list_command(ctx: click.Context, as_json: bool) -> None:
    """List the cameras of this machine, as `capture-app cameras` does."""
    assert ctx.parent is not None
    ctx.parent.invoked_subcommand = None
    ctx.parent.invoke(cameras, as_json=as_json)


for _command in (
    calibrate_time,
    controls,
    set_command,
    match,
    *load_plugins(CAMERA_COMMANDS, "get_short_help_str").values(),
):
    cameras.add_command(_command)


@cameras.command(
    cls=RuledCommand,
    rules=(
        Rule("", "spec --simulated", ": capture-app cameras lists each SPEC"),
        Rule("--simulated", "!spec"),
        Rule("--name", "!--simulated", ": it names one camera"),
        Rule("--scene", "--simulated"),
    ),
    epilog=examples("capture-app cameras add v4l2:/dev/video0", "capture-app cameras add --simulated 5"),
)
@click.argument("spec", required=False)
@click.option("--name", metavar="NAME", show_default="after the device", help="Name of the camera.")
@click.option(
    "--simulated", type=click.IntRange(1, 64), metavar="N", help="Start N simulated cameras instead."
)
@click.option("--scene", default="studio", help="With --simulated: scene that the cameras see.")
@leader_option
@json_option
def add(
    spec: str | None, name: str | None, simulated: int | None, scene: str, leader: Address, as_json: bool
) -> None:
    """Start the camera SPEC on the leader's machine, as a process that ends with the leader.

    Cameras of other machines join by themselves: capture-app node.
    """
    from capture_app.common.passwords import reveal_password
    from capture_app.protocol.orders import AddCamera, AddSimulated, Order
    from capture_app.rig.rig_link import give_order

    order: Order = (
        AddSimulated(cameras=simulated or 1, scene=scene)
        if spec is None
        else AddCamera(spec=reveal_password(spec), name=name)
    )
    names = asyncio.run(give_order(leader, order))
    answer(as_json, {"added": names}, names)


@cameras.command(epilog=examples("capture-app cameras remove cam0"))
@click.argument("name")
@leader_option
@json_option
def remove(name: str, leader: Address, as_json: bool) -> None:
    """Stop the camera NAME of the leader's machine, disconnect a phone, or remove a lost camera."""
    from capture_app.protocol.orders import RemoveCamera
    from capture_app.rig.rig_link import give_order

    asyncio.run(give_order(leader, RemoveCamera(name=(own := _name_of(leader, name)))))
    answer(as_json, {"removed": own}, said=f"removed {name}")


@cameras.command(epilog=examples("capture-app cameras show cam0"))
@click.argument("name")
@leader_option
@json_option
def show(name: str, leader: Address, as_json: bool) -> None:
    """Show the camera NAME of a rig: frame rate, exposure, clock exchanges, phase errors, its log.

    With --json also the latest exchanges and errors one by one.
    """
    from capture_app.protocol.orders import DetailRequest
    from capture_app.protocol.status import NodeDetail
    from capture_app.rig.rig_link import ask_leader

    detail = asyncio.run(ask_leader(leader, DetailRequest(camera=_name_of(leader, name)), NodeDetail))
    answer(as_json, detail, [table((name, ""), _facts(detail)), *(line.text for line in detail.log[-20:])])


def _facts(detail: "NodeDetail") -> list[tuple[str, ...]]:
    return render_rows("camera.txt", __package__, detail=detail, megabytes=megabytes)
