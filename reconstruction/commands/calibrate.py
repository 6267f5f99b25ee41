"""`reconstruct calibrate`."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from capture_app.board.charuco import CharucoBoard
from capture_app.board.options import board_options
from capture_app.terminal import json_option, print_json, print_line, print_table
from reconstruction.commands.options import memory_option, session_argument

if TYPE_CHECKING:
    from capture_app.board.coverage import BoardCoverage


@click.command()
@session_argument
@click.option(
    "--from",
    "source",
    type=click.Choice(["session", "sfm", "charuco"]),
    default="sfm",
    help="sfm: from static features of the burst. charuco: from a board. session: check the one it has.",
)
@click.option(
    "--recording",
    "recordings",
    type=click.Path(path_type=Path),
    multiple=True,
    metavar="SESSION",
    show_default="SESSION itself",
    help="For charuco: session that shows the board. Repeat for several.",
)
@board_options
@click.option("--coverage", is_flag=True, help="Only show what the board has covered, and what is missing.")
@click.option("--replace", is_flag=True, help="Replace an earlier calibration of the session.")
@memory_option
@json_option
def calibrate(
    session: Path,
    source: str,
    recordings: tuple[Path, ...],
    coverage: bool,
    board: CharucoBoard,
    replace: bool,
    as_json: bool,
) -> None:
    """Calibrate the cameras of SESSION, check the result and save it in the session.

    docs/calibration.md shows the whole way, from the board to print (reconstruct board) on.
    """
    from reconstruction.calibration.command import CalibrateOptions, CalibrationSource, cover
    from reconstruction.calibration.command import calibrate as run

    options = CalibrateOptions(
        source=CalibrationSource(source),
        board=board,
        recordings=recordings,
        force=replace,
    )
    if coverage:
        _show_coverage(cover(session, options), as_json)
        return
    result = run(session, options)
    if as_json:
        print_json(result)
        return
    quality = result.quality
    print_line(f"{len(result.cameras)} cameras from {result.source or 'the session'}")
    if result.missing:
        print_line(f"without calibration: {', '.join(result.missing)}")
    print_line(
        f"reprojection error {quality.reprojection_error_px:.2f} px, triangulation angle "
        f"{quality.triangulation_angle_deg:.1f} degrees, {100 * quality.inlier_share:.0f} % inliers "
        f"of {quality.points} points"
    )
    for name, share in quality.coverage.items():
        print_line(f"{name}: points in {100 * share:.0f} % of the picture")
    if result.board is not None:
        for line in result.board.missing:
            print_line(f"would make it better: {line}")
    print_line("saved in the session" if result.stored else "the session has this calibration already")


def _show_coverage(found: "BoardCoverage", as_json: bool) -> None:
    from capture_app.board.coverage import coverage_table

    if as_json:
        print_json(found)
        return
    print_table(*coverage_table(found))
    for line in found.missing:
        print_line(f"missing: {line}")
    if found.enough:
        print_line("nothing is missing")
