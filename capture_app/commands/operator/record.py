"""`capture-app record`: a synchronized video of every camera, with a time for every frame."""

import asyncio
import signal
from typing import TYPE_CHECKING, Any

import click
from msgspec.structs import asdict

from capture_app.commands.operator.take import ready_options, require_whole, show_take, take_burst
from capture_app.commands.options import leader_option
from capture_app.net.address import Address
from capture_app.terminal import FiniteRange, json_option, print_json, talk
from capture_app.usage import examples

if TYPE_CHECKING:
    from capture_app.node.wire.messages import BurstRequest
    from capture_app.node.wire.status import BurstStatus

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
@click.option("--detach", is_flag=True, help="Return as soon as it has begun.")
@click.option("--stop", is_flag=True, help="End the newest recording, or long burst, instead.")
@ready_options
@json_option
def record(
    leader: Address,
    seconds: float | None,
    fps: float | None,
    every_s: float | None,
    name: str,
    note: str,
    detach: bool,
    stop: bool,
    wait_s: float,
    min_nodes: int,
    as_json: bool,
) -> None:
    """Record a video with every camera, and print the path of its session, on the leader's machine.

    Frames are saved while they come, each as its camera gave it, with its own time; what a camera drops is
    counted.
    """
    from capture_app.node.wire.messages import BurstRequest

    if stop:
        _stop(leader, as_json)
        return
    if fps is not None and every_s is not None:
        raise click.UsageError("give --fps or --every-s, not both")
    request = BurstRequest(
        seconds=seconds,
        interval_s=every_s if fps is None else 1 / fps,
        spare=0,
        name=name,
        note=note,
        wait_ready_s=wait_s,
        nodes=min_nodes,
        video=True,
    )
    done = asyncio.run(_Recording(leader, detach).take(request))
    if done.done:
        shown = show_take(done, as_json)
        if as_json:
            print_json(shown)
        require_whole("recording", done)
    elif as_json:
        print_json({**asdict(done), "verdict": None})
    else:
        talk(f"recording {done.burst} goes on; end it with: capture-app record --stop")


def _stop(leader: Address, as_json: bool) -> None:
    from capture_app.node.operator.requests import give_order
    from capture_app.node.wire.operating import EndBurst

    asyncio.run(give_order(leader, EndBurst()))
    if as_json:
        print_json({"stopped": True})
    else:
        talk("the recording ends")


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
            for task in (taking, *helpers):
                task.cancel()
            await asyncio.gather(taking, *helpers, return_exceptions=True)

    def _interrupt(self) -> None:
        if self._end_wanted.is_set() or not self._began.is_set():
            raise KeyboardInterrupt
        self._end_wanted.set()

    def _note(self, status: "BurstStatus") -> None:
        self._last = status
        if status.burst:
            self._began.set()

    async def _end_when_wanted(self) -> Any:
        from capture_app.node.operator.requests import give_order
        from capture_app.node.wire.operating import EndBurst

        await self._end_wanted.wait()
        assert self._last is not None
        talk("ending; again Ctrl-C: do not wait until it is saved")
        await give_order(self._leader, EndBurst(burst=self._last.burst))
