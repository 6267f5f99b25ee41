"""`reconstruct tolerance`."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from capture_app.console.terminal import FiniteRange, answer, json_option
from capture_app.console.usage import examples
from reconstruction.commands.command_options import (
    checksums_option,
    max_instants_option,
    memory_option,
    pair_option,
    session_argument,
    time_shift_option,
)
from reconstruction.session.conditions import DEFAULT_OFFSET_MS

if TYPE_CHECKING:
    from reconstruction.scores.comparison_results import OffsetTolerance


@click.command(epilog=examples("reconstruct tolerance sessions/burst-001 --out tolerance"))
@session_argument
@click.option(
    "--max-offset-ms",
    type=FiniteRange(min=0, min_open=True, max=1e4),
    metavar="MS",
    default=DEFAULT_OFFSET_MS,
    help="Largest delay to measure, in steps of one frame, as far as the burst allows.",
)
@pair_option("--pair", use="depth")
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
def tolerance(session: Path, out: Path | None, as_json: bool, **options: Any) -> None:
    """Measure the delay of one camera at which the motion in SESSION spoils the depth."""
    from reconstruction.compare.tolerance_study import ToleranceOptions
    from reconstruction.compare.tolerance_study import measure_tolerance as run

    result = run(session, out, ToleranceOptions(**options))
    report = [] if out is None else [f"report: {out / result.report}"]
    answer(as_json, result, [*_lines(result), *report])


def _lines(result: "OffsetTolerance") -> Iterator[str]:
    from reconstruction.report.findings import late_or_early

    yield result.verdict
    for instant in result.timing.instants if result.timing else ():
        late = late_or_early(instant.late_ms, 2 * instant.sd_ms)
        yield f"instant {instant.instant:3d}: {result.cameras[1]} is {late}"
    for point in result.points:
        found = point.interval(result.measure, "offset")
        value = "n/a" if found is None else f"{100 * found.value:5.1f} %"
        ends = () if found is None or found.low is None else found.ends
        around = f"  ({' to '.join(f'{100 * end:.1f}' for end in ends)})" if ends else ""
        yield f"{point.late_ms or 0.0:6.1f} ms  {value}{around}"
