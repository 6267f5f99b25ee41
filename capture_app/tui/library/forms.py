"""The questions that the sessions ask: a name, a note, which job, which format and where to.

A question with a list of things to choose from and a line of text for the one that is chosen.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from textual.app import ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Vertical
from textual.content import Content
from textual.screen import ModalScreen
from textual.widgets import Input, OptionList, Static
from textual.widgets.option_list import Option

from capture_app.errors import SimulshotError
from capture_app.names import check_name
from capture_app.session.library.changes import MAX_NOTE
from capture_app.session.library.listing import SessionCard, SessionState
from capture_app.text import printable
from capture_app.tui.jobs.job import EXPORTS, KINDS, REPAIR, STUDIES, VERIFY
from capture_app.tui.jobs.job_list import JobList, default_out
from capture_app.tui.question import Dialog, TextQuestion


@dataclass(frozen=True, slots=True)
class Choice:
    """One thing to choose: its value, name and explanation, and the text that its line begins with."""

    value: str
    label: str
    what: str
    text: str = ""


@dataclass(frozen=True, slots=True)
class Chosen:
    """What was chosen, and its line of text."""

    value: str
    text: str


class ChoiceForm(Dialog[Chosen | None], ModalScreen[Chosen | None]):
    """Enter takes what is chosen, Tab goes to its line of text and back; Escape gives None."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "leave", "Cancel", id="form.cancel"),
    ]
    DEFAULT_CSS = """
    ChoiceForm { align: center middle; background: $background 60%; }
    ChoiceForm > Vertical {
        width: 100; max-width: 94%; height: auto; max-height: 100%; padding: 1 2 0 2;
        background: $panel; border: round $primary; border-subtitle-color: $foreground-muted;
    }
    ChoiceForm OptionList {
        height: auto; max-height: 12; border: none; padding: 0; background: $panel;
        scrollbar-size-vertical: 1; text-wrap: nowrap; text-overflow: ellipsis;
    }
    ChoiceForm OptionList:focus { border: none; background-tint: $foreground 0%; }
    ChoiceForm Input { border: none; height: 1; padding: 0 1; background: $surface; }
    ChoiceForm .label { margin-top: 1; color: $foreground-muted; height: auto; }
    ChoiceForm .preview { color: $foreground-muted; height: auto; margin-top: 1; }
    ChoiceForm .wrong { color: $error; height: auto; }
    ChoiceForm .wrong.-refused { background: $error; color: $background; text-style: bold; }
    """

    def __init__(
        self,
        title: str,
        choices: Sequence[Choice],
        *,
        label: str,
        preview: Callable[[Chosen], str] | None = None,
        check: Callable[[Chosen], str] | None = None,
        chosen: str = "",
    ) -> None:
        """`label` names the line; `preview` says what will be done, `check` what is wrong, if anything."""
        super().__init__()
        self._title, self._choices, self._label = printable(title), tuple(choices), label
        self._texts = {choice.value: choice.text for choice in choices}
        self._preview = preview or (lambda _: "")
        self._check = check or (lambda _: "")
        self._first = max(0, next((n for n, one in enumerate(choices) if one.value == chosen), 0))

    def compose(self) -> ComposeResult:
        """The choices above the line of text, and what comes of it."""
        wide = max(len(choice.label) for choice in self._choices)
        box = Vertical(
            OptionList(
                *(
                    Option(
                        Content.assemble(
                            (f"{choice.label:<{wide}}", "bold"),
                            (f"  {choice.what}", "$foreground-muted"),
                        )
                    )
                    for choice in self._choices
                )
            ),
            Static(Content(self._label), classes="label"),
            Input(select_on_focus=False),
            Static("", classes="wrong"),
            Static("", classes="preview"),
        )
        box.border_title = Content(self._title)
        box.border_subtitle = f"enter starts · tab edits the {self._label} · esc cancels"
        yield box

    def on_mount(self) -> None:
        """Choose at once."""
        options = self.query_one(OptionList)
        options.focus()
        options.highlighted = self._first

    def on_option_list_option_highlighted(self, event: OptionList.OptionHighlighted) -> None:
        """Show the line of what is chosen now."""
        self.query_one(".wrong").remove_class("-refused")
        self.query_one(Input).value = self._texts[self._choices[event.option_index].value]
        self._show()

    def on_option_list_option_selected(self) -> None:
        """Take it."""
        self._take()

    def on_input_changed(self, event: Input.Changed) -> None:
        """Keep the line of each choice."""
        self.query_one(".wrong").remove_class("-refused")
        if (chosen := self.chosen) is not None:
            self._texts[chosen.value] = event.value
            self._show()

    def on_input_submitted(self) -> None:
        """Take it."""
        self._take()

    @property
    def chosen(self) -> Chosen | None:
        """What is chosen now."""
        at = self.query_one(OptionList).highlighted
        if at is None:
            return None
        value = self._choices[at].value
        return Chosen(value, self._texts[value])

    def action_leave(self) -> None:
        """Choose nothing."""
        self.dismiss(None)

    def _take(self) -> None:
        chosen = self.chosen
        if chosen is None:
            return
        if self._check(chosen):
            # Where nothing can be started the line is what has to change.
            self.query_one(".wrong").add_class("-refused")
            self.query_one(Input).focus()
        else:
            self.dismiss(chosen)

    def _show(self) -> None:
        chosen = self.chosen
        if chosen is not None:
            wrong = printable(self._check(chosen))
            self.query_one(".wrong", Static).update(Content(wrong))
            self.query_one(".wrong").display = bool(wrong)
            preview = "" if wrong else printable(self._preview(chosen))
            self.query_one(".preview", Static).update(Content(preview))


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
