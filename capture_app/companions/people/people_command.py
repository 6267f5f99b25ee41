"""`capture-app people`: people in 3D while they move, as lines, JSON, OSC and LSL."""

from collections import deque
from contextlib import ExitStack, suppress

import click

from capture_app.commands.shared_options import ADDRESS, leader_option, run_until_stopped
from capture_app.common import system
from capture_app.common.address import Address
from capture_app.common.errors import IncompleteError
from capture_app.common.text import count
from capture_app.companions.people.people_streams import LslStream, OscStream, PeopleStream
from capture_app.console.terminal import FiniteRange, json_option, print_json_line, print_line
from capture_app.console.usage import examples
from capture_app.session.format.live_pictures import PeoplePreview

LINE_EVERY_S = 1.0


@click.command(
    short_help="Locate people in 3D while they move; for OSC and LSL, too.",
    epilog=examples(
        "capture-app people", "capture-app people --osc 127.0.0.1:9000", "capture-app people --lsl --json"
    ),
)
@click.argument("session", nargs=-1, metavar="")
@click.option("--osc", type=ADDRESS, metavar="HOST:PORT", help="Send each joint to this address, by OSC.")
@click.option("--lsl", is_flag=True, help="Stream each person to the Lab Streaming Layer.")
@click.option(
    "--for-s",
    type=FiniteRange(1.0, 86_400.0),
    metavar="S",
    show_default="until Ctrl-C",
    help="Stop after this time.",
)
@leader_option
@json_option
def people(
    session: tuple[str, ...],
    osc: Address | None,
    lsl: bool,
    for_s: float | None,
    leader: Address,
    as_json: bool,
) -> None:
    """Locate the joints of people by a calibrated rig's previews, with their 95 % errors. Saves nothing.

    Prints how many people there are, how many instants a second, and how late; with --json everything, a line
    for each instant. For files, take a burst or a recording, and run `reconstruct people`.
    """
    if session:
        raise click.UsageError("it looks at a running rig; people of a session: reconstruct people SESSION")
    streams: list[PeopleStream] = [OscStream(osc)] if osc else []
    streams += [LslStream()] if lsl else []
    with ExitStack() as open_streams:
        for stream in streams:
            open_streams.callback(stream.close)
        run_until_stopped(_run(leader, streams, for_s, as_json))


async def _run(leader: Address, streams: list[PeopleStream], for_s: float | None, as_json: bool) -> None:
    import asyncio
    from contextlib import aclosing

    from capture_app.rig.live_pictures import live_people
    from capture_app.rig.rig_link import RigLink, ask_status

    rig = await ask_status(leader)
    titles = rig.titles
    if len(rig.cameras) < 2:
        raise IncompleteError(
            f"{leader} has {count(len(rig.cameras), 'camera')}: a joint in 3D needs two",
            hint="start nodes first: capture-app node",
        )
    said: deque[float] = deque(maxlen=30)
    due_s, before = -1e9, ""
    with suppress(TimeoutError):
        async with (
            asyncio.timeout(for_s),
            aclosing(live_people(RigLink(leader), rig, lambda: "")) as found,
        ):
            async for instant in found:
                now_s = system.monotonic_s()
                said.append(now_s)
                for stream in () if instant.problem else streams:
                    stream.send(instant)
                if as_json:
                    print_json_line(facts_of(instant))
                elif now_s - due_s >= LINE_EVERY_S and (line := instant.described(said, titles)) != before:
                    print_line(line)
                    due_s, before = now_s, line


def facts_of(found: PeoplePreview) -> dict[str, object]:
    """Return what is printed as JSON."""
    return {
        "leader_ns": found.instant_ns,
        "late_ns": found.late_ns,
        "people": {person.number: person.joints for person in found.people},
        "unit": found.unit,
        "absent": found.absent,
        "problem": found.problem,
    }
