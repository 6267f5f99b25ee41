"""Dialogs of the mode Sessions: name, note, command, import folder, and export format with folder."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

from capture_app.common.errors import BadInputError, SimulshotError
from capture_app.common.names import check_name
from capture_app.common.text import printable
from capture_app.session.exporting.exporter import load_exporters
from capture_app.session.library.changes import MAX_NOTE
from capture_app.session.library.listing import SessionCard
from capture_app.tui.jobs.run import REPAIR, STUDIES, VERIFY, Command
from capture_app.tui.question import ListQuestion, TextQuestion


def name_question(card: SessionCard) -> TextQuestion:
    """Return the dialog that asks for a session's new name."""

    def check(name: str) -> str:
        if wrong := _error_of(partial(check_name, name, "session")):
            return wrong
        taken = name != card.name and card.folder.with_name(name).exists()
        return f"{name} exists already: choose another name" if taken else ""

    return TextQuestion("Renames its folder and its results, too.", card.name, check=check, title="Rename")


def import_question(folder: str) -> TextQuestion:
    """Return the dialog for the folder to import, with `folder` as initial text."""

    def check(text: str) -> str:
        # `Path.is_dir` raises for impossible names and inaccessible folders.
        there = text.strip() and os.path.isdir(typed_path(text))  # noqa: PTH112
        return "" if there else "this folder does not exist"

    return TextQuestion(
        "A folder of videos, or another program's recording. Clips taken together are found and aligned by "
        "times, sound, flashes or motion.",
        folder,
        check=check,
        title="Import",
    )


def note_question(card: SessionCard) -> TextQuestion:
    """Return the dialog for the note."""

    return TextQuestion(
        "One line, saved with the session.",
        card.note,
        check=lambda note: (
            f"{len(note)} characters; at most {MAX_NOTE} are allowed" if len(note) > MAX_NOTE else ""
        ),
        title=f"Note of {card.name}",
    )


def command_list(card: SessionCard) -> ListQuestion:
    """Return the dialog for the command to run on a session."""
    commands = (*STUDIES, VERIFY) if card.state == "complete" else (REPAIR,)
    rows = {one.name: (one.title, one.what) for one in commands}
    return ListQuestion(f"Run a command on {card.name}", rows)


def options_question(command: Command, card: SessionCard, out: Path) -> TextQuestion:
    """Return the dialog that shows a command line and asks for its options."""
    line = command.line(card.folder, out, "OPTIONS")
    return TextQuestion(
        f"$ {line}\n\nOPTIONS; enter starts the job.",
        command.quick,
        check=lambda options: _error_of(partial(command.line, card.folder, out, options)),
        title=command.title,
    )


def format_list(card: SessionCard, format_name: str) -> ListQuestion:
    """Return the dialog for the export format, with one selected."""
    rows = {name: (name, one.help) for name, one in load_exporters().items()}
    return ListQuestion(f"Export {card.name}", rows, format_name)


def folder_question(card: SessionCard, folder: Path, format_name: str) -> TextQuestion:
    """Return the dialog for the export's folder; `folder` is the proposed parent."""

    def check(text: str) -> None:
        target = typed_path(text)
        if not text.strip():
            raise BadInputError("no folder is given", hint="type its path")
        try:
            taken = target.exists() and (not target.is_dir() or any(target.iterdir()))
        except OSError as error:
            raise BadInputError(f"{target}: {error.strerror}", hint="choose another folder") from error
        if taken:
            raise BadInputError(f"{target} exists already", hint="choose another folder")

    return TextQuestion(
        "Folder to write, new or empty.",
        str(_free_folder(folder / f"{card.name}-{format_name}")),
        check=lambda text: _error_of(partial(check, text)),
        title=f"Export {card.name} to {format_name}",
    )


def _error_of(do: Callable[[], object]) -> str:
    """Return the error message of an action, or an empty string."""
    try:
        do()
    except SimulshotError as error:
        return printable(str(error))
    return ""


def _free_folder(folder: Path) -> Path:
    """Return the folder, or the first of NAME-2, NAME-3 ... that does not exist."""
    names = (folder, *(folder.with_name(f"{folder.name}-{number}") for number in range(2, 1000)))
    return next((one for one in names if not one.exists()), folder)


def typed_path(text: str) -> Path:
    """Return the path that a user typed."""
    # `Path.expanduser` raises for an unknown home directory, such as a half-typed name.
    return Path(os.path.expanduser(text.strip()))  # noqa: PTH111
