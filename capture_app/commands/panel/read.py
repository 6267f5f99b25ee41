"""`capture-app panel read`."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from capture_app.commands.options import ANY_PATH, FOLDER
from capture_app.terminal import json_option, print_json, print_line, print_table, show_count
from capture_app.text import count, duration, pretty_json
from capture_app.usage import examples

if TYPE_CHECKING:
    from capture_app.panel.reading.pair_errors import Held, PairTable, RigErrors
    from capture_app.panel.reading.session_times import SessionTimes

RESULT = "panel.json"
RATE_LIMIT_PPM = 3_000.0
"""A panel whose clock differs by more than this from the session's is not the one that its markers tell."""


@click.command(epilog=examples("capture-app panel read sessions/burst-001"))
@click.argument("session", type=ANY_PATH)
@click.option("--out", type=FOLDER, metavar="DIR", help=f"Folder to write {RESULT} to, with all figures.")
@json_option
def read(session: Path, out: Path | None, as_json: bool) -> None:
    """Read a panel in the pictures of SESSION: how far apart the cameras took each instant.

    Finds the panel by its markers, so that nothing need be said of it, in imported sessions too. Total is
    what the panel shows, phase what the session's own stamps say, clock the rest: errors of the cameras'
    clocks.
    """
    from capture_app.panel.reading.pair_errors import rig_errors
    from capture_app.panel.reading.session_times import read_session
    from capture_app.session.files.output_folder import OutputFolder, replaces_only
    from capture_app.session.reading.reader import Session

    times = read_session(Session.open(session), show_count("pictures"))
    errors = rig_errors(times)
    found = _as_json(times, errors)
    if out is not None:
        with OutputFolder(out, replaces_only({RESULT})) as output:
            (output.folder / RESULT).write_bytes(pretty_json(found))
    if as_json:
        print_json(found)
        return
    _print_pictures(times)
    if errors.all is None:
        print_line("No instant has two pictures that could be read: no camera can be compared with another.")
        return
    _print_errors(errors)
    _print_judgement(times, errors)


def _as_json(times: "SessionTimes", errors: "RigErrors") -> dict[str, object]:
    import msgspec

    return {
        "panel": times.panel,
        "tick_ns": times.tick_ns,
        "cycle_ns": times.cycle_ns,
        "exposures_known": times.exposures_known,
        "pictures": [
            {
                "camera": picture.camera,
                "instant": picture.instant,
                "panel_ns": picture.panel_ns,
                "uncertainty_ns": picture.uncertainty_ns,
                "stamp_ns": picture.stamp_ns,
                "stamp_uncertainty_ns": picture.stamp_uncertainty_ns,
                "exposure_ns": picture.reading.shutter.exposure_ns,
                "row_time_ns": picture.reading.shutter.row_time_ns,
                "markers": picture.reading.markers,
                "misfit": picture.reading.misfit,
            }
            for picture in times.pictures
        ],
        "refusals": [
            {"camera": refusal.camera, "instant": refusal.instant, "reason": refusal.reason}
            for refusal in times.refusals
        ],
        "errors": msgspec.to_builtins(errors),
    }


def _print_pictures(times: "SessionTimes") -> None:
    rows = []
    for name in times.cameras:
        mine = [picture for picture in times.pictures if picture.camera == name]
        refused = sum(refusal.camera == name for refusal in times.refusals)
        if not mine:
            rows.append((name, "0", str(refused), "-", "-", "-"))
            continue
        middle = sorted(mine, key=lambda picture: picture.uncertainty_ns)[len(mine) // 2]
        rows.append(
            (
                name,
                str(len(mine)),
                str(refused),
                f"±{duration(middle.uncertainty_ns)}",
                duration(middle.reading.shutter.exposure_ns),
                duration(middle.reading.shutter.row_time_ns),
            )
        )
    ticks, cycle = duration(times.tick_ns), duration(times.cycle_ns)
    print_line(f"panel {times.panel}: a tick of {ticks}, the same again after {cycle}")
    print_table(("camera", "read", "refused", "95 % error", "exposure", "row time"), rows)
    for refusal in times.refusals:
        print_line(f"{refusal.camera}, instant {refusal.instant}, refused: {refusal.reason}")


def _print_errors(errors: "RigErrors") -> None:
    assert errors.all is not None, "asked before"
    print_line("")
    head = ("cameras", "error", "mean abs", "std", "largest", "mean", "instants")
    rows: list[tuple[str, ...]] = []
    for table in errors.pairs:
        rows += _rows(" - ".join(table.cameras), table)
    if len(errors.pairs) > 1:
        rows += _rows("all pairs", errors.all)
    print_table(head, rows)


def _rows(name: str, table: "PairTable") -> "list[tuple[str, ...]]":
    kinds = (("total", table.total), ("phase", table.phase), ("clock", table.clock))
    return [
        (
            name if kind == "total" else "",
            kind,
            duration(of.mean_abs_ns),
            duration(of.std_ns),
            duration(of.max_ns),
            duration(of.bias_ns, signed=True),
            str(table.count) if kind == "total" else "",
        )
        for kind, of in kinds
    ]


def _print_judgement(times: "SessionTimes", errors: "RigErrors") -> None:
    assert errors.all is not None, "asked before"
    print_line("")
    print_line(
        f"The panel tells such a difference to ±{duration(errors.all.reading_uncertainty_ns)} (95 %): "
        "smaller ones are not seen."
    )
    if times.is_screen:
        print_line(
            f"A screen of {1e9 / times.tick_ns:.0f} Hz changes every {duration(times.tick_ns)}, row by row; "
            "a panel of LEDs tells microseconds."
        )
    if not times.exposures_known:
        print_line(
            "The session does not tell all exposures and row times: stamps may be of another moment than the "
            "middle of the exposure, which then is part of the clock's error."
        )
    if errors.within_uncertainty is None:
        print_line("The session states no error bars to hold this against.")
    else:
        print_line(f"Clock errors inside the session's own error bars: {_of(errors.within_uncertainty)}.")
    if errors.within_bound is not None:
        print_line(f"Inside its hard bounds: {_of(errors.within_bound)}.")
    if errors.totals_near_truth is not None and errors.largest_reading_error_ns is not None:
        print_line(
            f"By the ground truth, totals are off by at most {duration(errors.largest_reading_error_ns)}; "
            f"inside the panel's error bars {_of(errors.totals_near_truth)}."
        )
    rate_ppm = errors.rate_error_ppm or 0.0
    if abs(rate_ppm) > RATE_LIMIT_PPM + (errors.rate_uncertainty_ppm or 0.0):
        print_line(
            f"The panel runs {rate_ppm / 1e4:+.1f} % off the session's clock: is it the one that its markers "
            "tell, at that rate? If not, nothing of the above holds."
        )


def _of(held: "Held") -> str:
    return f"{held.held} of {count(held.count, 'pair')}"
