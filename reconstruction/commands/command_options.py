"""Options shared by several commands, and the parsing of their values."""

from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path
from typing import Any

import click
import msgspec

from capture_app.console.terminal import SESSION, TIME_SHIFT, FiniteRange, ParsedType
from reconstruction.common.matchers import MATCHER_HELP, Matcher
from reconstruction.common.options import Described, Pair, described
from reconstruction.common.options import flag as flag
from reconstruction.scene.conditions import DISTINCT, DISTINCT_MS, SYNCED, Condition

MAX_INSTANTS = 1_000_000
CONDITION = ParsedType("condition", Condition.parse)
"""Type of a condition: the delay of each camera's images; see `CONDITION_HELP`."""
OFFSETS_HELP = (
    "MS: delay of every second camera. MS,MS,...: delay of each camera, in the session's order. "
    "CAMERA=MS,...: delay of the named cameras. "
    f"{DISTINCT}: a different delay for each camera out of {', '.join(f'{ms:g}' for ms in DISTINCT_MS)} ms, "
    "drawn for each instant."
)
CONDITION_HELP = f"{SYNCED}: images of the same instant. {OFFSETS_HELP}"


def parse_pair(text: str) -> tuple[str, str]:
    """Parse two camera names separated by a comma."""
    names = [part.strip() for part in text.split(",")]
    if len(names) != 2 or not all(names):
        raise click.BadParameter(f"{text!r} is not two cameras with a comma between, as in cam00,cam01")
    return names[0], names[1]


def parse_instants(text: str) -> tuple[int, ...]:
    """Parse instants and ranges of instants, such as 0-9,20."""
    instants: list[int] = []
    for part in text.split(","):
        ends = [int(end) if end.strip().isdecimal() else -1 for end in part.split("-", 1)]
        if not 0 <= ends[0] <= ends[-1] < MAX_INSTANTS:
            raise click.BadParameter(f"{text!r} is not a list of instants, as in 0-9,20")
        instants += range(ends[0], ends[-1] + 1)
    return tuple(dict.fromkeys(instants))


def parse_names(text: str) -> tuple[str, ...]:
    """Parse names separated by commas."""
    return tuple(name for part in text.split(",") if (name := part.strip()))


def parse_all_or_some(text: str) -> tuple[int, ...]:
    """Parse `all`, returned empty, or instants as `parse_instants` does."""
    return () if text.strip() == "all" else parse_instants(text)


def click_options(options: type[msgspec.Struct], *, own: bool = False) -> Iterator[click.Option]:
    """Yield the options of a method's `Options` for `reconstruct compare`, or for its `own` command."""
    defaults = {field.name: field.default for field in msgspec.structs.fields(options)}
    for option in described(options):
        if option.own == own:
            default = defaults[option.field]
            settings: dict[str, Any] = {"default": str(default) if isinstance(default, str) else default}
            settings |= _click_type(option) | option.settings
            yield click.Option([*dict.fromkeys((*option.names, option.keyword))], **settings)


def _click_type(option: Described) -> dict[str, Any]:
    """Return click's settings for a value of an option's type within its bounds."""
    kind: Any = option.kind
    if kind == Pair:
        return PAIR
    if kind == tuple[int, ...]:
        return {"type": parse_all_or_some}
    if kind == tuple[str, ...]:
        return {
            "type": parse_names,
            "default": None,
            "callback": lambda ctx, param, value: value or (),
            "show_default": "none",
        }
    if kind is bool:
        return {"is_flag": True}
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        names = [str(value) for value in kind]
        return {"type": click.Choice(names), "callback": lambda ctx, param, value: kind(value)}
    if not option.bounds:
        return {}
    low = option.bounds.get("ge", option.bounds.get("gt"))
    kind = click.IntRange if kind is int else FiniteRange
    return {"type": kind(min=low, min_open="gt" in option.bounds, max=option.bounds.get("le"))}


PAIR: dict[str, Any] = {
    "type": parse_pair,
    "metavar": "CAMERA,CAMERA",
    "show_default": "chosen automatically",
}
session_argument = click.argument("session", type=SESSION)
matcher_option = click.option(
    "--matcher",
    type=click.Choice([str(matcher) for matcher in Matcher]),
    default=str(Matcher.AUTO),
    callback=lambda ctx, param, value: Matcher(value),
    help=MATCHER_HELP,
)
max_instants_option = click.option(
    "--max-instants",
    type=click.IntRange(min=1),
    metavar="N",
    default=16,
    help="Use at most this many of the instants at which something moves.",
)


time_shift_option = click.option(
    "--time-shift-ms",
    "time_shifts_ms",
    type=TIME_SHIFT,
    metavar="CAMERA=MS",
    multiple=True,
    callback=lambda ctx, param, value: dict(value),
    help="Add this to a camera's times, and pair its images again. Repeat for several.",
)
out_option = click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", required=True, help="Folder for the results."
)
