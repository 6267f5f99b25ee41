"""`reconstruct board`."""

from pathlib import Path

import click

from capture_app.board.board_options import board_options
from capture_app.board.boards import CharucoBoard, Checkerboard
from capture_app.common.errors import SimulshotError
from capture_app.console.terminal import answer, json_option
from capture_app.console.usage import examples


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
    page shows whether the printer kept the size. docs/calibration.md shows all steps.
    """
    from capture_app.board.printing import board_page, calibrate_options, to_pdf, to_svg

    if not isinstance(board, CharucoBoard):
        raise click.BadParameter("only boards with markers can be printed", param_hint="--dictionary")
    formats = {".pdf": to_pdf, ".svg": to_svg}
    write = formats.get(file.suffix.lower())
    if write is None:
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
