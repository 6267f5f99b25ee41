"""`reconstruct calibrate`."""

import re
from pathlib import Path

import click

from capture_app.terminal import json_option, print_json, print_line


@click.command()
@click.argument("session", type=click.Path(path_type=Path))
@click.option(
    "--from",
    "source",
    type=click.Choice(["session", "sfm", "charuco"]),
    default="sfm",
    show_default=True,
    help="session: judge the one it has. sfm: from what stands still in the burst. charuco: from a board.",
)
@click.option("--recording", type=click.Path(path_type=Path), help="Session that shows the board.")
@click.option("--board", default="7x5", show_default=True, help="Squares across x down.")
@click.option("--square-mm", type=click.FloatRange(min=0, min_open=True), default=40.0, show_default=True)
@click.option("--marker-mm", type=click.FloatRange(min=0, min_open=True), default=30.0, show_default=True)
@click.option("--dictionary", default="4X4_50", show_default=True, help="Of the board's markers.")
@click.option("--force", is_flag=True, help="Replace the calibration that the session has.")
@json_option
def calibrate(
    session: Path,
    source: str,
    recording: Path | None,
    board: str,
    square_mm: float,
    marker_mm: float,
    dictionary: str,
    force: bool,
    as_json: bool,
) -> None:
    """Find the calibration of SESSION, judge it and store it there, once, for everything after."""

    from reconstruction.calibration.charuco_board import CharucoBoard
    from reconstruction.calibration.command import CalibrateOptions, CalibrationSource
    from reconstruction.calibration.command import calibrate as run

    size = re.fullmatch(r"(\d{1,2})x(\d{1,2})", board)
    if size is None or min(map(int, size.groups())) < 3:
        raise click.BadParameter(f"{board!r} is not squares across x down, as in 7x5", param_hint="--board")
    across, down = map(int, size.groups())
    options = CalibrateOptions(
        source=CalibrationSource(source),
        board=CharucoBoard(across, down, square_mm / 1000, marker_mm / 1000, dictionary),
        recording=recording,
        force=force,
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
    print_line("stored in the session" if result.stored else "it is the session's own")
