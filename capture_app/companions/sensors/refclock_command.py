"""`capture-app refclock`: a reference clock for chrony, so that this machine runs on the rig's time."""

from pathlib import Path

import click

from capture_app.commands.shared_options import leader_option, run_until_stopped
from capture_app.common.address import Address
from capture_app.console.terminal import talk
from capture_app.console.usage import examples

DEFAULT_SOCKET = "/run/chrony/simulshot.sock"


@click.command(
    short_help="Set this machine's clock by the rig, through chrony.",
    epilog=examples(
        "capture-app refclock --leader 192.168.1.20",
        f"capture-app refclock --leader 192.168.1.20 {DEFAULT_SOCKET}",
    ),
)
@click.argument("socket", type=click.Path(path_type=Path), default=Path(DEFAULT_SOCKET))
@leader_option
def refclock(socket: Path, leader: Address) -> None:
    """Send the rig's time to chronyd's SOCKET once a second, until Ctrl-C.

    chronyd then steers this machine's clock to the wall clock of the leader's machine. Add this to
    chrony.conf, and restart chronyd: refclock SOCK /run/chrony/simulshot.sock refid RIG
    """
    from capture_app.companions.sensors.refclock import feed_chrony

    talk(f"sending the time of the rig at {leader} to {socket}; see it by: chronyc sources; Ctrl-C stops")
    run_until_stopped(feed_chrony(leader, socket))
