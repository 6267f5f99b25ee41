"""`reconstruct dose`."""

from pathlib import Path

import click

from capture_app.terminal import json_option, print_json, print_line
from reconstruction.commands.arguments import Pair


@click.command()
@click.argument("session", type=click.Path(path_type=Path))
@click.option(
    "--most-ms",
    type=click.FloatRange(min=0, min_open=True, max=1e4),
    default=66.0,
    show_default=True,
    help="Measure up to this offset, ms, in whole frames, or as far as the burst goes.",
)
@click.option("--stereo", type=Pair(), help="The two cameras for depth [default: chosen by what they see].")
@click.option(
    "--instants",
    type=click.IntRange(min=1),
    default=16,
    show_default=True,
    help="Use at most so many instants.",
)
@click.option("--out", type=click.Path(path_type=Path), help="Folder for curve, numbers and report.")
@json_option
def dose(
    session: Path,
    most_ms: float,
    stereo: tuple[str, str] | None,
    instants: int,
    out: Path | None,
    as_json: bool,
) -> None:
    """Measure how much lateness of one camera the motion in SESSION bears."""

    from reconstruction.compare.dose import DoseOptions
    from reconstruction.compare.dose import dose as run
    from reconstruction.report.dose import dose_sentence

    result = run(session, out, DoseOptions(most_ms=most_ms, stereo=stereo, most_instants=instants))
    if as_json:
        print_json(result)
        return
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
