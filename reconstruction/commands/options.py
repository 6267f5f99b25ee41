"""Options that several commands share, and the types of their values."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from capture_app.errors import BadInputError
from reconstruction.session.conditions import DISTINCT, DISTINCT_MS, SYNCED, Condition


class CameraPair(click.ParamType[tuple[str, str]]):
    """The names of two cameras with a comma between."""

    name = "camera,camera"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, str]:
        """Split the text."""
        names = [part.strip() for part in str(value).split(",")]
        if len(names) != 2 or not all(names):
            self.fail(f"{value!r} is not two cameras with a comma between, as in cam00,cam01", param, ctx)
        return names[0], names[1]


class ConditionType(click.ParamType[Condition]):
    """How late each camera's images are: see `CONDITION_HELP` and `Condition.parse`."""

    name = "condition"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> Condition:
        """Read the condition."""
        if isinstance(value, Condition):
            return value
        try:
            return Condition.parse(str(value))
        except BadInputError as error:
            self.fail(str(error), param, ctx)


OFFSETS_HELP = (
    "MS: every second camera is late by this much. MS,MS,...: each camera is late by this much, in the "
    "session's order. CAMERA=MS,...: the named cameras are late. "
    f"{DISTINCT}: each camera is late by a different one of {', '.join(f'{ms:g}' for ms in DISTINCT_MS)} ms, "
    "drawn for each instant."
)
CONDITION_HELP = f"{SYNCED}: images of the same instant. {OFFSETS_HELP}"


def pair_option(name: str, use: str) -> Callable[..., Any]:
    """Make an option for two cameras and what they are used for."""
    return click.option(
        name, type=CameraPair(), show_default="chosen automatically", help=f"The two cameras for {use}."
    )


session_argument = click.argument("session", type=click.Path(path_type=Path))
instant_option = click.option(
    "--instant",
    type=click.IntRange(min=0),
    metavar="K",
    default=0,
    help="Instant of the burst, counted from 0.",
)
max_instants_option = click.option(
    "--max-instants",
    type=click.IntRange(min=1),
    metavar="N",
    default=16,
    help="Use at most this many instants, spread evenly over the burst.",
)
out_option = click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", required=True, help="Folder for the results."
)
