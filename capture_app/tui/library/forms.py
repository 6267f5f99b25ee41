"""The questions that the sessions ask: a name, a note, which command, which format and where to."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from textual.content import Content
from textual.widgets import Input, OptionList, Static

from capture_app.errors import BadInputError, SimulshotError
from capture_app.names import check_name
from capture_app.session.library.changes import MAX_NOTE
from capture_app.session.library.listing import SessionCard, SessionState
from capture_app.text import printable
from capture_app.tui.jobs.run import COMMANDS, EXPORTS, REPAIR, STUDIES, VERIFY
from capture_app.tui.jobs.runs import Runs
from capture_app.tui.question import BoxDialog, TextQuestion


@dataclass(frozen=True, slots=True)
class Choice:
    """One thing to choose: its value, name and explanation, and the text that its line begins with."""

    value: str
    label: str
    what: str
    text: str = ""


class ChoiceForm(BoxDialog[Choice | None]):
    """A list of things to choose from, and a line of text for the one that is chosen.

    Enter takes it, Tab goes to its line of text and back; Escape gives None.
    """

    def __init__(
        self,
        title: str,
        choices: Sequence[Choice],
        command: Callable[[Choice], str],
        *,
        label: str,
        chosen: str = "",
    ) -> None:
        """`command`: what one would type for a choice; raises SimulshotError where its text is wrong.

        `label` names the line; `chosen` is the value to begin with.
        """
        wide = max(len(choice.label) for choice in choices)
        rows = [
            Content.assemble((f"{one.label:<{wide}}", "bold"), (f"  {one.what}", "$foreground-muted"))
            for one in choices
        ]
        self._choices, self._command = list(choices), command
        self._first = next((at for at, one in enumerate(choices) if one.value == chosen), 0)
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
        self._line.value = self._choices[event.option_index].text
        self._show()

    def on_input_changed(self, event: Input.Changed) -> None:
        """Keep the line of each choice."""
        at = self._options.highlighted or 0
        self._choices[at] = replace(self._choices[at], text=event.value)
        self._show()

    def _take(self) -> None:
        if self._show():
            self.dismiss(self._choices[self._options.highlighted or 0])
        else:
            # Where nothing can be started the line is what has to change.
            self._wrong.add_class("-refused")
            self._line.focus()

    on_input_submitted = on_option_list_option_selected = _take

    def _show(self) -> bool:
        """Show what will be done, or what is wrong; whether nothing is."""
        wrong = command = ""
        try:
            command = f"$ {self._command(self._choices[self._options.highlighted or 0])}"
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
        return "" if typed_path(text).is_dir() and text.strip() else "there is no such folder"

    return TextQuestion(
        "A folder of videos, or of another program's recording. Clips that belong together are found and "
        "aligned by all they have.",
        folder,
        check=check,
        title="Import",
    )


def note_question(card: SessionCard) -> TextQuestion:
    """Ask for the note."""

    def check(note: str) -> str:
        return f"{len(note)} characters: at most {MAX_NOTE} fit" if len(note) > MAX_NOTE else ""

    return TextQuestion(
        "One line, kept in the session.", card.note, check=check, title=f"Note of {card.name}"
    )


def command_form(card: SessionCard, runs: Runs) -> ChoiceForm:
    """Ask what is to be made of a session, and with which options."""
    commands = (*STUDIES, VERIFY) if card.state is SessionState.COMPLETE else (REPAIR,)

    def line(choice: Choice) -> str:
        command = COMMANDS[choice.value]
        return command.line(card.folder, runs.out(command, card.folder), choice.text)

    choices = [Choice(one.name, one.title, one.what, one.quick) for one in commands]
    return ChoiceForm(f"What is to be made of {card.name}?", choices, line, label="options")


def export_form(card: SessionCard, folder: Path, format_name: str) -> ChoiceForm:
    """Ask for the format and the folder of an export; `folder` is proposed to hold it."""

    def line(choice: Choice) -> str:
        target = typed_path(choice.text)
        if not choice.text.strip():
            raise BadInputError("name a folder")
        try:
            taken = target.exists() and (not target.is_dir() or any(target.iterdir()))
        except OSError as error:
            raise BadInputError(f"{target}: {error.strerror}") from error
        if taken:
            raise BadInputError(f"{target} exists already: choose another folder")
        return EXPORTS[choice.value].line(card.folder, target, "")

    choices = [
        Choice(name, name, one.what, str(_free_folder(folder / f"{card.name}-{name}")))
        for name, one in EXPORTS.items()
    ]
    return ChoiceForm(f"Export {card.name}", choices, line, label="folder", chosen=format_name)


def _free_folder(folder: Path) -> Path:
    """The folder itself, or the first of NAME-2, NAME-3 ... that is not there yet."""
    names = (folder, *(folder.with_name(f"{folder.name}-{number}") for number in range(2, 1000)))
    return next((one for one in names if not one.exists()), folder)


def typed_path(text: str) -> Path:
    """The path of a folder as a user types it."""
    return Path(text.strip()).expanduser()
