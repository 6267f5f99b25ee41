"""`capture-app node`: one camera that joins a leader and stays in step with the others."""

import re
import socket
from pathlib import Path

import click

from capture_app.commands.options import clock_option, leaders_option, run_until_stopped, spool_option, talk
from capture_app.net.address import Address

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


def host_name() -> str:
    """Return this host's name as that of a node."""
    name = re.sub(r"[^A-Za-z0-9_.-]+", "-", socket.gethostname().split(".")[0]).lstrip("_.-")
    return name[:64] or "node"


def check_name(ctx: click.Context, param: click.Parameter, value: str) -> str:
    """Check a node's name, which becomes that of a folder."""
    if not _NAME.fullmatch(value):
        raise click.BadParameter(
            f"{value!r} is no name for a node: letters, digits, '_', '.' and '-', at most 64, a letter or "
            "digit first"
        )
    return value


@click.command()
@click.option(
    "--name", default=host_name, callback=check_name, help="Name of this node.  [default: this host's name]"
)
@click.option(
    "--camera", "spec", required=True, metavar="SPEC", help="The camera, as `capture-app cameras` lists it."
)
@leaders_option
@clock_option
@click.option(
    "--tolerance-us",
    type=click.FloatRange(1.0, 100_000.0),
    help="Largest phase error that is left alone, in microseconds.  [default: 100; 2000 for a camera that "
    "can only restart its stream]",
)
@spool_option
@click.option("--until-eof", is_flag=True, hidden=True, help="Stop when stdin closes: the parent is gone.")
def node(
    name: str,
    spec: str,
    leaders: tuple[Address, ...],
    clock_text: str,
    tolerance_us: float | None,
    spool: Path,
    until_eof: bool,
) -> None:
    """Run one camera until Ctrl-C; a leader that is not there yet, or goes away, is waited for.

    The leader may be a relay. With several --leader of one rig, leaders or relays, the next one is asked when
    one is gone.
    """
    from capture_app.cameras.catalog import open_camera, parse_spec
    from capture_app.clock import parse_clock
    from capture_app.node.camera.client import ClientNode
    from capture_app.node.camera.device_profiles import DeviceProfiles, data_folder

    parse_spec(spec)
    clock = parse_clock(clock_text, node=name)
    client = ClientNode(
        name=name,
        open_camera=lambda: open_camera(spec, clock=clock, name=name),
        leader=leaders[0],
        others=leaders[1:],
        clock=clock,
        tolerance_ns=None if tolerance_us is None else round(tolerance_us * 1000),
        talk=lambda line: talk(f"{name}: {line}"),
        spool=spool,
        profiles=DeviceProfiles(data_folder()),
    )
    run_until_stopped(client.run(), until_eof=until_eof)
