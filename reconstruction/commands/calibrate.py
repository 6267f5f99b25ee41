"""`reconstruct calibrate` and `reconstruct board`."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from capture_app.board.boards import CharucoBoard, Checkerboard, board_options
from capture_app.common.errors import SimulshotError
from capture_app.console.option_rules import Rule, RuledCommand
from capture_app.console.terminal import SESSION, FiniteRange, answer, json_option, table
from capture_app.console.usage import examples
from reconstruction.commands.command_options import session_argument

if TYPE_CHECKING:
    from capture_app.board.coverage import BoardCoverage

Mark = tuple[str, tuple[tuple[float, float], tuple[float, float]]]


def _parse_mark(text: str) -> Mark:
    """Parse a camera name and two points in its image."""
    name, _, numbers = text.partition("=")
    try:
        x1, y1, x2, y2 = (float(number) for number in numbers.split(","))
    except ValueError:
        x1 = y1 = x2 = y2 = math.nan
    if not name or not all(map(math.isfinite, (x1, y1, x2, y2))):
        raise click.BadParameter(f"{text!r} is not a camera and two points, as in cam00=120,340,560,352")
    return name, ((x1, y1), (x2, y2))


_FROM_BOARD = "--from=board|charuco"


@click.command(
    cls=RuledCommand,
    rules=(
        Rule("--coverage", _FROM_BOARD),
        Rule("--board --square-mm --marker-mm --dictionary", f"{_FROM_BOARD} --ground --scale-by-board"),
        Rule("--marker-mm", "!--dictionary=none", ": it has no markers"),
        Rule("--recording", f"{_FROM_BOARD} --scale-by-board"),
        Rule("--lens-recording", _FROM_BOARD),
        Rule("--lens", "--from=sfm|board|charuco"),
        Rule("--field-of-view", "--from=sfm"),
        Rule("--mark", "--distance-m --vertical"),
        Rule("--distance-m --vertical", "--mark"),
        Rule("--ground", "!--vertical", ": both define the ground"),
        Rule("--scale-by-board", "!--distance-m", ": both define the scale"),
        Rule("--replace", "!--from=session --mark --ground --scale-by-board"),
        Rule(
            "--lens-recording --lens --mark --ground --scale-by-board --replace --keep",
            "!--coverage",
            ": it only shows what a board has covered",
        ),
    ),
    epilog=examples(
        "reconstruct calibrate sessions/board-001 --from charuco",
        "reconstruct calibrate sessions/burst-001 --from sfm",
    ),
)
@session_argument
@click.option(
    "--from",
    "source",
    default="sfm",
    metavar="sfm|board|kept|session|PATH",
    show_default="sfm, or board beside options of a board",
    help="sfm: from static features of the burst. board (or charuco): from a board. kept: the calibration "
    "stored for this rig. session: check the session's own. PATH: from another session of these cameras, or "
    "any file that `capture-app sessions import --calibration` takes.",
)
@click.option(
    "--recording",
    "recordings",
    type=SESSION,
    multiple=True,
    metavar="SESSION",
    show_default="SESSION itself",
    help="For board: session that shows the board. Repeat for several.",
)
@click.option(
    "--lens-recording",
    "lens_recordings",
    type=SESSION,
    multiple=True,
    metavar="SESSION",
    show_default="the recordings of the rig",
    help="For board: session in which the board is shown to single cameras, close and to all edges, for "
    "their lenses. Repeat for several.",
)
@board_options
@click.option(
    "--lens",
    type=click.Choice(["auto", "perspective", "fisheye"]),
    default="auto",
    help="Model of the lenses. auto takes a fisheye where a board's corners demand one. For sfm, choose "
    "fisheye and give --field-of-view.",
)
@click.option(
    "--field-of-view",
    "field_of_view_deg",
    type=FiniteRange(5.0, 220.0),
    metavar="DEG",
    show_default="from EXIF, else unknown",
    help="For sfm: the cameras' horizontal field of view.",
)
@click.option(
    "--mark",
    "marks",
    type=_parse_mark,
    multiple=True,
    metavar="CAMERA=X1,Y1,X2,Y2",
    help="Pixels of two points in a camera's picture, whose distance sets the scale. At least two cameras "
    "need it.",
)
@click.option(
    "--distance-m",
    type=FiniteRange(min=0, min_open=True, max=1e5),
    metavar="M",
    help="Distance between the two points of --mark, in metres.",
)
@click.option(
    "--vertical",
    is_flag=True,
    help="The two points of --mark are one above the other, the first on the ground: it becomes the origin, "
    "and z points up.",
)
@click.option(
    "--ground",
    type=SESSION,
    metavar="SESSION",
    help="Session, or SESSION itself, in which the board is flat on the ground. The ground becomes z = 0, z "
    "points up, and the unit is the metre.",
)
@click.option("--scale-by-board", is_flag=True, help="Set the scale by the board that SESSION shows.")
@click.option("--coverage", is_flag=True, help="Only show what the board has covered, and what is missing.")
@click.option("--replace", "force", is_flag=True, help="Replace an earlier calibration of the session.")
@click.option(
    "--keep/--no-keep",
    default=None,
    show_default="store if --from is sfm or board, or the scale or ground is set",
    help="Store the calibration for later sessions of the same cameras in the same modes.",
)
@json_option
def calibrate(
    session: Path,
    source: str,
    coverage: bool,
    marks: tuple[Mark, ...],
    distance_m: float | None,
    vertical: bool,
    lens: str,
    as_json: bool,
    **chosen: Any,
) -> None:
    """Calibrate the cameras of SESSION, check the result and save it in the session.

    Print a board first (reconstruct board), and show it to all cameras in a burst; `capture-app coverage`
    counts the views.
    """
    from reconstruction.common.templates import render_lines
    from reconstruction.method.spoken import spoken
    from reconstruction.scene.calibration.board_calibration import LensModel
    from reconstruction.scene.calibration_run import CalibrateOptions, CalibrationSource, cover
    from reconstruction.scene.calibration_run import calibrate as run

    if source not in set(CalibrationSource) and not Path(source).exists():
        raise click.BadParameter(
            f"{source!r} is not one of {', '.join(CalibrationSource)}, and no such file or folder exists",
            param_hint="--from",
        )

    options = CalibrateOptions(
        source=CalibrationSource.named(source),
        lens=LensModel(lens),
        distance=None if distance_m is None else (dict(marks), distance_m),
        vertical=dict(marks) if vertical else None,
        **chosen,
    )
    if coverage:
        found = cover(session, options)
        answer(as_json, found, _coverage_lines(found))
    else:
        result = run(session, options)
        answer(
            as_json,
            result,
            render_lines("calibrated.txt", "reconstruction.commands", result=spoken(result, result.labels)),
        )


def _coverage_lines(found: "BoardCoverage") -> Iterator[str]:
    from capture_app.board.coverage import coverage_table

    yield table(*coverage_table(found))
    yield from (f"missing: {line}" for line in found.missing)
    if found.enough:
        yield "nothing is missing"


@click.command(epilog=examples("reconstruct board board.pdf", "reconstruct board board.svg --page letter"))
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--page",
    type=click.Choice(["a4", "a3", "letter"], case_sensitive=False),
    default="a4",
    help="Paper to print on.",
)
@board_options
@json_option
def board(file: Path, page: str, board: CharucoBoard | Checkerboard, as_json: bool) -> None:
    """Write a ChArUco board to FILE (.pdf or .svg) to print at true size and calibrate with.

    By default it is the board that `reconstruct calibrate` and `capture-app coverage` expect. A bar on the
    page shows whether the printer kept the size.
    """
    from capture_app.board.printing import board_page, calibrate_options, to_pdf, to_svg

    if not isinstance(board, CharucoBoard):
        raise click.BadParameter("only boards with markers can be printed", param_hint="--dictionary")
    if (write := {".pdf": to_pdf, ".svg": to_svg}.get(file.suffix.lower())) is None:
        raise click.BadParameter(f"{file} ends neither in .pdf nor in .svg", param_hint="FILE")
    printed = board_page(board, page)
    try:
        file.write_bytes(write(printed))
    except OSError as error:
        raise SimulshotError(
            f"cannot write {file}: {error.strerror or error}", hint="choose another FILE"
        ) from error
    options = calibrate_options(board)
    summary = {
        "file": str(file),
        "squares": board.shape,
        "square_mm": 1000 * board.square_m,
        "width_mm": printed.width,
        "height_mm": printed.height,
        "options": options,
    }
    lines = [str(file), "print it at 100 %, and measure the bar below the board: it is 100 mm long"]
    if options:
        lines.append(f"give these options to calibrate and coverage: {' '.join(options)}")
    answer(as_json, summary, lines)
