"""`capture-app cameras characterize`: measures one camera of this machine, and keeps what nodes use of it."""

import asyncio
from typing import TYPE_CHECKING

import click

from capture_app.terminal import FiniteRange, json_option, print_json, print_line, print_table, talk
from capture_app.text import count, duration
from capture_app.usage import examples

if TYPE_CHECKING:
    from capture_app.node.characterization.character import Character, Moves, Starts


@click.command(
    epilog=examples(
        "capture-app cameras characterize v4l2:/dev/video0",
        "capture-app cameras characterize sim:phone-a --seconds 3 --starts 2 --json",
    )
)
@click.argument("spec")
@click.option(
    "--seconds", type=FiniteRange(1.0, 3600.0), default=10.0, metavar="S", help="How long to watch it."
)
@click.option(
    "--starts",
    type=click.IntRange(0, 100),
    default=8,
    metavar="N",
    help="How often to restart its stream, or to close and open it where nodes do not restart it.",
)
@click.option(
    "--moves",
    type=click.IntRange(0, 20),
    default=20,
    metavar="N",
    help="How often to move its phase by frames that last longer, where it has such; rows show from 6 on.",
)
@click.option("--save/--no-save", default=True, help="Keep what nodes use of it in this user's profiles.")
@json_option
def characterize(spec: str, seconds: float, starts: int, moves: int, save: bool, as_json: bool) -> None:
    """Measure the camera SPEC, which no node may use meanwhile: about a minute.

    It tells what the camera offers, how fine and how even its stamps are, how long it takes to start, and,
    where frames can be made longer, what that does to its phase: rows, the gain of an injection and its
    overhead. Nodes use what restarts and injections do from their first command on. How late the stamps are
    it cannot tell.
    """
    from capture_app.cameras.catalog import modes_of, open_camera
    from capture_app.clock import HostClock
    from capture_app.node.camera.device_profiles import DeviceProfiles
    from capture_app.node.characterization import characterize as measuring

    clock = HostClock()
    found = asyncio.run(
        measuring.characterize(
            spec,
            lambda: open_camera(spec, clock=clock, name="characterize"),
            clock,
            modes=modes_of(spec),
            seconds=seconds,
            starts=starts,
            moves=moves,
            talk=talk,
        )
    )
    if save:
        found = measuring.save(found, DeviceProfiles())
    if as_json:
        print_json(found)
        return
    print_table((spec, ""), _rows(found))
    if found.saved:
        print_line("saved in this user's profiles: nodes move such cameras by them from now on")


def _rows(found: "Character") -> list[tuple[str, str]]:
    from capture_app.session.reading.stamp_words import describe_stamp

    facts = found.camera
    rows = [
        ("camera", f"{facts.model}, {facts.width}x{facts.height} {facts.pixel_format}".rstrip()),
        ("offers", found.modes),
        ("frame rate", f"{1e9 / found.period_ns:.4f} frames/s, {found.rate_error_ppm:+.1f} ppm off nominal"),
        ("frames", f"{found.frames}, {found.drops} dropped"),
        ("exposure", _range(found.exposures_ns)),
        ("stamps come in steps of", duration(found.stamp_step_ns) if found.stamp_step_ns else "none seen"),
        ("stamps scatter by", f"{duration(found.stamp_jitter_ns)} (1 sd)"),
        ("stamps claim", str(facts.timestamp_source)),
        ("stamps are", describe_stamp(facts.stamp_accuracy)),
        (
            "arrives after its stamp",
            f"{duration(found.delivery_ns)} in the middle, {duration(found.slowest_delivery_ns)} at most",
        ),
        ("phase is moved by", str(facts.phase_control)),
    ]
    if found.starts is not None:
        rows.append(("starts", _starts(found.starts)))
    return [*(row for row in rows if row[1]), *_moves(found.moves)]


def _starts(starts: "Starts") -> str:
    how = "restarts" if starts.by_restart else "opening it"
    number = len(starts.latencies_ns)
    return (
        f"{duration(starts.median_ns)} to the first frame in the middle of {number}, "
        f"{duration(starts.spread_ns)} from quickest to slowest, by {how}"
    )


def _moves(moves: "Moves | None") -> list[tuple[str, str]]:
    if moves is None:
        return []
    rows = [("moves", f"{moves.effective} of {count(moves.commands, 'command')} moved it")]
    if moves.reason:
        rows.append(("rows", moves.reason))
    if moves.latency_frames is not None:
        rows.append(("it obeys after", "{} to {} frames".format(*moves.latency_frames)))
    if moves.step_ns is not None:
        rows.append(("phase moves in steps of", f"{moves.step_ns / 1000:.2f} µs"))
    if moves.row_time_ns is not None:
        rows.append(("row", f"{moves.row_time_ns / 1000:.2f} µs"))
    if moves.injection is not None:
        rows.append(("gain of an injection", f"{moves.injection.gain:g}"))
    if moves.overhead_ns is not None:
        rows.append(("overhead", f"a frame is {moves.overhead_ns / 1000:.0f} µs longer than its exposure"))
    return rows


def _range(exposures_ns: tuple[int, int] | None) -> str:
    if exposures_ns is None:
        return "not told"
    least, most = (duration(exposure_ns) for exposure_ns in exposures_ns)
    return least if least == most else f"{least} to {most}"
