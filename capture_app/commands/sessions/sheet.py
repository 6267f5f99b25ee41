"""`capture-app sessions` sheet and wiggle: a take as a picture to show around."""

from pathlib import Path

import click

from capture_app.commands.options import ANY_PATH
from capture_app.errors import BadInputError
from capture_app.session.files.disk import disk_error
from capture_app.session.files.durable import write_atomic
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.session.reading.verdict import judge
from capture_app.terminal import FiniteRange, json_option, print_json, print_line, show_count
from capture_app.usage import examples

_replace_option = click.option("--replace", is_flag=True, help="Replace an earlier file.")


@click.command(epilog=examples("capture-app sessions sheet sessions/burst-001 --out sheet.jpg"))
@click.argument("session", type=ANY_PATH)
@click.option("--out", type=ANY_PATH, metavar="FILE", required=True, help="Picture to write: .jpg or .png.")
@click.option(
    "--width",
    type=click.IntRange(32, 4000),
    metavar="PX",
    default=240,
    help="Width of each image on the sheet.",
)
@_replace_option
@json_option
def sheet(session: Path, out: Path, width: int, replace: bool, as_json: bool) -> None:
    """Write the contact sheet of SESSION: cameras across, instants down."""
    import cv2

    from capture_app.session.reading.sheet_pictures import contact_sheet

    suffix = _check_file(out, (".jpg", ".jpeg", ".png"), replace=replace)
    opened = TakeSheet.open(session)
    picture = contact_sheet(opened, width, show_count("images"))
    _write(out, bytes(cv2.imencode(suffix, picture)[1].tobytes()))
    if as_json:
        about = {"cameras": opened.cameras, "instants": opened.instants}
        size = {"width": picture.shape[1], "height": picture.shape[0]}
        verdict = judge(opened.session.manifest)
        print_json({"session": str(session), "sheet": str(out), **about, **size, "verdict": verdict})
    else:
        print_line(str(out))


@click.command(epilog=examples("capture-app sessions wiggle sessions/burst-001 --out wiggle.gif"))
@click.argument("session", type=ANY_PATH)
@click.option(
    "--out", type=ANY_PATH, metavar="FILE", required=True, help="Animation to write: .gif or .webp."
)
@click.option(
    "--instant",
    type=click.IntRange(0),
    metavar="N",
    show_default="the middle one",
    help="Instant to show, from 0 on.",
)
@click.option(
    "--width", type=click.IntRange(32, 4000), metavar="PX", default=480, help="Width of the animation."
)
@click.option("--fps", type=FiniteRange(0.5, 50), metavar="FPS", default=8.0, help="Images per second.")
@_replace_option
@json_option
def wiggle(
    session: Path, out: Path, instant: int | None, width: int, fps: float, replace: bool, as_json: bool
) -> None:
    """Write the wiggle of SESSION: all cameras at one instant, there and back along their arc."""
    from capture_app.session.reading.sheet_pictures import encode_animation, wiggle_frames

    suffix = _check_file(out, (".gif", ".webp"), replace=replace)
    opened = TakeSheet.open(session)
    shown = opened.instants // 2 if instant is None else instant
    frames = list(wiggle_frames(opened, shown, width))
    _write(out, encode_animation(frames, fps, suffix))
    if as_json:
        print_json({"session": str(session), "wiggle": str(out), "instant": shown, "images": len(frames)})
    else:
        print_line(str(out))


def _check_file(out: Path, suffixes: tuple[str, ...], *, replace: bool) -> str:
    suffix = out.suffix.lower()
    if suffix not in suffixes:
        raise BadInputError(f"--out {out} has no known suffix", hint=f"it may end in {', '.join(suffixes)}")
    if out.exists() and not replace:
        raise BadInputError(f"{out} is there already", hint="choose another name, or --replace")
    return suffix


def _write(out: Path, data: bytes) -> None:
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(out, data)
    except OSError as error:
        raise disk_error(error, out) from error
