"""Taking pictures from the command line: `capture-app burst` and `record` print what `rig/taking.py` does."""

import asyncio
import re
from collections.abc import AsyncGenerator
from contextlib import aclosing, nullcontext
from typing import TYPE_CHECKING, Any

import click
from msgspec.structs import asdict

from capture_app.commands.shared_options import leader_option, together
from capture_app.common import system
from capture_app.common.address import Address
from capture_app.common.errors import IncompleteError, NoCameraHereError
from capture_app.common.take_limits import LIMITS
from capture_app.common.tasks import end
from capture_app.common.text import count
from capture_app.console.option_rules import Rule, RuledCommand
from capture_app.console.terminal import FiniteRange, answer, json_option, print_json, print_line, talk
from capture_app.console.usage import examples

if TYPE_CHECKING:
    from capture_app.rig.rig_link import RigLink
    from capture_app.rig.taking import Failed, Progress, Saved, TakeEvent, TakePlan, Taking
    from capture_app.session.reading.verdict import Verdict

    TakeEnd = Progress | Saved | Failed

_FIGURE = re.compile(r"\d[\d.]* (ns|µs|ms|s)\b|--tolerance-us \d+")


def _limited(field: str) -> click.IntRange | click.FloatRange:
    low, high = LIMITS[field]
    return click.IntRange(int(low), high) if isinstance(high, int) else FiniteRange(low, high)


ready_options = together(
    click.option(
        "--wait-s",
        "wait_ready_s",
        type=_limited("wait_ready_s"),
        default=0.0,
        metavar="S",
        help="Wait up to this long until all nodes are ready.",
    ),
    click.option(
        "--min-nodes",
        "nodes",
        type=_limited("nodes"),
        metavar="N",
        default=1,
        help="With --wait-s: wait until at least this many nodes are ready.",
    ),
)
"""The options --wait-s and --min-nodes of a command that takes a burst."""


async def _reported(taking: "Taking", leader: Address) -> "AsyncGenerator[TakeEvent, None]":
    """Yield the events of a take, and report them on stderr."""
    from capture_app.rig.taking import Failed, Progress, Waiting

    reported: dict[int, tuple[str, str, float]] = {}
    async with aclosing(aiter(taking)) as events:
        async for event in events:
            line, message, is_running = _line_of(event, taking.plan), "", False
            if isinstance(event, Failed) and isinstance(event.error, NoCameraHereError):
                event.error.hint = f"start one with: capture-app node --leader {leader} --camera SPEC"
            if isinstance(event, Progress):
                message, is_running = event.status.message, not event.status.done
            # A small change of a figure while the rig becomes ready is not worth a line.
            gist = _FIGURE.sub("", line) if isinstance(event, Waiting) else line
            last, last_message, at_s = reported.get(event.number, ("", "", 0.0))
            # Progress alone is reported once a second.
            too_soon = is_running and message == last_message and system.monotonic_s() < at_s + 1.0
            if line and gist != last and not too_soon:
                reported[event.number] = (gist, message, system.monotonic_s())
                talk(line)
            yield event


def _line_of(event: "TakeEvent", plan: "TakePlan") -> str:
    from capture_app.protocol.event_text import burst_line
    from capture_app.rig import taking

    match event:
        case taking.Countdown(number, seconds) if seconds < plan.countdown_s + 1:
            return f"take {number} of {plan.repeat} in {seconds} s"
        case taking.Moved(camera=camera):
            return f"something moves in front of {camera}"
        case taking.Waiting(reason=reason):
            return reason
        case taking.Progress(status=status):
            return burst_line(status)
    return ""


async def take(
    link: "RigLink", plan: "TakePlan", ended: "list[TakeEnd]", *, silent: bool, detach: bool = False
) -> None:
    """Run a take plan, report its progress on stderr, and append the last event of each take to `ended`.

    Each session and its verdict are printed, unless `silent`. With `detach` it returns when the take has
    begun. The first Ctrl-C ends a recording; the second stops waiting until it is saved.
    """
    from capture_app.rig import taking

    series, endings = taking.Taking(link, plan), list[asyncio.Task[None]]()

    def interrupt() -> None:
        if endings or series.is_open:
            raise KeyboardInterrupt
        talk("stopping; press Ctrl-C again to leave before it is saved")
        endings.append(loop.create_task(series.end()))

    loop = asyncio.get_running_loop()
    try:
        with system.on_interrupt(interrupt) if plan.video else nullcontext():
            async with aclosing(_reported(series, link.leader)) as events:
                async for event in events:
                    match event:
                        case taking.Saved() | taking.Failed():
                            ended.append(event)
                            if not silent:
                                _print_take(event)
                        case taking.Progress(status=status) if detach and not status.done:
                            ended.append(event)
                            return
    finally:
        await end(*endings)


def _print_take(ended: "TakeEnd") -> None:
    """Print the session's path and its verdict."""
    if ended.status is not None and ended.status.session is not None:
        print_line(ended.status.session)
    if (verdict := _verdict_of(ended)) is not None:
        talk(f"{verdict.headline}; spread {verdict.spread}")
        if verdict.stamps:
            talk(verdict.stamps)


def _verdict_of(ended: "TakeEnd") -> "Verdict | None":
    return getattr(ended, "verdict", None)


def _records(ended: "list[TakeEnd]") -> list[dict[str, Any]]:
    """Return the JSON records of those ended takes that had begun at the leader."""
    return [
        {**asdict(ending.status), "verdict": _verdict_of(ending)}
        for ending in ended
        if ending.status is not None
    ]


def require_whole(ended: "TakeEnd", max_missing_pct: float = 0.0) -> None:
    """Raise the error of a failed take, and IncompleteError if more than this percentage is missing."""
    from capture_app.rig.taking import Failed

    if isinstance(ended, Failed):
        raise ended.error
    status = ended.status
    missing = status.expected - status.received
    if missing > max_missing_pct / 100 * status.expected:
        # A verdict is printed already, and says why.
        why = f"; {status.message}" if status.message and _verdict_of(ended) is None else ""
        raise IncompleteError(
            f"{status.name} is incomplete: {missing} of {count(status.expected, 'image')} missing{why}",
            hint="images that nodes still have are added when they connect: capture-app sessions list",
        )
    if missing:
        talk(f"{missing} of {count(status.expected, 'frame')} missing; {max_missing_pct:g} % are accepted")


@click.command(
    cls=RuledCommand,
    rules=(
        Rule("--every", "--repeat"),
        Rule("--spacing", "!--interval-s"),
        Rule("--min-nodes", "--wait-s"),
        Rule(
            "--frames --spacing --interval-s --spare --before --name --repeat --every --on-motion --wait-s "
            "--min-nodes",
            "!--cancel",
        ),
    ),
    epilog=examples(
        "capture-app burst",
        "capture-app burst --frames 30 --name jump --wait-s 20",
        "capture-app burst --frames 360 --interval-s 10 --name clouds",
        "capture-app burst --leader 192.168.1.20 --repeat 10 --every 60 --json",
        "capture-app burst --on-motion --frames 30 --before 15 --repeat 100 --every 20 --name deer",
    ),
)
@leader_option
@click.option(
    "--frames",
    type=_limited("frames"),
    metavar="N",
    default=5,
    help="Number of frames from each camera.",
)
@click.option("--spacing", type=_limited("spacing"), metavar="N", default=1, help="Take every Nth frame.")
@click.option(
    "--interval-s",
    type=_limited("interval_s"),
    metavar="S",
    show_default="by --spacing",
    help="Time between frames, for a time-lapse.",
)
@click.option(
    "--spare",
    type=_limited("spare"),
    metavar="N",
    show_default="as many as frames, at least 4; none in a burst of over 2 s",
    help="Replace up to N instants (common times of all cameras) whose frame a camera dropped by later ones.",
)
@click.option(
    "--before",
    type=_limited("before"),
    metavar="N",
    default=0,
    help="Number of frames from before this command, out of the ring buffer.",
)
@click.option("--name", default="", show_default="burst", help="Name of the take: its session is NAME-001.")
@click.option("--repeat", type=_limited("repeat"), metavar="N", default=1, help="Number of bursts to take.")
@click.option(
    "--every",
    "every_s",
    type=_limited("every_s"),
    metavar="S",
    show_default="when the last one is saved",
    help="With --repeat: time between bursts.",
)
@click.option(
    "--on-motion",
    is_flag=True,
    help="Take each burst when something moves in front of a camera, at most one every --every seconds.",
)
@click.option(
    "--cancel", type=click.IntRange(1), metavar="BURST", help="Cancel the burst of this number instead."
)
@ready_options
@json_option
def burst(
    leader: Address,
    on_motion: bool,
    cancel: int | None,
    as_json: bool,
    **chosen: Any,
) -> None:
    """Take a burst and print the path of its session, which is on the leader's machine.

    A burst of more than two seconds is saved while it is taken, without replacing dropped frames. With
    --repeat each path is printed when its burst is saved; with --json all at the end.
    """
    from capture_app.protocol.orders import CancelBurst
    from capture_app.rig.rig_link import RigLink, give_order
    from capture_app.rig.taking import TakePlan

    if cancel is not None:
        asyncio.run(give_order(leader, CancelBurst(burst=cancel)))
        said = f"burst {cancel} is cancelled; images received so far are saved"
        answer(as_json, {"cancelled": cancel}, said=said)
        return
    plan = TakePlan(**chosen, on_motion=(0.0, 0.0, 1.0, 1.0) if on_motion else None)
    ended: list[TakeEnd] = []
    try:
        asyncio.run(take(RigLink(leader), plan, ended, silent=as_json))
    finally:
        if as_json and (records := _records(ended)):
            print_json(records[0] if plan.repeat == 1 else {"bursts": records})
    for ending in ended:
        require_whole(ending)


@click.command(
    cls=RuledCommand,
    rules=(
        Rule("--min-nodes", "--wait-s"),
        Rule("--max-missing", "!--detach", ": it returns before a frame can be missing"),
        Rule("--seconds --fps --name --max-missing --detach --wait-s --min-nodes", "!--stop"),
    ),
    epilog=examples(
        "capture-app record --seconds 20",
        "capture-app record --name dance",
        "capture-app record --detach",
        "capture-app record --stop",
        "capture-app record --fps 0.1 --seconds 3600 --name clouds",
    ),
)
@leader_option
@click.option(
    "--seconds",
    type=_limited("seconds"),
    metavar="S",
    show_default="until Ctrl-C or --stop",
    help="Length of the recording.",
)
@click.option(
    "--fps",
    type=FiniteRange(0.00001, 10_000.0),
    metavar="N",
    show_default="the rig's",
    help="Frames per second: the rig's rate divided by a whole number; below 1 for a time-lapse.",
)
@click.option("--name", default="", show_default="recording", help="Its session is NAME-001.")
@click.option(
    "--max-missing",
    "max_missing_pct",
    type=FiniteRange(0, 100),
    metavar="PERCENT",
    default=1.0,
    help="Accepted share of missing frames; beyond it the exit code is 7.",
)
@click.option("--detach", is_flag=True, help="Return as soon as the recording has begun.")
@click.option("--stop", is_flag=True, help="Stop the newest recording or long burst instead.")
@ready_options
@json_option
def record(
    leader: Address,
    fps: float | None,
    max_missing_pct: float,
    detach: bool,
    stop: bool,
    as_json: bool,
    **chosen: Any,
) -> None:
    """Record a video with every camera, and print the path of its session on the leader's machine.

    Frames are saved as they arrive, each with its own time; dropped frames are counted.
    """
    from capture_app.protocol.orders import EndBurst
    from capture_app.rig.rig_link import RigLink, give_order
    from capture_app.rig.taking import Progress, TakePlan

    if stop:
        asyncio.run(give_order(leader, EndBurst()))
        answer(as_json, {"stopped": True}, said="the recording ends")
        return
    plan = TakePlan(interval_s=None if fps is None else 1 / fps, video=True, **chosen)
    ended: list[TakeEnd] = []
    asyncio.run(take(RigLink(leader), plan, ended, silent=as_json, detach=detach))
    begun = isinstance(ended[0], Progress)
    if records := _records(ended):
        goes_on = f"recording {records[0]['burst']} continues; stop it: capture-app record --stop"
        answer(as_json, records[0], said=goes_on if begun else "")
    if not begun:
        require_whole(ended[0], max_missing_pct)
