"""`reconstruct calibrate`."""

from pathlib import Path

import click

from capture_app.board.charuco import CharucoBoard
from capture_app.board.options import board_options
from capture_app.terminal import json_option, print_json, print_line
from reconstruction.commands.options import memory_option, session_argument


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
    type=click.Path(path_type=Path),
    metavar="SESSION",
    help="For charuco: session that shows the board.",
)
@board_options
@click.option("--replace", is_flag=True, help="Replace an earlier calibration of the session.")
@memory_option
@json_option
def calibrate(
    session: Path,
    source: str,
    recording: Path | None,
    board: CharucoBoard,
    replace: bool,
    as_json: bool,
) -> None:
    """Calibrate the cameras of SESSION, check the result and save it in the session."""
    from reconstruction.calibration.command import CalibrateOptions, CalibrationSource
    from reconstruction.calibration.command import calibrate as run

    options = CalibrateOptions(
        source=CalibrationSource(source),
        board=board,
        recording=recording,
        force=replace,
    )
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
    print_line("saved in the session" if result.stored else "the session has this calibration already")
