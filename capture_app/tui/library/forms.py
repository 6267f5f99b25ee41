"""The questions that the sessions ask: a name, a note, which command, which format and where to."""

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
    """Commands to choose from, and a line of text for the one that is chosen.

    Enter takes both, Tab goes to the line of text and back; Escape gives None.
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
        """`commands` by what they are called here; `texts` are what their lines begin with.

        `typed`: what one would type to do the same; raises SimulshotError where the text is wrong. `label`
        names the line; `chosen` is the name to begin with.
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
        """Choose at once."""
        self._options.focus()
        self._options.highlighted = self._first

    def on_option_list_option_highlighted(self, event: OptionList.OptionHighlighted) -> None:
        """Show the line of what is chosen now."""
        self._line.value = self._texts[event.option_index]
        self._show()

    def on_input_changed(self, event: Input.Changed) -> None:
        """Keep the line of each choice."""
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
            # Where nothing can be started the line is what has to change.
            self._wrong.add_class("-refused")
            self._line.focus()

    on_input_submitted = on_option_list_option_selected = _take

    def _show(self) -> bool:
        """Show what will be done, or what is wrong; whether nothing is."""
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


def import_question(folder: str) -> TextQuestion:
    """Ask which folder is imported; `folder` is proposed."""

    def check(text: str) -> str:
        # As `Path` asks, a name that no folder can have, or one behind a closed door, would be an error.
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
    """Ask for the note."""

    return TextQuestion(
        "One line, kept in the session.",
        card.note,
        check=lambda note: f"{len(note)} characters: at most {MAX_NOTE} fit" if len(note) > MAX_NOTE else "",
        title=f"Note of {card.name}",
    )


def command_form(card: SessionCard, runs: Runs) -> CommandForm:
    """Ask what is to be made of a session, and with which options."""
    commands = (*STUDIES, VERIFY) if card.state == "complete" else (REPAIR,)

    def typed(command: Command, options: str) -> str:
        return command.line(card.folder, runs.out(command, card.folder), options)

    title = f"What is to be made of {card.name}?"
    texts = [one.quick for one in commands]
    return CommandForm(title, {one.title: one for one in commands}, texts, typed, label="options")


def export_form(card: SessionCard, folder: Path, format_name: str) -> CommandForm:
    """Ask for the format and the folder of an export; `folder` is proposed to hold it."""

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
    """The folder itself, or the first of NAME-2, NAME-3 ... that is not there yet."""
    names = (folder, *(folder.with_name(f"{folder.name}-{number}") for number in range(2, 1000)))
    return next((one for one in names if not one.exists()), folder)


def typed_path(text: str) -> Path:
    """The path of a folder as a user types it."""
    # `Path` raises an error of a home that nobody has, such as that of a name half typed.
    return Path(os.path.expanduser(text.strip()))  # noqa: PTH111
