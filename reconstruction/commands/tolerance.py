"""`reconstruct dose`."""

from pathlib import Path
from typing import Any

import click

from capture_app.terminal import FiniteRange, json_option, print_json, print_line
from capture_app.usage import examples
from reconstruction.commands.options import (
    checksums_option,
    max_instants_option,
    memory_option,
    pair_option,
    session_argument,
    time_shift_option,
)
from reconstruction.session.conditions import DEFAULT_OFFSET_MS


@click.command(epilog=examples("reconstruct dose sessions/burst-001 --out dose"))
@session_argument
@click.option(
    "--max-offset-ms",
    type=FiniteRange(min=0, min_open=True, max=1e4),
    metavar="MS",
    default=DEFAULT_OFFSET_MS,
    help="Largest offset to measure, in steps of one frame, as far as the burst allows.",
)
@pair_option("--pair", "stereo", use="depth")
@max_instants_option
@time_shift_option
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Folder for the curve, the numbers and a report.",
)
@memory_option
@checksums_option
@json_option
def dose(session: Path, out: Path | None, as_json: bool, **options: Any) -> None:
    """Measure how late one camera may be before the motion in SESSION spoils the depth."""
    from reconstruction.compare.tolerance import DoseOptions
    from reconstruction.compare.tolerance import dose as run
    from reconstruction.report.findings import late_or_early
    from reconstruction.report.tolerance_report import dose_sentence

    result = run(session, out, DoseOptions(**options))
    if as_json:
        print_json(result)
        return
    for instant in result.timing.instants if result.timing else ():
        late = late_or_early(instant.late_ms, 2 * instant.sd_ms)
        print_line(f"instant {instant.instant:3d}: {result.other} is {late}")
    for point in result.points:
        scores = point.scores
        share = scores.mover_coverage if result.measure == "mover_coverage" else scores.mover_within_2pct
        found = scores.intervals.get(result.measure)
        around = f"  ({100 * found.low:.1f} to {100 * found.high:.1f})" if found else ""
        value = "n/a" if share is None else f"{100 * share:5.1f} %"
        print_line(f"{point.offset_ms:6.1f} ms  {value}{around}")
    print_line(dose_sentence(result))
    if out is not None:
        print_line(f"report: {out / result.report}")
