"""`capture-app panel sketch`."""

from pathlib import Path

import click

from capture_app.commands.options import FOLDER
from capture_app.terminal import FiniteRange, json_option, print_json, print_line, talk
from capture_app.usage import examples


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
    default="led-200us",
    metavar="NAME",
    help="led-200us (repeats after 20 ms), led-10ms (1 s), or led-pair: both side by side.",
)
@click.option(
    "--pitch-mm", type=FiniteRange(4, 30), default=10.0, metavar="MM", help="From one LED to the next."
)
@click.option(
    "--page",
    type=click.Choice(["a4", "a3", "letter"], case_sensitive=False),
    default="a4",
    help="Paper to print the frame on.",
)
@json_option
def sketch(out: Path, name: str, pitch_mm: float, page: str, as_json: bool) -> None:
    """Write what it takes to build the paper's LED panel: microseconds, where a screen tells milliseconds.

    A sketch for an Arduino Uno or Nano, its wiring, and the frame with its markers to print at true size. The
    sketch has been run in a simulated board; nobody has built this panel yet.
    """
    from capture_app.errors import BadInputError
    from capture_app.panel.catalog import panel_named
    from capture_app.panel.leds.sketch import write_sketch

    panel = panel_named(name)
    if panel.is_screen:
        raise BadInputError(f"{name} is a screen's", hint="capture-app panel show draws it")
    files = write_sketch(panel, out, paper=page, pitch_mm=pitch_mm)
    if as_json:
        print_json(
            {"panel": panel.name, "tick_us": panel.tick_ns / 1000, "files": [str(file) for file in files]}
        )
        return
    for file in files:
        print_line(str(file))
    talk(f"begin with {out / 'WIRING.md'}; print {out / 'frame.pdf'} at 100 %")
