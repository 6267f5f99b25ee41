"""`capture-app cameras characterize`: what one camera is capable of, measured."""

import asyncio
from collections.abc import Iterator
from typing import TYPE_CHECKING

import click

from capture_app.common.text import count, duration
from capture_app.console.terminal import FiniteRange, answer, json_option, table, talk
from capture_app.console.usage import examples

if TYPE_CHECKING:
    from capture_app.companions.characterize.camera_character import Character, Moves


@click.command(
    epilog=examples(
        "capture-app cameras characterize v4l2:/dev/video0",
        "capture-app cameras characterize sim:phone-a --seconds 3 --starts 2 --json",
    )
)
@click.argument("spec")
@click.option("--seconds", type=FiniteRange(1.0, 3600.0), default=10.0, metavar="S", help="Observation time.")
@click.option(
    "--starts",
    type=click.IntRange(0, 100),
    default=8,
    metavar="N",
    help="Number of stream restarts. A camera that nodes cannot restart is closed and opened.",
)
@click.option(
    "--save/--no-save", default=True, help="Save the results in this user's profiles, for nodes to use."
)
@json_option
def characterize(spec: str, seconds: float, starts: int, save: bool, as_json: bool) -> None:
    """Measure the camera SPEC in about a minute; no node may use it meanwhile.

    Reports the camera's modes, the resolution and jitter of its timestamps, and its start latency. If frames
    can be made longer, also the effect on its phase: row time, injection gain and overhead. Nodes use the
    restart and injection results from their first command on. For the timestamp delay, use `cameras
    calibrate-time`.
    """
    from capture_app.companions.characterize.camera_character import characterize as measure

    character = asyncio.run(measure(spec, seconds=seconds, starts=starts, keep=save, talk=talk))
    saved = ["saved in this user's profiles; nodes use them from now on"]
    answer(as_json, character, [table((spec, ""), _rows(character)), *saved[: character.saved]])


def _rows(found: "Character") -> list[tuple[str, str]]:
    from capture_app.common.camera_facts import describe_stamp

    facts = found.camera
    rows = [
        ("camera", f"{facts.model}, {facts.width}x{facts.height} {facts.pixel_format}".rstrip()),
        ("offers", found.modes),
        ("frame rate", f"{1e9 / found.period_ns:.4f} frames/s, {found.rate_error_ppm:+.1f} ppm off nominal"),
        ("frames", f"{found.frames}, {found.drops} dropped"),
        ("exposure", _range(found.exposures_ns)),
        ("timestamp resolution", duration(found.stamp_step_ns) if found.stamp_step_ns else "none seen"),
        ("timestamp jitter", f"{duration(found.stamp_jitter_ns)} (1 sd)"),
        ("timestamps claim", str(facts.timestamp_source)),
        ("timestamps are", describe_stamp(facts.stamp_accuracy)),
        (
            "delivery after timestamp",
            f"{duration(found.delivery_ns)} median, {duration(found.slowest_delivery_ns)} at most",
        ),
        ("phase control", str(facts.phase_control)),
    ]
    if found.starts is not None:
        in_order = sorted(found.starts.latencies_ns)
        starts = (
            f"{duration(in_order[len(in_order) // 2])} to the first frame, median of {len(in_order)}; "
            f"{duration(in_order[-1] - in_order[0])} between fastest and slowest, by "
        )
        rows.append(("starts", starts + ("restarts" if found.starts.by_restart else "opening it")))
    return [*(row for row in rows if row[1]), *(_moves(found.moves) if found.moves else ())]


def _moves(moves: "Moves") -> Iterator[tuple[str, str]]:
    yield "moves", f"{moves.effective} of {count(moves.commands, 'command')} moved it"
    if moves.reason:
        yield "rows", moves.reason
    if moves.latency_frames is not None:
        yield "latency", "{} to {} frames".format(*moves.latency_frames)
    if moves.step_ns is not None:
        yield "phase step", f"{moves.step_ns / 1000:.2f} µs"
    if moves.row_time_ns is not None:
        yield "row", f"{moves.row_time_ns / 1000:.2f} µs"
    if moves.injection is not None:
        yield "injection gain", f"{moves.injection.gain:g}"
    if moves.overhead_ns is not None:
        yield "overhead", f"a frame is {moves.overhead_ns / 1000:.0f} µs longer than its exposure"


def _range(exposures_ns: tuple[int, int] | None) -> str:
    return " to ".join(dict.fromkeys(map(duration, exposures_ns or ()))) or "not reported"
