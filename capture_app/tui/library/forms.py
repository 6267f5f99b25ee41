"""The questions that the sessions ask: a name, a note, which job, which format and where to."""

from pathlib import Path

from capture_app.errors import SimulshotError
from capture_app.names import check_name
from capture_app.session.library.changes import MAX_NOTE
from capture_app.session.library.listing import SessionCard, SessionState
from capture_app.tui.jobs.job_list import JobList
from capture_app.tui.jobs.kinds import EXPORTS, KINDS, REPAIR, STUDIES, VERIFY
from capture_app.tui.jobs.records import default_out
from capture_app.tui.library.choice_form import Choice, ChoiceForm, Chosen
from capture_app.tui.question import TextQuestion


def name_question(card: SessionCard) -> TextQuestion:
    """Ask for another name."""

    def check(name: str) -> str:
        try:
            check_name(name, "session")
        except SimulshotError as error:
            return str(error)
        taken = name != card.name and card.folder.with_name(name).exists()
        return f"{name} exists already" if taken else ""

    return TextQuestion(
        "Its folder and what was made of it are renamed too.", card.name, check=check, title="Rename"
    )


def note_question(card: SessionCard) -> TextQuestion:
    """Ask for the note."""

    def check(note: str) -> str:
        return f"{len(note)} characters: at most {MAX_NOTE} fit" if len(note) > MAX_NOTE else ""

    return TextQuestion(
        "One line, kept in the session.", card.note, check=check, title=f"Note of {card.name}"
    )


def job_form(card: SessionCard, jobs: JobList) -> ChoiceForm:
    """Ask what is to be made of a session, and with which options."""
    kinds = (*STUDIES, VERIFY) if card.state is SessionState.COMPLETE else (REPAIR,)

    def command_line(chosen: Chosen) -> str:
        kind = KINDS[chosen.value]
        out = default_out(kind.name, card.folder, jobs.root) if kind.writes else None
        return f"$ {kind.command_line(card.folder, out, chosen.text)}"

    def check(chosen: Chosen) -> str:
        try:
            KINDS[chosen.value].arguments(card.folder, None, chosen.text)
        except SimulshotError as error:
            return str(error)
        return ""

    return ChoiceForm(
        f"What is to be made of {card.name}?",
        [Choice(kind.name, kind.title, kind.what, kind.quick) for kind in kinds],
        label="options",
        preview=command_line,
        check=check,
    )


def export_form(card: SessionCard, folder: Path, format_name: str) -> ChoiceForm:
    """Ask for the format and the folder of an export; `folder` is proposed to hold it."""

    def check(chosen: Chosen) -> str:
        target = typed_path(chosen.text)
        if not chosen.text.strip():
            return "name a folder"
        try:
            taken = target.exists() and (not target.is_dir() or any(target.iterdir()))
        except OSError as error:
            return f"{target}: {error.strerror}"
        return f"{target} exists already: choose another folder" if taken else ""

    def command_line(chosen: Chosen) -> str:
        target = typed_path(chosen.text)
        return f"$ {EXPORTS[chosen.value].command_line(card.folder, target, '')}"

    return ChoiceForm(
        f"Export {card.name}",
        [
            Choice(name, name, kind.what, str(_free_folder(folder / f"{card.name}-{name}")))
            for name, kind in EXPORTS.items()
        ],
        label="folder",
        preview=command_line,
        check=check,
        chosen=format_name,
    )


def _free_folder(folder: Path) -> Path:
    """The folder itself, or the first of NAME-2, NAME-3 ... that is not there yet."""
    names = (folder, *(folder.with_name(f"{folder.name}-{number}") for number in range(2, 1000)))
    return next((one for one in names if not one.exists()), folder)


def typed_path(text: str) -> Path:
    """The path of a folder as a user types it."""
    return Path(text.strip()).expanduser()
