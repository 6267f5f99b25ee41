"""`capture-app sessions export`: sessions in other programs' formats."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import click

from capture_app.commands.shared_options import ANY_PATH, restrict_file_access
from capture_app.common.grouping import grouped
from capture_app.common.plugins import plugin_names
from capture_app.console.known_words import FORMATS, RESULTS
from capture_app.console.terminal import SESSION, FiniteRange, answer, json_option, show_count, talk
from capture_app.console.usage import examples, write_plugins
from capture_app.session.exporting.exporter import (
    GROUP,
    Exporter,
    load_exporter,
    load_exporters,
    own_options,
)
from capture_app.session.reading.reader import Session

_KINDS: dict[type[Any], dict[str, Any]] = {
    bool: {"is_flag": True},
    int: {"type": click.IntRange(min=0)},
    float: {"type": FiniteRange(min=0, min_open=True)},
    Path: {"type": ANY_PATH},
}
"""How an exporter's option is typed, by the type of its value."""
_LOADED = f"{__name__}.loaded"


class _Format(click.Choice[str]):
    """Choice of a format, which names the one that holds what another word asks for."""

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """Return the format. Raises BadParameter, with the format that is meant."""
        for name, words in FORMATS.items():
            if value.casefold() in words.split() and name in self.choices:
                self.fail(f"{value!r} is not a format: --to {name} is for it", param, ctx)
        for line, words in RESULTS.items():
            if value.casefold() in words.split():
                self.fail(f"{value!r} is not a format of images: see {line}", param, ctx)
        return super().convert(value, param, ctx)


class _ExportCommand(click.Command):
    """Command with the options of the named format, or of all formats for help and errors."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Load the exporter that is named, and all others only where an option is not one of its own."""
        words = [word for arg in args for word in (arg.split("=", 1) if arg.startswith("--to=") else [arg])]
        named = [name for option, name in pairwise(words) if option == "--to"]
        if len(named) != 1 or named[0] not in plugin_names(GROUP) or {"-h", "--help"} & set(args):
            return super().parse_args(ctx, args)
        ctx.meta[_LOADED] = {named[0]: load_exporter(named[0])}
        try:
            return super().parse_args(ctx, list(args))
        except click.NoSuchOption:
            del ctx.meta[_LOADED]
            return super().parse_args(ctx, args)

    def get_params(self, ctx: click.Context) -> list[click.Parameter]:
        """Return the parameters: general ones first, then the options of the formats."""
        to = click.Option(
            ["--to", "name"], type=_Format(plugin_names(GROUP)), required=True, help="Format: see below."
        )
        stated = grouped(
            (option, (format_name, *how))
            for format_name, exporter in self._exporters(ctx).items()
            for option, how in own_options(exporter).items()
        )
        own = [
            click.Option(
                [f"--{name.replace('_', '-')}"],
                metavar=option.metavar or None,
                help=f"For {', '.join(format_name for format_name, *_ in uses)}: {option.help}.",
                **({"type": click.Choice(option.choices)} if option.choices else _KINDS.get(kind, {})),
            )
            for name, uses in stated.items()
            for _, kind, option in uses[:1]
        ]
        session, *general = super().get_params(ctx)
        at = next(place for place, argument in enumerate(general) if argument.name == "as_json")
        return [session, to, *general[:at], *own, *general[at:]]

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the formats, then the examples."""
        write_plugins(
            formatter, "Formats", [(name, exporter.help) for name, exporter in self._exporters(ctx).items()]
        )
        super().format_epilog(ctx, formatter)

    def _exporters(self, ctx: click.Context) -> dict[str, Exporter]:
        if _LOADED not in ctx.meta:
            ctx.meta[_LOADED] = load_exporters()
        loaded: dict[str, Exporter] = ctx.meta[_LOADED]
        return loaded


@click.command(
    "export",
    cls=_ExportCommand,
    epilog=examples("capture-app sessions export sessions/burst-001 --to mp4 --out videos"),
)
@click.argument("session", type=SESSION)
@click.option("--out", type=ANY_PATH, metavar="DIR", required=True, help="New or empty folder to write.")
@click.option(
    "--hard-link", "link", is_flag=True, help="Hard-link image files where possible instead of copying them."
)
@click.option(
    "--lossless", is_flag=True, help="Write videos and redrawn images losslessly. Files become much larger."
)
@json_option
def export(session: Path, name: str, out: Path, as_json: bool, **chosen: Any) -> None:
    """Convert SESSION to the format of another program.

    frames.csv in the result has the times of all frames, and which images are missing.
    """
    from capture_app.companions.exporting.export_session import export_session

    restrict_file_access()
    given = {option: value for option, value in chosen.items() if value is not None and value is not False}
    warned: list[str] = []

    def warn(note: str) -> None:
        warned.append(note)
        talk(note)

    burst = export_session(Session.open(session), name, out, show_count("images"), warn, **given)
    answer(
        as_json,
        {"folder": str(out), "format": name, "images": len(burst.images), "notes": burst.notes},
        [str(out)],
    )
    for note in burst.notes:
        if note not in warned:
            talk(note)
