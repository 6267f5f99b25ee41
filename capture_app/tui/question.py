"""Dialogs over the screen: their base classes, a choice between answers, and a line of text."""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar

from rich.cells import cell_len
from textual import events, work
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical, VerticalScroll
from textual.content import Content
from textual.screen import ModalScreen
from textual.widget import Widget
from textual.widgets import Button, Input, OptionList, Static
from textual.widgets.option_list import Option

from capture_app.common.errors import SimulshotError
from capture_app.common.text import printable
from capture_app.session.reading.take_sheet import TakeSheet
from capture_app.session.reading.verdict import GRADE_LIMITS
from capture_app.tui.widgets.dialog import Dialog, Result
from capture_app.tui.widgets.key_footer import KeyFooter
from capture_app.tui.widgets.text_field import TextField

BESIDE, BUTTON_EXTRA = 56, 7
"""Maximum cells of answers in a row, otherwise a column is used; cells that a button adds to its label."""


class BoxDialog(Dialog[Result], ModalScreen[Result]):
    """Dialog in a box over the previous screen; Escape closes it without a result."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("escape", "dismiss", "Close", id="dialog.close", key_display="esc"),
    ]
    DEFAULT_CSS = """
    BoxDialog { align: center middle; }
    BoxDialog > Vertical {
        width: 64; max-width: 90%; height: auto; max-height: 90%; padding: 1 2;
        background: $panel; border: round $primary;
    }
    BoxDialog .question { width: 1fr; height: auto; margin-bottom: 1; }
    BoxDialog .wrong { color: $error; height: auto; }
    BoxDialog Input, BoxDialog Input:focus {
        border: none; border-left: outer $primary; height: 1; padding: 0 1; background: $background;
    }
    """

    def __init__(self, title: str, *children: Widget, subtitle: str = "") -> None:
        box = Vertical(*children)
        box.border_title, box.border_subtitle = Content(printable(title)), Content(subtitle)
        # Over that of the mode below, whose keys do nothing meanwhile.
        super().__init__(box, KeyFooter())


@dataclass(frozen=True, slots=True)
class Answer:
    """One answer of a question: its value, key and label."""

    value: str
    key: str
    label: str


CANCEL = Answer("", "esc", "Cancel")
"""Answer None as a button, for users who do not think of Escape."""


class Question(BoxDialog[str | None]):
    """Question with a few answers; returns the chosen value, None after Escape."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left,up", "app.focus_previous", "Answer before", show=False, id="question.left"),
        Binding("right,down", "app.focus_next", "Answer after", show=False, id="question.right"),
    ]
    DEFAULT_CSS = """
    Question #answers { height: auto; }
    Question Button { margin-right: 1; min-width: 0; padding: 0 1; }
    """

    def __init__(self, text: str, answers: Sequence[Answer], *, title: str = "") -> None:
        """The first answer has the focus."""
        self._answers = tuple(answers)
        fits = sum(len(answer.label) + BUTTON_EXTRA for answer in answers) <= BESIDE
        buttons = [
            Button(Content(f"{answer.key} {answer.label}"), id=f"answer-{answer.value}", compact=True)
            for answer in answers
        ]
        super().__init__(
            title,
            Static(Content(printable(text)), classes="question"),
            (Horizontal if fits else Vertical)(*buttons, id="answers"),
        )

    def on_key(self, event: events.Key) -> None:
        """Return the answer whose key was pressed."""
        for answer in self._answers:
            if event.character == answer.key:
                event.stop()
                self.dismiss(answer.value)

    def on_button_pressed(self, event: Button.Pressed) -> None:
        """Return the answer that was clicked."""
        self.dismiss((event.button.id or "").removeprefix("answer-") or None)


class ListQuestion(BoxDialog[str | None]):
    """List of things with explanations; Enter or Space returns the name of the selected one, Escape None."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("space", "choose", "Choose", show=False, id="question.choose"),
    ]

    def __init__(self, title: str, rows: Mapping[str, tuple[str, str]], chosen: str = "") -> None:
        """`rows`: title and explanation by name; `chosen`: the name selected first."""
        wide = max(len(name) for name, _ in rows.values())
        choices = OptionList(
            *(
                Option(
                    Content.assemble((f"{one:<{wide}}", "bold"), (f"  {what}", "$foreground-muted")), id=name
                )
                for name, (one, what) in rows.items()
            )
        )
        choices.highlighted = list(rows).index(chosen) if chosen in rows else 0
        super().__init__(title, choices)
        self._explanations = {name: what for name, (_, what) in rows.items()}

    def action_choose(self) -> None:
        """Return the selected name."""
        self.query_one(OptionList).action_select()

    def on_option_list_option_highlighted(self, event: OptionList.OptionHighlighted) -> None:
        """Show the explanation of the selected row in the border if its row has no room for it."""
        cut = cell_len(str(event.option.prompt)) > event.option_list.scrollable_content_region.width - 2
        self.query_one(Vertical).border_subtitle = Content(
            self._explanations[event.option_id or ""] if cut else "enter chooses · esc cancels"
        )

    def on_option_list_option_selected(self, event: OptionList.OptionSelected) -> None:
        """Return the selected name."""
        self.dismiss(event.option_id)


class TextQuestion(BoxDialog[str | None]):
    """Question with a line of text as answer; None after Escape."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("up,pageup", "scroll_help(-6)", "Help above", show=False, id="question.help-above"),
        Binding("down,pagedown", "scroll_help(6)", "Help below", show=False, id="question.help-below"),
    ]
    DEFAULT_CSS = """
    TextQuestion VerticalScroll {
        height: auto; max-height: 12; scrollbar-size-vertical: 1; display: none;
    }
    TextQuestion.-helps > Vertical { width: 90%; max-width: 85; }
    TextQuestion.-helps VerticalScroll { display: block; }
    """

    def __init__(
        self,
        text: str,
        value: str,
        *,
        check: Callable[[str], object],
        title: str = "",
        read_help: Callable[[int], Awaitable[str]] | None = None,
    ) -> None:
        """`check` raises SimulshotError for a text that is not valid.

        `read_help` returns help in lines of at most that many columns.
        """
        self._check, self._read_help = check, read_help
        self._help = VerticalScroll(Static(), can_focus=False)
        self._wrong = Static("", classes="wrong")
        self._line, self._value = TextField(), value
        super().__init__(
            title,
            Static(Content(printable(text)), classes="question"),
            self._line,
            self._wrong,
            self._help,
            subtitle="enter accepts · esc cancels",
        )

    def on_mount(self) -> None:
        """Show the initial text, selected, so that typing replaces it."""
        self._line.value = self._value
        self._line.action_select_all()
        self.set_class(self._read_help is not None, "-helps")
        self._show_help()

    @work
    async def _show_help(self) -> None:
        """Show the help when a command has printed it."""
        if self._read_help is not None:
            with suppress(SimulshotError):
                words = await self._read_help(min(85, self.app.size.width * 9 // 10) - 7)
                self._help.query_one(Static).update(Content.styled(printable(words), "$foreground-muted"))

    def action_scroll_help(self, lines: int) -> None:
        """Scroll the help, while the focus stays in the line."""
        self._help.scroll_relative(y=lines, animate=False)

    def on_input_changed(self, event: Input.Changed) -> None:
        """Show the error message of the present text."""
        self._wrong.update(Content(self._problem(event.value)))

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Return the text if it is valid."""
        if not self._problem(event.value):
            self.dismiss(event.value)

    def _problem(self, text: str) -> str:
        try:
            self._check(text)
        except SimulshotError as error:
            return printable(str(error))
        return ""


def explain_verdict(sheet: TakeSheet) -> BoxDialog[None]:
    """Return the dialog with a verdict's details."""
    verdict = sheet.verdict
    parts = (
        verdict.headline,
        f"Spread, the largest time between images of one instant: {verdict.spread}.",
        verdict.sentence,
        verdict.stamps,
        GRADE_LIMITS,
    )
    text = "\n\n".join(part[:1].upper() + part[1:] for part in parts if part)
    return BoxDialog(
        f"Verdict on {sheet.session.name}", Static(Content(printable(text))), subtitle="esc closes"
    )
