"""Command-line options that specify the board."""

import re
from collections.abc import Callable
from functools import wraps
from typing import Any

import click

from capture_app.board.boards import DEFAULT_BOARD, PLAIN, CharucoBoard, Checkerboard

_SIDE = click.FloatRange(min=0, min_open=True, max=10_000)


def board_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options --board, --square-mm, --marker-mm and --dictionary; the command receives `board`."""

    @wraps(command)
    def with_board(
        board: tuple[int, int], square_mm: float, marker_mm: float | None, dictionary: str, **others: Any
    ) -> Any:
        marker_fraction = DEFAULT_BOARD.marker_m / DEFAULT_BOARD.square_m
        marker_m = round(marker_fraction * square_mm, 1) / 1000 if marker_mm is None else marker_mm / 1000
        if dictionary.lower() == PLAIN:
            return command(board=Checkerboard(*board, square_mm / 1000), **others)
        return command(board=CharucoBoard(*board, square_mm / 1000, marker_m, dictionary), **others)

    options = (
        click.option(
            "--board",
            type=_parse_shape,
            default=DEFAULT_BOARD.shape,
            metavar="COLUMNSxROWS",
            help="Squares of the board.",
        ),
        click.option(
            "--square-mm",
            type=_SIDE,
            default=1000 * DEFAULT_BOARD.square_m,
            metavar="MM",
            help="Side of a square, as measured on the print.",
        ),
        click.option(
            "--marker-mm",
            type=_SIDE,
            metavar="MM",
            show_default="about three quarters of a square",
            help="Side of a marker.",
        ),
        click.option(
            "--dictionary",
            default=DEFAULT_BOARD.dictionary,
            metavar="NAME",
            help=f"ArUco dictionary of the markers; {PLAIN} for a plain checkerboard.",
        ),
    )
    for option in reversed(options):
        with_board = option(with_board)
    return with_board


def _parse_shape(text: str) -> tuple[int, int]:
    size = re.fullmatch(r"(\d{1,2})x(\d{1,2})", text)
    if size is None:
        raise click.BadParameter(f"{text!r} is not columns x rows of squares, as in 7x5")
    return int(size[1]), int(size[2])
