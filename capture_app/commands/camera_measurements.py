"""`capture-app cameras calibrate-time` and `characterize`: measurements of the user's own cameras."""

import asyncio
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from capture_app.commands.options import leader_option
from capture_app.commands.take import ready_options, require_whole, take
from capture_app.common.address import Address
from capture_app.common.errors import IncompleteError, NotApplicableError
from capture_app.common.text import count, duration
from capture_app.console.terminal import FiniteRange, answer, json_option, table, talk
from capture_app.console.usage import examples

if TYPE_CHECKING:
    from capture_app.commands.take import TakeEnd
    from capture_app.protocol.orders import SaveStamp
    from capture_app.rig.camera_times import MeasuredTimes
    from capture_app.rig.characterize import Character, Moves, Starts
    from capture_app.session.reading.reader import Session

NAME = "calibrate-time"
MOTION_S, LIGHT_S = 2.0, 8.0
TODO = {
    "motion": "somebody has to move before all cameras",
    "light": "switch a torch on and off before all cameras, again and again",
    "panel": "all cameras have to see the panel",
}


@click.command(
    NAME,
    epilog=examples(
        "capture-app cameras calibrate-time",
        "capture-app cameras calibrate-time --light",
        "capture-app cameras calibrate-time --panel",
        "capture-app cameras calibrate-time --session sessions/calibrate-time-001",
    ),
)
@leader_option
@click.option(
    "--light", is_flag=True, help="A torch is to blink some eight times, instead of somebody to move."
)
@click.option("--panel", is_flag=True, help="All cameras see a panel instead: capture-app panel.")
@click.option(
    "--seconds",
    type=FiniteRange(0.5, 60.0),
    metavar="S",
    show_default=f"{MOTION_S:g}, with --light {LIGHT_S:g}",
    help="How long pictures are taken.",
)
@click.option(
    "--session",
    "folder",
    type=click.Path(path_type=Path),
    metavar="SESSION",
    help="Take no pictures: those of this session are of the cameras as they run now.",
)
@ready_options
@json_option
def calibrate_time(
    leader: Address,
    light: bool,
    panel: bool,
    seconds: float | None,
    folder: Path | None,
    as_json: bool,
    **ready: Any,
) -> None:
    """Measure how late each camera's stamps are, and let the rig go by that from now on.

    All cameras must see somebody who moves for two seconds, up and down as well as across; with --light a
    torch that is switched on and off eight times, half a second or more each. What is found is kept for each
    camera in its mode, on its machine. Where stamps are known, what is left is of the way to the leader, and
    kept for that. Needs reconstruct on this machine, but for --panel.
    """
    from capture_app.rig.camera_times import calibrate
    from capture_app.session.reading.reader import Session

    if folder is None:
        seconds = seconds or (LIGHT_S if light else MOTION_S)
        todo = TODO["panel" if panel else "light" if light else "motion"]
        folder = _take(leader, seconds, todo, ready)
    session = Session.open(folder)
    talk("measuring")
    found, news, kept = asyncio.run(calibrate(leader, session, times_by_panel(session) if panel else None))
    cameras = {
        name: {
            "measured": time,
            "stamp": news[name].stamp if name in news else None,
            "way": news[name].asymmetry if name in news else None,
            "kept": kept.get(name, False),
        }
        for name, time in found.cameras.items()
    }
    told = {"session": str(folder), "reference": found.reference, "cameras": cameras}
    answer(as_json, told, [table(("camera", "stamps are late by"), _rows_of(found, news, kept))])
    if reason := next((one.reason for one in found.cameras.values() if one.reason), ""):
        missing = ", ".join(name for name, one in found.cameras.items() if one.reason)
        raise NotApplicableError(
            f"how late the stamps of {missing} are cannot be told: {reason}",
            hint="somebody has to move up and down before all cameras, or a torch to blink (--light)",
        )


def _take(leader: Address, seconds: float, todo: str, ready: Mapping[str, Any]) -> Path:
    """Take the pictures, when the rig is ready as asked; the folder of their session."""
    from capture_app.rig.link import RigLink
    from capture_app.rig.taking import TakePlan

    talk(f"{seconds:g} s of pictures: {todo}")
    note = "taken to measure how late the cameras' stamps are"
    plan = TakePlan(seconds=seconds, name=NAME, note=note, **ready)
    taken: list[TakeEnd] = []
    asyncio.run(take(RigLink(leader), plan, taken, silent=True))
    require_whole(taken[0], 100.0)
    where = (taken[0].status and taken[0].status.session) or "its phones"
    if not Path(where).is_dir():
        raise IncompleteError(f"the pictures are on the leader's machine, in {where}", hint="calibrate there")
    return Path(where)


def times_by_panel(session: "Session", reference: str | None = None) -> "MeasuredTimes":
    """Read a panel: how late each camera is against one, else the best-known. Raises NotApplicableError."""
    from capture_app.common.camera_facts import StampSource
    from capture_app.panel.pair_errors import rig_errors
    from capture_app.panel.session_times import read_session
    from capture_app.panel.time_reading import SIGMAS_95
    from capture_app.rig.camera_times import MeasuredTime, MeasuredTimes, choose_reference

    records = {record.name: record for record in session.manifest.cameras}
    reference = reference or choose_reference(records) or next(iter(records))
    times = read_session(session)
    if not times.exposures_known:
        raise NotApplicableError(f"{session.folder} does not tell all exposures and row times")
    unseen = MeasuredTime(
        reason=f"no panel is seen by it and {reference} at once, or its cycle is too short for their stamps"
    )
    found = dict.fromkeys(times.cameras, unseen) | {reference: MeasuredTime(offset_ms=0.0, sd_ms=0.0)}
    errors = rig_errors(times)
    for pair in errors.pairs:
        of_pair = [one for one in errors.errors if (one.first, one.second) == pair.cameras]
        unsure_ns = max(one.session_uncertainty_ns or 0.0 for one in of_pair)
        if reference not in pair.cameras or unsure_ns > times.panel.cycle_ns / 2.0:
            continue
        sign, name = (1.0, pair.cameras[1]) if pair.cameras[0] == reference else (-1.0, pair.cameras[0])
        sd_ms = pair.reading_uncertainty_ns / SIGMAS_95 / 1e6
        found[name] = MeasuredTime(
            offset_ms=sign * pair.clock.bias_ns / 1e6, sd_ms=sd_ms, source=StampSource.LIGHT
        )
    return MeasuredTimes(reference=reference, cameras=found)


def _rows_of(
    found: "MeasuredTimes", news: "dict[str, SaveStamp]", kept: dict[str, bool]
) -> Iterator[tuple[str, str]]:
    from capture_app.session.reading.stamp_words import describe_stamp

    for name, time in found.cameras.items():
        if name not in news:
            if name == found.reference:
                yield name, "as they were known: all others are told against it"
            elif time.offset_ms is None or time.sd_ms is None:
                yield name, f"cannot be told: {time.reason}"
            else:
                off, unsure = duration(time.offset_ms * 1e6, signed=True), duration(2e6 * time.sd_ms)
                yield name, f"as they were known: that is surer than {off} ±{unsure}"
            continue
        stamp, asymmetry = news[name].stamp, news[name].asymmetry
        words = describe_stamp(stamp) if stamp else "as they were known"
        if asymmetry:
            off = "behind" if asymmetry.late_ns > 0 else "ahead"
            error = f"{duration(abs(asymmetry.late_ns))} ±{duration(asymmetry.uncertainty_ns)}"
            words += f"; its clock was {error} {off}"
        yield name, words + ("" if kept[name] else "; could not be kept")


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
    from capture_app.rig.characterize import characterize as measure

    found = asyncio.run(measure(spec, seconds=seconds, starts=starts, moves=moves, keep=save, talk=talk))
    kept = ["saved in this user's profiles: nodes move such cameras by them from now on"]
    answer(as_json, found, [table((spec, ""), _rows(found)), *kept[: found.saved]])


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
    return [*(row for row in rows if row[1]), *(_moves(found.moves) if found.moves else ())]


def _starts(starts: "Starts") -> str:
    how = "restarts" if starts.by_restart else "opening it"
    in_order = sorted(starts.latencies_ns)
    return (
        f"{duration(in_order[len(in_order) // 2])} to the first frame in the middle of {len(in_order)}, "
        f"{duration(in_order[-1] - in_order[0])} from quickest to slowest, by {how}"
    )


def _moves(moves: "Moves") -> Iterator[tuple[str, str]]:
    yield "moves", f"{moves.effective} of {count(moves.commands, 'command')} moved it"
    if moves.reason:
        yield "rows", moves.reason
    if moves.latency_frames is not None:
        yield "it obeys after", "{} to {} frames".format(*moves.latency_frames)
    if moves.step_ns is not None:
        yield "phase moves in steps of", f"{moves.step_ns / 1000:.2f} µs"
    if moves.row_time_ns is not None:
        yield "row", f"{moves.row_time_ns / 1000:.2f} µs"
    if moves.injection is not None:
        yield "gain of an injection", f"{moves.injection.gain:g}"
    if moves.overhead_ns is not None:
        yield "overhead", f"a frame is {moves.overhead_ns / 1000:.0f} µs longer than its exposure"


def _range(exposures_ns: tuple[int, int] | None) -> str:
    if exposures_ns is None:
        return "not told"
    least, most = (duration(exposure_ns) for exposure_ns in exposures_ns)
    return least if least == most else f"{least} to {most}"
