"""`capture-app cameras controls`, `set` and `match`: exposure, gain, white balance and focus of a rig."""

import asyncio
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from capture_app.camera_controls import Control, ControlValue, describe
from capture_app.commands.options import leader_option
from capture_app.errors import BadInputError
from capture_app.net.address import Address
from capture_app.terminal import json_option, print_json, print_table, talk
from capture_app.usage import examples

if TYPE_CHECKING:
    from capture_app.node.operator.camera_controls import ControlledCamera

NAMES = tuple(str(control) for control in Control)


@click.command(epilog=examples("capture-app cameras controls"))
@leader_option
@json_option
def controls(leader: Address, as_json: bool) -> None:
    """Show exposure, gain, white balance and focus of all cameras of a rig."""
    from capture_app.node.operator.camera_controls import read_all

    _show(asyncio.run(read_all(leader)), as_json)


@click.command(
    "set",
    epilog=examples(
        "capture-app cameras set exposure=4000 gain=2 --camera cam1",
        "capture-app cameras set exposure=auto white-balance=auto",
    ),
)
@click.argument("values", nargs=-1, required=True, metavar="CONTROL=VALUE...")
@click.option("--camera", "cameras", multiple=True, metavar="NAME", help="Of this camera. Repeatable.")
@leader_option
@json_option
def set_command(values: tuple[str, ...], cameras: tuple[str, ...], leader: Address, as_json: bool) -> None:
    """Set controls of cameras of a rig, of all without --camera.

    CONTROL is exposure (in µs), gain, white-balance (in K) or focus; VALUE a number in the camera's unit, as
    shown by `cameras controls`, auto to let the camera choose, or hold to keep what it has chosen.
    """
    from capture_app.node.operator.camera_controls import set_cameras

    wanted = dict(_wanted(value) for value in values)
    _show(asyncio.run(set_cameras(leader, wanted, cameras)), as_json)


@click.command(
    epilog=examples("capture-app cameras match cam1", "capture-app cameras match cam1 --only exposure")
)
@click.argument("camera")
@click.option(
    "--only",
    "only",
    multiple=True,
    type=click.Choice(NAMES),
    show_default="all of them",
    help="Only this control. Repeatable.",
)
@leader_option
@json_option
def match(camera: str, only: tuple[str, ...], leader: Address, as_json: bool) -> None:
    """Set all cameras of a rig like CAMERA: hold what it has chosen, and set that on all that can.

    What a camera cannot be set to is said with its reason.
    """
    from capture_app.node.operator.camera_controls import match_cameras

    chosen = [Control(name) for name in only] or list(Control)
    _show(asyncio.run(match_cameras(leader, camera, chosen)), as_json)


def _wanted(text: str) -> tuple[Control, ControlValue]:
    name, _, value = text.partition("=")
    if name not in NAMES:
        raise BadInputError(f"{text!r} is not CONTROL=VALUE", hint=f"CONTROL is one of {', '.join(NAMES)}")
    if value == "auto":
        return Control(name), "auto"
    if value == "hold":
        return Control(name), "hold"
    try:
        number = float(value)
        round(number)  # neither infinite nor NaN
    except (ValueError, OverflowError):
        raise BadInputError(
            f"{name}={value}: no number, auto or hold", hint="example: exposure=4000"
        ) from None
    return Control(name), number


def _show(found: "Sequence[ControlledCamera]", as_json: bool) -> None:
    if as_json:
        print_json({"cameras": found})
        return
    if not found:
        talk("no camera is here")
        return
    rows: list[tuple[Any, ...]] = [
        (one.camera, *(describe(one.state.state(control)) for control in Control)) for one in found
    ]
    print_table(("camera", *NAMES), rows)
    for one in found:
        for problem in dict.fromkeys(one.state.problems.values()):
            talk(f"{one.camera}: {problem}")
