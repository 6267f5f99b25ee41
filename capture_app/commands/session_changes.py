"""`capture-app sessions` rename, note, trash, restore, empty-trash, repair, sheet and wiggle."""

import asyncio
from pathlib import Path

import click

from capture_app.commands.session_text import format_date
from capture_app.commands.shared_options import ADDRESS, ANY_PATH, confirm
from capture_app.common.address import DEFAULT_PORT, Address
from capture_app.common.errors import BadInputError
from capture_app.common.templates import render_lines
from capture_app.common.text import count
from capture_app.console.option_rules import Rule, RuledCommand
from capture_app.console.terminal import (
    SESSION,
    FiniteRange,
    answer,
    json_option,
    print_json,
    print_line,
    show_count,
    table,
    talk,
)
from capture_app.console.usage import examples
from capture_app.session.files.disk import disk_errors
from capture_app.session.files.durable import write_atomic
from capture_app.session.files.output_folder import clear_leftovers
from capture_app.session.library.changes import (
    empty_trash,
    rename_session,
    restore_session,
    set_note,
    trash_session,
    trashed_sessions,
)
from capture_app.session.reading.take_sheet import TakeSheet


@click.command(epilog=examples("capture-app sessions rename sessions/burst-001 jump"))
@click.argument("session", type=SESSION)
@click.argument("name")
@json_option
def rename(session: Path, name: str, as_json: bool) -> None:
    """Rename SESSION to NAME: its folder, its manifest and the results made from it."""
    folder = rename_session(session, name)
    answer(as_json, {"session": str(folder), "before": str(session)}, [str(folder)])


@click.command(epilog=examples("capture-app sessions note sessions/burst-001 'second try, with wind'"))
@click.argument("session", type=SESSION)
@click.argument("text")
@json_option
def note(session: Path, text: str, as_json: bool) -> None:
    """Save TEXT, one line, as the note of SESSION; '' removes it."""
    set_note(session, text)
    answer(as_json, {"session": str(session), "note": text}, [f"{session}: {text or 'no note'}"])


@click.command(epilog=examples("capture-app sessions trash sessions/burst-001"))
@click.argument("paths", metavar="SESSION...", type=SESSION, nargs=-1, required=True)
@json_option
def trash(paths: tuple[Path, ...], as_json: bool) -> None:
    """Move sessions and their results to the trash beside them, from which `restore` restores them."""
    trashed = []
    for session in paths:
        trashed.append({"session": str(session), "id": trash_session(session).id})
        if not as_json:
            print_line(f"{session} is in the trash; restore it: capture-app sessions restore {session}")
    if as_json:
        print_json({"trashed": trashed})


@click.command(epilog=examples("capture-app sessions restore sessions/burst-001"))
@click.argument("session", type=ANY_PATH, required=False)
@click.option("--as", "name", default="", metavar="NAME", show_default="as before", help="A new name for it.")
@json_option
def restore(session: Path | None, name: str, as_json: bool) -> None:
    """Restore SESSION from the trash of its folder: its earlier path, or DIR/ID with its id.

    The folder is ./sessions by default; by default, or of a folder DIR/, the latest one is restored.
    """
    session = session or Path("sessions")
    root, which = session, ""
    if not trashed_sessions(session):
        root, which = (session.parent if len(session.parts) > 1 else Path("sessions")), session.name
    folder = restore_session(root, which, name=name)
    answer(as_json, {"session": str(folder)}, [str(folder)])


def list_trash(root: Path, as_json: bool) -> None:
    """Print what is in the trash of a folder of sessions."""
    trashed = trashed_sessions(root)
    rows = [(session.id, session.name, format_date(session.trashed)) for session in trashed]
    answer(
        as_json,
        {"root": str(root), "trash": trashed},
        [table(("id", "name", "trashed (UTC)"), rows)] if rows else [],
        said="" if trashed else f"the trash of {root} is empty",
    )


@click.command(
    "empty-trash",
    epilog=examples("capture-app sessions empty-trash sessions"),
)
@click.argument("root", type=ANY_PATH, default=Path("sessions"), required=False)
@click.option("--yes", is_flag=True, help="Delete without asking.")
@json_option
def empty(root: Path, yes: bool, as_json: bool) -> None:
    """Permanently delete the trash of the folder ROOT (default: ./sessions)."""
    trashed = trashed_sessions(root)
    sessions = count(len(trashed), "session")
    if trashed and not yes:
        confirm(f"Delete {sessions} in {root} permanently?", f"{sessions} would be deleted permanently")
    deleted = empty_trash(root)
    answer(as_json, {"root": str(root), "deleted": deleted}, [f"{root}: {deleted} deleted"])


@click.command(
    cls=RuledCommand,
    rules=(Rule("--listen", "!--wait-s=0", ": no node is waited for"),),
    epilog=examples(
        "capture-app sessions repair sessions/burst-001", "capture-app sessions repair sessions --wait-s 0"
    ),
)
@click.argument("path", metavar="SESSION|ROOT", type=SESSION)
@click.option(
    "--wait-s",
    type=FiniteRange(min=0),
    default=20.0,
    metavar="S",
    help="Time for nodes to connect and send the images they still have; 0 does not wait for nodes.",
)
@click.option(
    "--listen",
    type=ADDRESS,
    default=str(Address("0.0.0.0", DEFAULT_PORT)),  # noqa: S104 - nodes are other machines
    metavar="HOST:PORT",
    help="Address to listen on: the leader's address that the nodes use.",
)
@json_option
def repair(path: Path, wait_s: float, listen: Address, as_json: bool) -> None:
    """Complete interrupted sessions: fetch images that nodes still have, and record lost ones.

    To a finished session that lacks images, a running leader adds them by itself when their node connects.

    Saved images are never changed; damaged ones are moved to the session's folder set_aside. Leftovers of a
    killed import or rendering in ROOT are removed; an earlier session that it had set aside is restored.
    """
    from capture_app.machine.repair import repair as repair_sessions
    from capture_app.protocol.log import Log

    clear_leftovers(path)
    repaired = asyncio.run(repair_sessions(path, wait_s=wait_s, address=listen, log=Log(talk)))
    failed = [session for session in repaired if not session.ok]
    lines = render_lines("repaired.txt", __package__, repaired=repaired)
    answer(as_json, {"ok": not failed, "sessions": repaired}, lines)
    if failed:
        raise BadInputError(
            f"{failed[0].session}: {failed[0].what}",
            hint="its images stay as they are; capture-app sessions verify shows what is wrong",
        )


WIGGLE_STEP_MS = 125
_replace_option = click.option("--replace", is_flag=True, help="Replace an earlier file.")


@click.command(epilog=examples("capture-app sessions sheet sessions/burst-001 --out sheet.jpg"))
@click.argument("session", type=SESSION)
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
    """Write the contact sheet of SESSION: cameras across, instants down.

    If all instants would be too tall for a picture, every Nth is on it; a smaller --width shows more.
    """
    from capture_app.session.reading.decoding import encode_image
    from capture_app.session.reading.take_sheet import contact_sheet, sheet_instants

    suffix = _check_file(out, (".jpg", ".jpeg", ".png"), replace=replace)
    opened = TakeSheet.open(session)
    shown = sheet_instants(opened, width)
    if shown.step > 1:
        talk(f"one in {shown.step} instants is shown: all {opened.instants} are too tall for a picture")
    picture = contact_sheet(opened, width, show_count("images"), shown)
    _write(out, encode_image(picture, suffix))
    answer(
        as_json,
        {
            "session": str(session),
            "sheet": str(out),
            "cameras": opened.cameras,
            "instants": opened.instants,
            "every": shown.step,
            "width": picture.shape[1],
            "height": picture.shape[0],
            "verdict": opened.verdict,
        },
        [str(out)],
    )


@click.command(epilog=examples("capture-app sessions wiggle sessions/burst-001 --out wiggle.gif"))
@click.argument("session", type=SESSION)
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
@_replace_option
@json_option
def wiggle(session: Path, out: Path, instant: int | None, width: int, replace: bool, as_json: bool) -> None:
    """Write the wiggle of SESSION: all cameras at one instant, there and back along their arc."""
    from capture_app.session.reading.take_sheet import encode_animation, wiggle_frames

    suffix = _check_file(out, (".gif", ".webp"), replace=replace)
    opened = TakeSheet.open(session)
    shown = opened.instants // 2 if instant is None else instant
    frames = wiggle_frames(opened, shown, width)
    _write(out, encode_animation(frames, suffix, WIGGLE_STEP_MS, WIGGLE_STEP_MS))
    answer(
        as_json,
        {"session": str(session), "wiggle": str(out), "instant": shown, "images": len(frames)},
        [str(out)],
    )


def _check_file(out: Path, suffixes: tuple[str, ...], *, replace: bool) -> str:
    suffix = out.suffix.lower()
    if suffix not in suffixes:
        raise BadInputError(f"--out {out} has no known suffix", hint=f"use {' or '.join(suffixes)}")
    if out.exists() and not replace:
        raise BadInputError(f"{out} exists already", hint="choose another name, or add --replace")
    return suffix


def _write(out: Path, data: bytes) -> None:
    with disk_errors(out):
        out.parent.mkdir(parents=True, exist_ok=True)
        write_atomic(out, data)
