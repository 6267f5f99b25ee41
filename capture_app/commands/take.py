"""What `burst` and `record` share: they wait for the rig, follow a take until it is saved, and judge it.

`capture-app burst`: take a burst with a running leader and wait for its session.

`capture-app record`: a synchronized video of every camera, with a time for every frame.
"""

import asyncio
import re
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from msgspec.structs import asdict, replace

from capture_app.commands.options import leader_option
from capture_app.common.address import Address
from capture_app.common.errors import (
    IncompleteError,
    NetworkError,
    NoCameraHereError,
    SimulshotError,
    ungrouped_errors,
)
from capture_app.common.tasks import end
from capture_app.common.text import count
from capture_app.console.terminal import FiniteRange, answer, json_option, print_json, print_line, talk
from capture_app.console.usage import examples

if TYPE_CHECKING:
    from capture_app.protocol.messages import BurstRequest
    from capture_app.protocol.status import BurstStatus
    from capture_app.session.reading.verdict import Verdict

F = TypeVar("F", bound=Callable[..., Any])
SAID_EVERY_S = 1.0
"""How far a take is that goes on for long is said no more often."""
_FIGURE = re.compile(r"\d[\d.]* (ns|µs|ms|s)\b|--tolerance-us \d+")

_wait_option = click.option(
    "--wait-s",
    "wait_ready_s",
    type=FiniteRange(0.0, 3600.0),
    default=0.0,
    metavar="S",
    help="Wait up to this long until all nodes are ready.",
)
_nodes_option = click.option(
    "--min-nodes",
    "nodes",
    type=click.IntRange(1),
    metavar="N",
    default=1,
    help="With --wait-s: wait until at least this many nodes are ready.",
)


def ready_options(command: F) -> F:
    """Give a command that takes something the options --wait-s and --min-nodes."""
    return _wait_option(_nodes_option(command))


async def take_burst(
    leader: Address, request: "BurstRequest", on_status: Callable[["BurstStatus"], None] = lambda _: None
) -> "BurstStatus":
    """Take a burst or a recording, tell on stderr how far it is, and return how it ended.

    Raises NetworkError, and the leader's own errors.
    """
    from capture_app.protocol.news import burst_line
    from capture_app.rig.link import ask_burst

    last, said, counted_s = None, "", 0.0
    try:
        async for last in ask_burst(leader, request):
            on_status(last)
            line = burst_line(last)
            # A figure that changes a little while the rig is waited for is no news.
            gist = line if last.burst else _FIGURE.sub("", line)
            waits = last.burst and not last.done and time.monotonic() < counted_s + SAID_EVERY_S
            if gist != said and not waits:
                said, counted_s = gist, time.monotonic()
                talk(line)
    except NoCameraHereError as error:
        hint = f"start one with: capture-app node --leader {leader} --camera SPEC"
        raise NoCameraHereError(error.what, hint=hint) from error
    if last is None:
        raise NetworkError(f"the leader at {leader} did not take the burst")
    return last


def show_take(done: "BurstStatus", as_json: bool) -> dict[str, Any]:
    """Print the path of the session of a take that is over and how good it is, and return its JSON record.

    With `as_json` nothing is printed: that is left to the caller, who may have several.
    """
    verdict = _judge_if_here(done)
    if not as_json and done.session is not None:
        print_line(done.session)
        if verdict is not None:
            talk(f"{verdict.headline}; spread {verdict.spread}")
            if verdict.stamps:
                talk(verdict.stamps)
    return {**asdict(done), "verdict": verdict}


def require_whole(kind: str, done: "BurstStatus", most_missing_pct: float = 0.0) -> None:
    """Raise IncompleteError where more of a take is missing than that share, or there is no session.

    One without a number was taken by phones of their own app, which keep what they took.
    """
    if done.done and not done.burst:
        return
    missing = done.expected - done.received
    if done.session is None or missing > most_missing_pct / 100 * done.expected:
        raise IncompleteError(f"{kind} {done.burst} is incomplete: {done.message}")
    if missing:
        talk(
            f"{missing} of {count(done.expected, 'frame')} missing, at most {most_missing_pct:g} % asked for"
        )


def _judge_if_here(done: "BurstStatus") -> "Verdict | None":
    """The verdict where the session is on this machine: a leader elsewhere saves it there."""
    from capture_app.session.reading.reader import Session
    from capture_app.session.reading.verdict import judge

    try:
        return None if done.session is None else judge(Session.open(Path(done.session)).manifest)
    except SimulshotError:
        return None


MOST_FRAMES = 100_000


@click.command(
    epilog=examples(
        "capture-app burst",
        "capture-app burst --frames 30 --name jump --wait-s 20",
        "capture-app burst --frames 360 --interval-s 10 --name clouds",
        "capture-app burst --leader 192.168.1.20 --repeat 10 --every 60 --json",
        "capture-app burst --on-motion --frames 30 --before 15 --repeat 100 --every 20 --name deer",
    )
)
@leader_option
@click.option(
    "--frames",
    type=click.IntRange(1, MOST_FRAMES),
    metavar="N",
    default=5,
    help="Number of frames from each camera.",
)
@click.option(
    "--spacing", type=click.IntRange(1, 1_000_000), metavar="N", default=1, help="Take every Nth frame."
)
@click.option(
    "--interval-s",
    type=FiniteRange(0.001, 86_400.0),
    metavar="S",
    show_default="that of --spacing",
    help="Seconds from one frame to the next: a time-lapse.",
)
@click.option(
    "--spare",
    type=click.IntRange(0, 999),
    metavar="N",
    show_default="as many as frames, at least 4; none in a burst of over 2 s",
    help="Skip up to this many instants of which some camera dropped its frame, and take later ones.",
)
@click.option(
    "--consecutive",
    is_flag=True,
    help="Skip none: a frame that a camera dropped is missing, and the burst incomplete.",
)
@click.option(
    "--at-ns",
    "at_leader_ns",
    type=int,
    metavar="NS",
    show_default="now",
    help="Time of the first frame by the leader's clock; may be in the recent past.",
)
@click.option(
    "--before",
    type=click.IntRange(0, 1000),
    metavar="N",
    default=0,
    help="So many of the frames come from before this command.",
)
@click.option("--name", default="", show_default="burst", help="Name of the take: its session is NAME-001.")
@click.option("--note", default="", show_default=False, help="A line of text saved with the session.")
@click.option(
    "--repeat", type=click.IntRange(1, 10_000), metavar="N", default=1, help="Number of bursts to take."
)
@click.option(
    "--every",
    "every_s",
    type=FiniteRange(0.0, 86_400.0),
    metavar="S",
    show_default="as soon as the last is saved",
    help="With --repeat: seconds from one burst to the next.",
)
@click.option(
    "--on-motion",
    is_flag=True,
    help="Take each burst when something moves before a camera, at most one each --every seconds.",
)
@click.option(
    "--region",
    type=(FiniteRange(0, 1),) * 4,
    metavar="LEFT TOP RIGHT BOTTOM",
    default=(0.0, 0.0, 1.0, 1.0),
    show_default="the whole picture",
    help="With --on-motion: where, as shares of the picture.",
)
@click.option(
    "--cancel", type=click.IntRange(1), metavar="BURST", help="Cancel the burst of this number instead."
)
@ready_options
@json_option
def burst(
    leader: Address,
    consecutive: bool,
    repeat: int,
    every_s: float | None,
    on_motion: bool,
    region: tuple[float, float, float, float],
    cancel: int | None,
    as_json: bool,
    **chosen: Any,
) -> None:
    """Take a burst and print the path of its session, which is on the leader's machine.

    A burst of more than two seconds is saved while it is taken, with every instant: what a camera drops is
    missing. With --repeat take several, and print each path when it is saved; with --json all of them at the
    end.
    """
    from capture_app.protocol.messages import BurstRequest

    if cancel is not None:
        _cancel(leader, cancel, as_json)
        return
    request = BurstRequest(**chosen)
    if request.at_leader_ns is not None and repeat > 1:
        raise click.UsageError("--at-ns is for one burst, not with --repeat")
    if consecutive and request.spare:
        raise click.UsageError("--consecutive skips nothing: leave out --spare")
    if consecutive:
        request = replace(request, spare=0)
    results: list[dict[str, Any]] = []

    def show(done: "BurstStatus") -> None:
        results.append(show_take(done, as_json))

    if on_motion and request.at_leader_ns is not None:
        raise click.UsageError("--at-ns is not with --on-motion")
    if not (region[0] < region[2] and region[1] < region[3]):
        raise click.UsageError("--region is LEFT TOP RIGHT BOTTOM, as shares: 0.5 0 1 1 is the right half")
    try:
        taking = (
            _take_on_motion(leader, request, repeat, every_s or 0.0, region, show)
            if on_motion
            else _take_bursts(leader, request, repeat, every_s, show)
        )
        bursts = asyncio.run(taking)
    finally:
        if as_json and results:
            print_json(results[0] if repeat == 1 else {"bursts": results})
    for done in bursts:
        require_whole("burst", done)


def _cancel(leader: Address, number: int, as_json: bool) -> None:
    from capture_app.protocol.orders import CancelBurst
    from capture_app.rig.link import give_order

    asyncio.run(give_order(leader, CancelBurst(burst=number)))
    told = f"burst {number} is cancelled; what had come is saved"
    answer(as_json, {"cancelled": number}, said=told)


async def _take_bursts(
    leader: Address,
    request: "BurstRequest",
    repeat: int,
    every_s: float | None,
    show: Callable[["BurstStatus"], None],
) -> list["BurstStatus"]:
    """Take them one after the other, or each in its turn though the one before is still being saved."""

    async def take() -> "BurstStatus":
        done = await take_burst(leader, request)
        show(done)
        return done

    if every_s is None:
        return [await take() for _ in range(repeat)]
    loop = asyncio.get_running_loop()
    began_s = loop.time()
    with ungrouped_errors():
        async with asyncio.TaskGroup() as tasks:
            taking = []
            for number in range(repeat):
                await asyncio.sleep(max(0.0, began_s + number * every_s - loop.time()))
                taking.append(tasks.create_task(take()))
    return [task.result() for task in taking]


async def _take_on_motion(
    leader: Address,
    request: "BurstRequest",
    repeat: int,
    every_s: float,
    region: tuple[float, float, float, float],
    show: Callable[["BurstStatus"], None],
) -> list["BurstStatus"]:
    """Take each when something moves, the frames before it too, and look again when it is saved."""
    from capture_app.rig.link import RigLink
    from capture_app.rig.motion import MotionWatch, watch_motion

    watch, taken, loop = MotionWatch(region), list["BurstStatus"](), asyncio.get_running_loop()
    next_s = loop.time()
    talk(f"watching for what moves; {count(repeat, 'burst')} at most, Ctrl-C ends it")
    async for seen in watch_motion(RigLink(leader), watch):
        if loop.time() < next_s:
            continue
        next_s = loop.time() + every_s
        talk(f"something moves before {seen.camera}")
        done = await take_burst(leader, replace(request, at_leader_ns=seen.leader_ns))
        show(done)
        taken.append(done)
        if len(taken) == repeat:
            break
        watch.forget()
    return taken


MOST_S = 31 * 86_400.0


@click.command(
    epilog=examples(
        "capture-app record --seconds 20",
        "capture-app record --name dance",
        "capture-app record --detach",
        "capture-app record --stop",
        "capture-app record --every-s 10 --seconds 3600 --name clouds",
    )
)
@leader_option
@click.option(
    "--seconds",
    type=FiniteRange(0.001, MOST_S),
    metavar="S",
    show_default="until Ctrl-C or --stop",
    help="Length of the recording.",
)
@click.option(
    "--fps",
    type=FiniteRange(0.00001, 10_000.0),
    metavar="N",
    show_default="the rig's",
    help="Frames a second: the rig's own rate, or a whole part of it.",
)
@click.option(
    "--every-s",
    type=FiniteRange(0.001, 86_400.0),
    metavar="S",
    show_default=False,
    help="Seconds from one frame to the next, instead of --fps: a time-lapse.",
)
@click.option("--name", default="", show_default="recording", help="Its session is NAME-001.")
@click.option("--note", default="", show_default=False, help="A line of text saved with the session.")
@click.option(
    "--most-missing",
    "most_missing_pct",
    type=FiniteRange(0, 100),
    metavar="PERCENT",
    default=1.0,
    help="What may be missing of the frames without exit code 7.",
)
@click.option("--detach", is_flag=True, help="Return as soon as it has begun.")
@click.option("--stop", is_flag=True, help="End the newest recording, or long burst, instead.")
@ready_options
@json_option
def record(
    leader: Address,
    fps: float | None,
    every_s: float | None,
    most_missing_pct: float,
    detach: bool,
    stop: bool,
    as_json: bool,
    **chosen: Any,
) -> None:
    """Record a video with every camera, and print the path of its session, on the leader's machine.

    Frames are saved while they come, each as its camera gave it, with its own time; what a camera drops is
    counted.
    """
    from capture_app.protocol.messages import BurstRequest

    if stop:
        _stop(leader, as_json)
        return
    if fps is not None and every_s is not None:
        raise click.UsageError("give --fps or --every-s, not both")
    interval_s = every_s if fps is None else 1 / fps
    request = BurstRequest(interval_s=interval_s, spare=0, video=True, **chosen)
    done = asyncio.run(_Recording(leader, detach).take(request))
    if done.done:
        answer(as_json, show_take(done, as_json))
        require_whole("recording", done, most_missing_pct)
    else:
        goes_on = f"recording {done.burst} goes on; end it with: capture-app record --stop"
        answer(as_json, {**asdict(done), "verdict": None}, said=goes_on)


def _stop(leader: Address, as_json: bool) -> None:
    from capture_app.protocol.orders import EndBurst
    from capture_app.rig.link import give_order

    asyncio.run(give_order(leader, EndBurst()))
    answer(as_json, {"stopped": True}, said="the recording ends")


class _Recording:
    """Follows one recording; the first Ctrl-C ends it, the second one no longer waits until it is saved."""

    def __init__(self, leader: Address, detach: bool) -> None:
        self._leader = leader
        self._detach = detach
        self._last: BurstStatus | None = None
        self._began = asyncio.Event()
        self._end_wanted = asyncio.Event()

    async def take(self, request: "BurstRequest") -> "BurstStatus":
        """Take it, and return how it stands when it is saved, or has begun."""
        taking = asyncio.create_task(take_burst(self._leader, request, self._note))
        helpers = [asyncio.create_task(self._end_when_wanted())]
        if self._detach:
            helpers.append(asyncio.create_task(self._began.wait()))
        loop = asyncio.get_running_loop()
        loop.add_signal_handler(signal.SIGINT, self._interrupt)
        try:
            await asyncio.wait({taking, *helpers[1:]}, return_when=asyncio.FIRST_COMPLETED)
            if not taking.done() and self._last is not None:
                return self._last
            return await taking
        finally:
            loop.remove_signal_handler(signal.SIGINT)
            await end(taking, *helpers)

    def _interrupt(self) -> None:
        if self._end_wanted.is_set() or not self._began.is_set():
            raise KeyboardInterrupt
        self._end_wanted.set()

    def _note(self, status: "BurstStatus") -> None:
        self._last = status
        if status.burst:
            self._began.set()

    async def _end_when_wanted(self) -> Any:
        from capture_app.protocol.orders import EndBurst
        from capture_app.rig.link import give_order

        await self._end_wanted.wait()
        assert self._last is not None
        talk("ending; again Ctrl-C: do not wait until it is saved")
        await give_order(self._leader, EndBurst(burst=self._last.burst))
