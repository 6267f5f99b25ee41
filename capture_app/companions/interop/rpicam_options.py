"""Options `--rpicam-sync` of a leader and a relay: rpicam-apps that follow the rig's grid."""

import socket
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from capture_app.common.errors import BadInputError

if TYPE_CHECKING:
    from capture_app.node.followers import Follower

AT = ("leader", "relay")
OPTIONS = (
    click.option(
        "--rpicam-sync",
        "rpicam_hosts",
        multiple=True,
        metavar="HOST|all",
        help="Let rpicam-apps with --sync client follow the rig: on HOST, or on all hosts here. They use"
        " this machine's wall clock and trust any sender. Repeatable.",
    ),
    click.option(
        "--rpicam-shutter-us",
        type=click.FloatRange(0.0, 1e6),
        default=0.0,
        metavar="US",
        help="With --rpicam-sync: --shutter of those Pis, which stamp frames at its end.",
    ),
)


def make_followers(host: str, values: Mapping[str, Any], *, leads: bool) -> "Sequence[Follower]":
    """Make the followers of these options. Raises BadInputError for a host without an IPv4 address."""
    hosts, shutter_us = values["rpicam_hosts"], values["rpicam_shutter_us"]
    if not hosts:
        return ()
    from capture_app.companions.interop.rpicam import RpicamSync

    try:
        addresses = [socket.gethostbyname(host) for host in hosts if host != "all"]
    except (OSError, UnicodeError) as error:
        raise BadInputError(f"--rpicam-sync: no IPv4 address: {error}", hint="give a host, or all") from None
    return (RpicamSync(addresses, to_all="all" in hosts, shutter_ns=round(shutter_us * 1000)),)
