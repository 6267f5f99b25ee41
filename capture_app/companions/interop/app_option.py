"""Option `--android-app` of a leader: phones with the app libsoftwaresync or RecSync follow the rig."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from capture_app.console.terminal import talk

if TYPE_CHECKING:
    from capture_app.node.followers import Follower


AT = ("leader",)
OPTIONS = (
    click.option(
        "--android-app",
        is_flag=True,
        help="Also lead phones with the app libsoftwaresync or RecSync, whose protocol has no security."
        " Without --fps all cameras use the app's rate and phase.",
    ),
)


def make_followers(host: str, values: Mapping[str, Any], *, leads: bool) -> "Sequence[Follower]":
    """Make the follower of this option, and warn of what it opens."""
    if not values["android_app"]:
        return ()
    talk(
        "ANDROID APP: phones with libsoftwaresync or RecSync join by UDP 8244 and 9428 in a WiFi whose"
        " hotspot is this machine. There is no pairing: anyone in that WiFi can control those phones"
    )
    from capture_app.companions.interop.app_phones import AppPhones

    return (AppPhones(host, aligns=leads),)
