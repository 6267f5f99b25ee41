"""`capture-app sessions` rename, note, trash, restore and empty-trash: keeping a folder of sessions tidy."""

import sys
from pathlib import Path

import click

from capture_app.commands.options import ANY_PATH
from capture_app.commands.sessions.text import format_date
from capture_app.errors import NotAvailableError
from capture_app.session.library.changes import rename_session, set_note
from capture_app.session.library.trash import (
    empty_trash,
    restore_session,
    trash_session,
    trashed_sessions,
)
from capture_app.terminal import json_option, print_json, print_line, print_table, talk
from capture_app.text import count
from capture_app.usage import examples

_root_argument = click.argument("root", type=ANY_PATH, default=Path("sessions"), required=False)


@click.command(epilog=examples("capture-app sessions rename sessions/burst-001 jump"))
@click.argument("session", type=ANY_PATH)
@click.argument("name")
@json_option
def rename(session: Path, name: str, as_json: bool) -> None:
    """Rename SESSION to NAME: its folder, its manifest and the results made from it."""
    folder = rename_session(session, name)
    if as_json:
        print_json({"session": str(folder), "before": str(session)})
    else:
        print_line(str(folder))


@click.command(epilog=examples("capture-app sessions note sessions/burst-001 'second try, with wind'"))
@click.argument("session", type=ANY_PATH)
@click.argument("text")
@json_option
def note(session: Path, text: str, as_json: bool) -> None:
    """Save TEXT, one line, as the note of SESSION; '' removes it."""
    set_note(session, text)
    if as_json:
        print_json({"session": str(session), "note": text})
    else:
        print_line(f"{session}: {text}" if text else f"{session}: no note")


@click.command(epilog=examples("capture-app sessions trash sessions/burst-001"))
@click.argument("paths", metavar="SESSION...", type=ANY_PATH, nargs=-1, required=True)
@json_option
def trash(paths: tuple[Path, ...], as_json: bool) -> None:
    """Move sessions and their results to the trash beside them, from which `restore` brings them back."""
    trashed = []
    for session in paths:
        trashed.append({"session": str(session), "id": trash_session(session).id})
        if not as_json:
            print_line(f"{session}: in the trash; restore it with: capture-app sessions restore {session}")
    if as_json:
        print_json({"trashed": trashed})


@click.command(epilog=examples("capture-app sessions restore sessions/burst-001"))
@click.argument("session", type=ANY_PATH, required=False)
@click.option("--as", "name", default="", metavar="NAME", show_default="as before", help="A new name for it.")
@click.option(
    "--root",
    type=ANY_PATH,
    metavar="DIR",
    show_default="the folder of SESSION, else ./sessions",
    help="Folder of sessions whose trash is meant.",
)
@json_option
def restore(session: Path | None, name: str, root: Path | None, as_json: bool) -> None:
    """Bring SESSION back from the trash: its earlier path, or its id there; the latest one if not given."""
    default = Path("sessions")
    if session is not None and len(session.parts) > 1:
        default = session.parent
    folder = restore_session(root or default, "" if session is None else session.name, name=name)
    if as_json:
        print_json({"session": str(folder)})
    else:
        print_line(str(folder))


def list_trash(root: Path, as_json: bool) -> None:
    """Print what is in the trash of a folder of sessions."""
    found = trashed_sessions(root)
    if as_json:
        print_json({"root": str(root), "trash": found})
    elif found:
        print_table(("id", "name", "trashed (UTC)"), [(o.id, o.name, format_date(o.trashed)) for o in found])
    else:
        talk(f"the trash of {root} is empty")


@click.command(
    "empty-trash",
    epilog=examples("capture-app sessions empty-trash sessions"),
)
@_root_argument
@click.option("--yes", is_flag=True, help="Do not ask.")
@json_option
def empty(root: Path, yes: bool, as_json: bool) -> None:
    """Delete for good what is in the trash of the folder ROOT (default: ./sessions)."""
    found = trashed_sessions(root)
    if found and not yes:
        if not sys.stdin.isatty():
            raise NotAvailableError(
                f"this would delete {count(len(found), 'session')} for good", hint="--yes does not ask"
            )
        click.confirm(f"Delete {count(len(found), 'session')} in {root} for good?", abort=True, err=True)
    deleted = empty_trash(root)
    if as_json:
        print_json({"root": str(root), "deleted": deleted})
    else:
        print_line(f"{root}: {deleted} deleted")
