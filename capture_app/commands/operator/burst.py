"""`capture-app burst`: take a burst with a running leader and wait for its session."""

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import click

from capture_app.commands.operator.take import ready_options, require_whole, show_take, take_burst
from capture_app.commands.options import leader_option
from capture_app.errors import ungrouped_errors
from capture_app.net.address import Address
from capture_app.terminal import FiniteRange, json_option, print_json, talk
from capture_app.usage import examples

if TYPE_CHECKING:
    from capture_app.node.wire.messages import BurstRequest
    from capture_app.node.wire.status import BurstStatus

MOST_FRAMES = 100_000


@click.command(
    epilog=examples(
        "capture-app burst",
        "capture-app burst --frames 30 --name jump --wait-s 20",
        "capture-app burst --frames 360 --interval-s 10 --name clouds",
        "capture-app burst --leader 192.168.1.20 --repeat 10 --every 60 --json",
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
    "--cancel", type=click.IntRange(1), metavar="BURST", help="Cancel the burst of this number instead."
)
@ready_options
@json_option
def burst(
    leader: Address,
    frames: int,
    spacing: int,
    interval_s: float | None,
    spare: int | None,
    consecutive: bool,
    at_ns: int | None,
    before: int,
    name: str,
    note: str,
    repeat: int,
    every_s: float | None,
    cancel: int | None,
    wait_s: float,
    min_nodes: int,
    as_json: bool,
) -> None:
    """Take a burst and print the path of its session, which is on the leader's machine.

    A burst of more than two seconds is saved while it is taken, with every instant: what a camera drops is
    missing. With --repeat take several, and print each path when it is saved; with --json all of them at the
    end.
    """
    from capture_app.node.wire.messages import BurstRequest

    if cancel is not None:
        _cancel(leader, cancel, as_json)
        return
    if at_ns is not None and repeat > 1:
        raise click.UsageError("--at-ns is for one burst, not with --repeat")
    if consecutive and spare:
        raise click.UsageError("--consecutive skips nothing: leave out --spare")
    request = BurstRequest(
        frames=frames,
        spacing=spacing,
        interval_s=interval_s,
        spare=0 if consecutive else spare,
        at_leader_ns=at_ns,
        before=before,
        name=name,
        note=note,
        wait_ready_s=wait_s,
        nodes=min_nodes,
    )
    results: list[dict[str, Any]] = []

    def show(done: "BurstStatus") -> None:
        results.append(show_take(done, as_json))

    try:
        bursts = asyncio.run(_take_bursts(leader, request, repeat, every_s, show))
    finally:
        if as_json and results:
            print_json(results[0] if repeat == 1 else {"bursts": results})
    for done in bursts:
        require_whole("burst", done)


def _cancel(leader: Address, number: int, as_json: bool) -> None:
    from capture_app.node.operator.requests import give_order
    from capture_app.node.wire.operating import CancelBurst

    asyncio.run(give_order(leader, CancelBurst(burst=number)))
    if as_json:
        print_json({"cancelled": number})
    else:
        talk(f"burst {number} is cancelled; what had come is saved")


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
