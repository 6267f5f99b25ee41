"""`capture-app panel`: show the time to cameras, read it from their images, build a panel of LEDs."""

import asyncio
import socket
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from capture_app.commands.shared_options import FOLDER, run_until_stopped
from capture_app.common.errors import SimulshotError
from capture_app.common.templates import render_lines
from capture_app.common.text import duration, pretty_json
from capture_app.companions.panel.screen import DEFAULT_PORT
from capture_app.console.option_rules import Rule, RuledCommand
from capture_app.console.terminal import (
    SESSION,
    FiniteRange,
    answer,
    json_option,
    show_count,
    table,
    talk,
)
from capture_app.console.usage import examples

if TYPE_CHECKING:
    from capture_app.companions.panel.pair_errors import PairTable, SessionErrors
    from capture_app.companions.panel.session_times import SessionTimes

RESULT = "panel.json"


@click.command(
    epilog=examples(
        "capture-app panel read sessions/burst-001", "capture-app panel read sessions/videos --apply"
    )
)
@click.argument("session", type=SESSION)
@click.option("--out", type=FOLDER, metavar="DIR", help=f"Folder to write {RESULT} to, with all figures.")
@click.option(
    "--apply",
    is_flag=True,
    help="Correct the times of an imported session by its panel, and pair its images again.",
)
@json_option
def read(session: Path, out: Path | None, apply: bool, as_json: bool) -> None:
    """Measure the time differences between cameras from a panel in the pictures of SESSION.

    The panel is detected by its markers, in imported sessions too. Total is the difference that the panel
    shows, phase the difference by the session's timestamps, and clock the rest, the clock errors.
    """
    import msgspec

    from capture_app.companions.panel.pair_errors import rig_errors
    from capture_app.companions.panel.session_times import read_session
    from capture_app.session.files.output_folder import OutputFolder, replaces_only
    from capture_app.session.reading.reader import Session

    opened = Session.open(session)
    times = read_session(opened, show_count("pictures"))
    figures = _as_json(times, rig_errors(times))
    if apply:
        from capture_app.companions.panel.session_alignment import apply_panel

        figures["applied"] = {
            name: msgspec.to_builtins(correction) for name, correction in apply_panel(opened, times).items()
        }
        figures["words"]["remarks"] += [
            f"{name}: times corrected by {at['offset_ns'] / 1e6:+.2f} ± {at['uncertainty_ns'] / 1e6:.2f} ms"
            for name, at in figures["applied"].items()
            if at.get("uncertainty_ns")
        ]
    if out is not None:
        with OutputFolder(out, replaces_only({RESULT})) as output:
            (output.folder / RESULT).write_bytes(pretty_json(figures))
    answer(as_json, figures, _lines(figures["words"]))


def _as_json(times: "SessionTimes", errors: "SessionErrors") -> dict[str, Any]:
    import msgspec

    return {
        "panel": times.panel.name,
        "tick_ns": times.panel.tick_ns,
        "cycle_ns": times.panel.cycle_ns,
        "exposures_known": times.exposures_known,
        "pictures": [
            {
                "camera": picture.image.camera,
                "instant": picture.image.instant,
                "panel_ns": picture.panel_ns,
                "uncertainty_ns": picture.uncertainty_ns,
                "stamp_ns": picture.stamp_ns,
                "stamp_uncertainty_ns": picture.image.uncertainty_ns,
                "exposure_ns": picture.reading.shutter.exposure_ns,
                "row_time_ns": picture.reading.shutter.row_time_ns,
                "markers": picture.reading.markers,
                "misfit": picture.reading.residual,
            }
            for picture in times.pictures
        ],
        "refusals": [
            {"camera": image.camera, "instant": image.instant, "reason": reason}
            for image, reason in times.refusals
        ],
        "errors": msgspec.to_builtins(errors),
        "words": _words(times, errors),
    }


def _words(times: "SessionTimes", errors: "SessionErrors") -> dict[str, Any]:
    """Return the verdict, tables and notes of a panel reading, as the terminal and the screen show them."""
    name = times.panel.name
    tables = [
        (
            f"{name}: time differences (phase: by timestamps; clock: the rest)",
            ("error", "mean abs", "std", "largest", "mean", "instants"),
            _apart(errors),
        ),
        (
            f"{name} in the pictures",
            ("read", "refused", "95 % error", "exposure", "row time"),
            [_camera_row(times, camera) for camera in times.cameras],
        ),
    ]
    verdict, *remarks = render_lines("reading.txt", __package__, times=times, errors=errors)
    return {
        "verdict": verdict,
        "tables": [
            {"caption": caption, "groups": [""] * len(columns), "columns": columns, "rows": rows}
            for caption, columns, rows in tables
            if rows
        ],
        "remarks": remarks,
    }


def _lines(words: Mapping[str, Any]) -> Iterator[str]:
    yield words["verdict"]
    for shown in words["tables"]:
        yield f"\n{shown['caption']}"
        yield table(("cameras", *shown["columns"]), shown["rows"])
    yield "\n" + "\n".join(words["remarks"])


def _apart(errors: "SessionErrors") -> "list[tuple[str, ...]]":
    tables = [(" - ".join(pair.cameras), pair) for pair in errors.pairs]
    every = [("all pairs", errors.all)] if len(errors.pairs) > 1 and errors.all is not None else []
    return [row for name, pairs in tables + every for row in _rows(name, pairs)]


def _camera_row(times: "SessionTimes", name: str) -> tuple[str, ...]:
    mine = [picture for picture in times.pictures if picture.image.camera == name]
    refused = sum(image.camera == name for image, _ in times.refusals)
    if not mine:
        return name, "0", str(refused), "-", "-", "-"
    middle = sorted(mine, key=lambda picture: picture.uncertainty_ns)[len(mine) // 2]
    return (
        name,
        str(len(mine)),
        str(refused),
        f"±{duration(middle.uncertainty_ns)}",
        duration(middle.reading.shutter.exposure_ns),
        duration(middle.reading.shutter.row_time_ns),
    )


def _rows(name: str, table: "PairTable") -> "list[tuple[str, ...]]":
    kinds = (("total", table.total), ("phase", table.phase), ("clock", table.clock))
    return [
        (
            name if kind == "total" else "",
            kind,
            duration(summary.mean_abs_ns),
            duration(summary.std_ns),
            duration(summary.max_ns),
            duration(summary.bias_ns, signed=True),
            str(table.count) if kind == "total" else "",
        )
        for kind, summary in kinds
    ]


@click.command(
    cls=RuledCommand,
    rules=(Rule("--host --port", "!--save", ": a file is not served"),),
    epilog=examples("capture-app panel show", "capture-app panel show --host 0.0.0.0"),
)
@click.option(
    "--host",
    default="127.0.0.1",
    help="Address that the page listens on; 0.0.0.0 shows it to phones of the network.",
)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=DEFAULT_PORT,
    metavar="PORT",
    help="TCP port of the page; 0 chooses a free one.",
)
@click.option(
    "--save",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Write the page to FILE (.html) instead, for a screen without a network.",
)
@json_option
def show(host: str, port: int, save: Path | None, as_json: bool) -> None:
    """Serve a page that shows a time code in any browser, until Ctrl-C.

    Open it full-screen on one screen that all cameras see. It measures the refresh rate, and draws the number
    of each refresh. With --host 0.0.0.0 a phone can show it: scan the QR code.
    """
    from capture_app.common.address import listen_tcp
    from capture_app.companions.panel.screen import page_html

    if save is not None:
        _save(save, page_html(), as_json)
        return
    with listen_tcp(host, port) as listening:
        run_until_stopped(_serve(listening, page_html(), as_json))


def _save(file: Path, page: bytes, as_json: bool) -> None:
    if file.suffix.lower() not in (".html", ".htm"):
        raise click.BadParameter(f"{file} does not end in .html", param_hint="--save")
    try:
        file.write_bytes(page)
    except OSError as error:
        raise SimulshotError(
            f"cannot write {file}: {error.strerror or error}", hint="choose another file with --save"
        ) from error
    answer(as_json, {"file": str(file)}, [str(file)])


async def _serve(listening: socket.socket, page: bytes, as_json: bool) -> None:
    from capture_app.common.address import ANY_HOST, Address, reachable_host
    from capture_app.web.own_page import served_page

    host, port = listening.getsockname()[:2]
    outside = host in ANY_HOST
    url = f"http://{Address(reachable_host(host, listening.family), port)}/"
    async with served_page(listening, page):
        answer(as_json, {"url": url}, [url])
        if outside and sys.stderr.isatty():
            import segno

            segno.make(url, micro=False).terminal(sys.stderr, compact=True)
        who = "all machines of the network" if outside else "this machine only (--host 0.0.0.0: phones too)"
        talk(f"the page is served to {who}; Ctrl-C stops")
        await asyncio.Event().wait()


@click.command(epilog=examples("capture-app panel sketch --out panel"))
@click.option(
    "--out",
    type=FOLDER,
    required=True,
    metavar="DIR",
    help="Folder for the sketch, its wiring and the frame.",
)
@click.option(
    "--panel",
    "name",
    type=click.Choice(["led-200us", "led-10ms", "led-pair"]),
    default="led-200us",
    metavar="NAME",
    help="led-200us (repeats after 20 ms), led-10ms (1 s), or led-pair: both side by side.",
)
@click.option(
    "--pitch-mm",
    type=FiniteRange(4, 30),
    default=10.0,
    metavar="MM",
    help="Distance between neighbouring LEDs.",
)
@click.option(
    "--page",
    type=click.Choice(["a4", "a3", "letter"], case_sensitive=False),
    default="a4",
    help="Paper to print the frame on.",
)
@json_option
def sketch(out: Path, name: str, pitch_mm: float, page: str, as_json: bool) -> None:
    """Write the files to build the paper's LED panel, which resolves microseconds; a screen: milliseconds.

    They are a sketch for an Arduino Uno or Nano, its wiring, and the frame with markers to print at true
    size. The sketch was tested on a simulated board only; no such panel has been built yet.
    """
    from capture_app.companions.panel.led_build import write_sketch
    from capture_app.companions.panel.pattern import PANELS

    panel = PANELS[name]
    paths = [str(file) for file in write_sketch(panel, out, paper=page, pitch_mm=pitch_mm)]
    answer(
        as_json,
        {"panel": panel.name, "tick_us": panel.tick_ns / 1000, "files": paths},
        paths,
        said=f"start with {out / 'WIRING.md'}; print {out / 'frame.pdf'} at 100 %",
    )


@click.group(
    short_help="Show a time code to all cameras, and measure their time differences.",
    epilog=examples("capture-app panel show", "capture-app panel read sessions/burst-001"),
)
def panel() -> None:
    """Show a time code to all cameras, and measure their time differences from their pictures.

    First `show` it, on a screen that all cameras see; then take a burst, and `read` the session.
    """


for command in (show, read, sketch):
    panel.add_command(command)
