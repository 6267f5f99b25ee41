"""`capture-app doctor`: look this machine over, and say what repairs what is found."""

import asyncio
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from capture_app.commands.options import ADDRESS, open_option, spool_option
from capture_app.errors import SimulshotError
from capture_app.net.address import Address
from capture_app.terminal import answer, json_option, talk
from capture_app.text import count
from capture_app.usage import examples

if TYPE_CHECKING:
    from capture_app.doctor import Finding


@click.command(
    epilog=examples(
        "capture-app doctor", "capture-app doctor --leader 192.168.1.20", "capture-app doctor --json"
    )
)
@click.option(
    "--leader",
    "leaders",
    type=ADDRESS,
    multiple=True,
    metavar="HOST:PORT",
    help="A leader or relay that this machine is to reach. Repeatable.",
)
@spool_option
@open_option
@json_option
def doctor(leaders: tuple[Address, ...], spool: Path, as_json: bool) -> None:
    """Look this machine over: what would keep it from leading a rig or joining one, and what repairs it.

    Run it on the leader's machine or on a camera's. It looks at versions, the way to the leader, pairing,
    firewalls, WiFi, the clock, disks, USB and permissions, and changes nothing. A problem ends it with
    exit code 1.
    """
    from capture_app.doctor import examine
    from capture_app.rig_process import list_rigs

    rigs = [(rig.address, Path(rig.sessions)) for rig in list_rigs()]
    if not as_json:
        talk("looking this machine over …")
    found = asyncio.run(examine(leaders, rigs, spool))
    problems = [finding for finding in found if finding.grade == "problem"]
    answer(as_json, {"findings": found, "problems": len(problems)}, _lines(found))
    if problems:
        raise SimulshotError(f"{count(len(problems), 'problem')} found", hint="with its remedy below each")


def _lines(found: "Sequence[Finding]") -> Iterator[str]:
    for finding in found:
        yield f"{finding.grade:7}  {finding.check:9}  {finding.text}"
        if finding.remedy:
            yield f"{'':20}→ {finding.remedy}"
