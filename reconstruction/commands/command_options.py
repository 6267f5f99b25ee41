"""Options shared by several commands, and the parsing of their values."""

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

import click
import msgspec

from capture_app.console.terminal import ParsedType, talk
from reconstruction.common.memory import limited_memory, parse_size
from reconstruction.session.conditions import DISTINCT, DISTINCT_MS, MAX_OFFSET_MS, SYNCED, Condition
from reconstruction.session.picture_checksums import checked_pictures

if TYPE_CHECKING:
    from reconstruction.multiview.matcher import Matcher


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
    found: list[int] = []
    for part in text.split(","):
        ends = [int(end) if end.strip().isdecimal() else -1 for end in part.split("-", 1)]
        if not 0 <= ends[0] <= ends[-1] < MAX_INSTANTS:
            raise click.BadParameter(f"{text!r} is not a list of instants, as in 0-9,20")
        found += range(ends[0], ends[-1] + 1)
    return tuple(dict.fromkeys(found))


def flag(*names: str, **settings: Any) -> msgspec.Meta:
    """Annotate a field of a study's `Options` with the names and settings of click's `Option`.

    The field's default is the option's: `points: Annotated[int, flag("--points", help="...")] = 3`.
    """
    return msgspec.Meta(extra={"names": names, **settings})


def pair_flag(*names: str, use: str, hidden: bool = False) -> msgspec.Meta:
    """Annotate a field as `flag` does, for two cameras and their use; `hidden` is for earlier names."""
    return flag(*names, hidden=hidden, **_pair_settings(use))


def study_options(options: type[msgspec.Struct]) -> Iterator[click.Option]:
    """Yield the command line options of a study's `Options`."""
    hints = get_type_hints(options, include_extras=True)
    for one in msgspec.structs.fields(options):
        for meta in getattr(hints[one.name], "__metadata__", ()):
            settings = dict(meta.extra)
            default = str(one.default) if isinstance(one.default, str) else one.default
            yield click.Option([*settings.pop("names"), one.name], default=default, **settings)


def memory_option(command: Callable[..., None]) -> Callable[..., None]:
    """Add the option `--memory` to a command, limit its dense work, and report what the limit changed.

    Also checks images as `checksums_option` asks, and reports those that changed since they were saved.
    """

    @click.option(
        "--memory",
        type=ParsedType("size", parse_size),
        metavar="SIZE",
        show_default="half of what is free, at most 3 GiB",
        help="Memory for pictures and dense work, as in 800MB or 8GB. Larger work is reduced in size.",
    )
    @wraps(command)
    def limited(
        *arguments: Any, memory: int | None, require_checksums: bool | None = None, **options: Any
    ) -> None:
        with limited_memory(memory) as budget, checked_pictures(required=bool(require_checksums)) as checks:
            command(*arguments, **options)
        for note in (*(checks.notes if require_checksums is not None else ()), *budget.notes):
            talk(note)

    return limited


def pair_option(*names: str, use: str) -> Callable[..., Any]:
    """Return an option for two cameras and their use."""
    return click.option(*names, **_pair_settings(use))


def _pair_settings(use: str) -> dict[str, Any]:
    return {
        "type": parse_pair,
        "metavar": "CAMERA,CAMERA",
        "show_default": "chosen automatically",
        "help": f"The two cameras for {use}.",
    }


checksums_option = click.option(
    "--require-checksums",
    is_flag=True,
    help="Refuse pictures that changed since they were saved, instead of only naming them.",
)
session_argument = click.argument("session", type=click.Path(path_type=Path))
instant_option = click.option(
    "--instant",
    type=click.IntRange(min=0),
    metavar="K",
    default=0,
    help="Instant of the burst, counted from 0.",
)


def _parse_matcher(ctx: click.Context, param: click.Parameter, value: str) -> "Matcher":
    from reconstruction.multiview.matcher import Matcher

    return Matcher(value)


MATCHER: dict[str, Any] = {
    "type": click.Choice(["auto", "sweep", "patchmatch"]),
    "callback": _parse_matcher,
    "help": "Method for depth from all cameras. sweep runs on the CPU; patchmatch is COLMAP's and needs an "
    "NVIDIA GPU. auto is sweep, which finds more.",
}
matcher_option = click.option("--matcher", default="auto", **MATCHER)
max_instants_option = click.option(
    "--max-instants",
    type=click.IntRange(min=1),
    metavar="N",
    default=16,
    help="Use at most this many of the instants at which something moves.",
)


def _parse_time_shifts(
    ctx: click.Context, param: click.Parameter, texts: tuple[str, ...]
) -> dict[str, float]:
    """Parse CAMERA=MS of each text."""
    found = {}
    for text in texts:
        camera, _, value = (part.strip() for part in text.rpartition("="))
        found[camera] = math.nan
        with suppress(ValueError):
            found[camera] = float(value)
        if not camera or not abs(found[camera]) < MAX_OFFSET_MS:
            raise click.BadParameter(f"{text!r} is not CAMERA=MS, as in cam1=-12.5")
    return found


time_shift_option = click.option(
    "--time-shift-ms",
    "time_shifts_ms",
    metavar="CAMERA=MS",
    multiple=True,
    callback=_parse_time_shifts,
    help="Add this to a camera's times, and pair its images again. Repeat for several.",
)
out_option = click.option(
    "--out", type=click.Path(path_type=Path), metavar="DIR", required=True, help="Folder for the results."
)
