"""Dialogs of the mode Sessions: name, note, command, import folder, and export format with folder."""

import os
from functools import partial
from pathlib import Path

from capture_app.common.errors import BadInputError
from capture_app.common.names import check_name, free_name
from capture_app.session.exporting.exporter import load_exporters
from capture_app.session.library.changes import check_note
from capture_app.session.library.listing import SessionCard
from capture_app.tui.jobs.run import REPAIR, STUDIES, VERIFY, Command
from capture_app.tui.question import ListQuestion, TextQuestion


def name_question(card: SessionCard) -> TextQuestion:
    """Return the dialog that asks for a session's new name."""

    def check(name: str) -> None:
        check_name(name, "session")
        if name != card.name and card.folder.with_name(name).exists():
            raise BadInputError(f"{name} exists already", hint="choose another name")

    return TextQuestion("Renames its folder and its results, too.", card.name, check=check, title="Rename")


def import_question(folder: str) -> TextQuestion:
    """Return the dialog for the folder to import, with `folder` as initial text."""

    def check(text: str) -> None:
        # `Path.is_dir` raises for impossible names and inaccessible folders.
        if not text.strip() or not os.path.isdir(typed_path(text)):  # noqa: PTH112
            raise BadInputError("this folder does not exist")

    return TextQuestion(
        "A folder of videos, or another program's recording. Clips taken together are found and aligned by "
        "times, sound, flashes or motion.",
        folder,
        check=check,
        title="Import",
    )


def note_question(card: SessionCard) -> TextQuestion:
    """Return the dialog for the note."""
    text = "One line, saved with the session."
    return TextQuestion(text, card.note, check=check_note, title=f"Note of {card.name}")


def command_list(card: SessionCard) -> ListQuestion:
    """Return the dialog for the command to run on a session."""
    commands = (*STUDIES, VERIFY) if card.state == "complete" else (REPAIR,)
    return ListQuestion(
        f"Run a command on {card.name}", {one.name: (one.title, one.what) for one in commands}
    )


def options_question(command: Command, card: SessionCard, out: Path) -> TextQuestion:
    """Return the dialog that shows a command line and asks for its options."""
    return TextQuestion(
        f"$ {command.line(card.folder, out, 'OPTIONS')}\n\nOPTIONS; enter starts the job.",
        command.quick,
        check=partial(command.line, card.folder, out),
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
        str(folder / free_name(f"{card.name}-{format_name}", [one.name for one in folder.glob("*")])),
        check=check,
        title=f"Export {card.name} to {format_name}",
    )


def typed_path(text: str) -> Path:
    """Return the path that a user typed."""
    # `Path.expanduser` raises for an unknown home directory, such as a half-typed name.
    return Path(os.path.expanduser(text.strip()))  # noqa: PTH111
