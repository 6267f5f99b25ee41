"""Dialogs of the mode Sessions: name, note, command, import folder, and export format with folder."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from textual.content import Content
from textual.widgets import Input, OptionList, Static

from capture_app.common.errors import BadInputError, SimulshotError
from capture_app.common.names import check_name
from capture_app.common.text import printable
from capture_app.session.exporting.exporter import load_exporters
from capture_app.session.library.changes import MAX_NOTE
from capture_app.session.library.listing import SessionCard
from capture_app.tui.jobs.run import EXPORTS, REPAIR, STUDIES, VERIFY, Command
from capture_app.tui.jobs.runs import Runs
from capture_app.tui.question import BoxDialog, TextQuestion


class CommandForm(BoxDialog[tuple[Command, str] | None]):
    """List of commands, and a line of text for the selected one.

    Enter returns both; Tab moves to the line of text and back; Escape returns None.
    """

    def __init__(
        self,
        title: str,
        commands: Mapping[str, Command],
        texts: Sequence[str],
        typed: Callable[[Command, str], str],
        *,
        label: str,
        chosen: str = "",
    ) -> None:
        """`commands` by display name; `texts` are the initial texts of their lines.

        `typed` returns the equivalent command line, and raises SimulshotError for an invalid text. `label`
        names the line; `chosen` is the name selected first.
        """
        wide = max(map(len, commands))
        rows = [
            Content.assemble((f"{name:<{wide}}", "bold"), (f"  {one.what}", "$foreground-muted"))
            for name, one in commands.items()
        ]
        self._commands, self._texts, self._typed = list(commands.values()), list(texts), typed
        self._first = list(commands).index(chosen) if chosen in commands else 0
        self._options = OptionList(*rows)
        self._line = Input(select_on_focus=False)
        self._wrong = Static("", classes="wrong")
        self._preview = Static("", classes="preview")
        super().__init__(
            title,
            self._options,
            Static(Content(label), classes="label"),
            self._line,
            self._wrong,
            self._preview,
            subtitle=f"enter starts · tab edits the {label} · esc cancels",
        )

    def on_mount(self) -> None:
        """Focus the list and select the first command."""
        self._options.focus()
        self._options.highlighted = self._first

    def on_option_list_option_highlighted(self, event: OptionList.OptionHighlighted) -> None:
        """Show the text of the selected command."""
        self._line.value = self._texts[event.option_index]
        self._show()

    def on_input_changed(self, event: Input.Changed) -> None:
        """Store the text of the selected command."""
        self._texts[self._options.highlighted or 0] = event.value
        self._show()

    @property
    def _chosen(self) -> tuple[Command, str]:
        at = self._options.highlighted or 0
        return self._commands[at], self._texts[at]

    def _take(self) -> None:
        if self._show():
            self.dismiss(self._chosen)
        else:
            # The text has to change before anything can start.
            self._wrong.add_class("-refused")
            self._line.focus()

    on_input_submitted = on_option_list_option_selected = _take

    def _show(self) -> bool:
        """Show the command line or the error; return whether there is no error."""
        wrong = command = ""
        try:
            command = f"$ {self._typed(*self._chosen)}"
        except SimulshotError as error:
            wrong = str(error)
        self._wrong.update(Content(printable(wrong)))
        self._wrong.remove_class("-refused")
        self._wrong.display = bool(wrong)
        self._preview.update(Content(printable(command)))
        return not wrong


def name_question(card: SessionCard) -> TextQuestion:
    """Return the dialog for a new name."""

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


def import_question(folder: str) -> TextQuestion:
    """Return the dialog for the folder to import, with `folder` as initial text."""

    def check(text: str) -> str:
        # `Path.is_dir` raises for impossible names and inaccessible folders.
        there = text.strip() and os.path.isdir(typed_path(text))  # noqa: PTH112
        return "" if there else "there is no such folder"

    return TextQuestion(
        "A folder of videos, or of another program's recording. Clips that belong together are found and "
        "aligned by all they have.",
        folder,
        check=check,
        title="Import",
    )


def note_question(card: SessionCard) -> TextQuestion:
    """Return the dialog for the note."""

    return TextQuestion(
        "One line, kept in the session.",
        card.note,
        check=lambda note: f"{len(note)} characters: at most {MAX_NOTE} fit" if len(note) > MAX_NOTE else "",
        title=f"Note of {card.name}",
    )


def command_form(card: SessionCard, runs: Runs) -> CommandForm:
    """Return the dialog for the command to run on a session, and its options."""
    commands = (*STUDIES, VERIFY) if card.state == "complete" else (REPAIR,)

    def typed(command: Command, options: str) -> str:
        return command.line(card.folder, runs.out(command, card.folder), options)

    title = f"What is to be made of {card.name}?"
    texts = [one.quick for one in commands]
    return CommandForm(title, {one.title: one for one in commands}, texts, typed, label="options")


def export_form(card: SessionCard, folder: Path, format_name: str) -> CommandForm:
    """Return the dialog for export format and target; `folder` is the proposed parent."""

    def typed(command: Command, text: str) -> str:
        target = typed_path(text)
        if not text.strip():
            raise BadInputError("name a folder")
        try:
            taken = target.exists() and (not target.is_dir() or any(target.iterdir()))
        except OSError as error:
            raise BadInputError(f"{target}: {error.strerror}") from error
        if taken:
            raise BadInputError(f"{target} exists already: choose another folder")
        return command.line(card.folder, target, "")

    formats = {name: replace(EXPORTS[name], what=one.help) for name, one in load_exporters().items()}
    texts = [str(_free_folder(folder / f"{card.name}-{name}")) for name in formats]
    title = f"Export {card.name}"
    return CommandForm(title, formats, texts, typed, label="folder", chosen=format_name)


def _free_folder(folder: Path) -> Path:
    """Return the folder, or the first of NAME-2, NAME-3 ... that does not exist."""
    names = (folder, *(folder.with_name(f"{folder.name}-{number}") for number in range(2, 1000)))
    return next((one for one in names if not one.exists()), folder)


def typed_path(text: str) -> Path:
    """Return the path that a user typed."""
    # `Path.expanduser` raises for an unknown home directory, such as a half-typed name.
    return Path(os.path.expanduser(text.strip()))  # noqa: PTH111
