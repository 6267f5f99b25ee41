"""Option `--lsl` of a leader: the times of all saved frames as a stream of the Lab Streaming Layer."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from capture_app.console.terminal import talk

if TYPE_CHECKING:
    from capture_app.node.followers import Follower


OPTIONS = (
    click.option(
        "--lsl",
        is_flag=True,
        help="Stream the time of each saved frame and its error to the Lab Streaming Layer (LabRecorder), as"
        " the stream 'simulshot frames'.",
    ),
)


def make_followers(values: Mapping[str, Any]) -> "Sequence[Follower]":
    """Make the follower of this option, and warn of what it opens. Raises NotAvailableError without pylsl."""
    if not values["lsl"]:
        return ()
    talk(
        "LSL: this machine streams frame times in the network. The Lab Streaming Layer has no pairing:"
        " anyone there can read them, and nobody can change anything by it"
    )
    from capture_app.companions.sensors.lsl_frames import LslFrames

    return (LslFrames(),)
