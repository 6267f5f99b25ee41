"""Dialogs over the screen: what all are, and questions: one of a few answers by a key, or a line of text."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar, TypeVar

from textual import events
from textual.app import ComposeResult
from textual.await_complete import AwaitComplete
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.content import Content
from textual.screen import ModalScreen, Screen
from textual.widget import Widget
from textual.widgets import Button, Input, Static

from capture_app.common.text import printable
from capture_app.protocol.status import RigStatus
from capture_app.tui.rig_record import Told

Result = TypeVar("Result")

BESIDE, BUTTON_EXTRA = 56, 7
"""Cells for answers beside each other, else one is below the other; what a button adds to its words."""


class Dialog(Screen[Result]):
    """What is pushed over a mode: a question, a form, a view of the whole screen. It gives its result once.

    Keys that are still on their way when it closes are not its own any more.
    """

    def __init__(self, *parts: Widget) -> None:
        super().__init__()
        self._parts = parts

    def compose(self) -> ComposeResult:
        """Lay out the dialog's parts."""
        yield from self._parts

    def dismiss(self, result: Result | None = None) -> AwaitComplete:
        """Close and give the result; nothing where it is not on top."""
        return super().dismiss(result) if self.is_active else AwaitComplete()


class BoxDialog(Dialog[Result], ModalScreen[Result]):
    """A box over the screen that was there; Escape closes it without a result."""

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
    BoxDialog Input, BoxDialog Input:focus { border: none; height: 1; padding: 0 1; background: $surface; }
    """

    def __init__(self, title: str, *children: Widget, subtitle: str = "") -> None:
        box = Vertical(*children)
        if title:
            box.border_title = Content(printable(title))
        box.border_subtitle = Content(subtitle)
        super().__init__(box)


@dataclass(frozen=True, slots=True)
class Answer:
    """One answer of a question: its value, the key that gives it, and what it is called."""

    value: str
    key: str
    label: str


CANCEL = Answer("", "esc", "Cancel")
"""The answer None, to be clicked where Escape is not thought of."""


class Question(BoxDialog[str | None]):
    """Asks and gives the value of the answer; None where it was closed by Escape."""

    BINDINGS: ClassVar[list[BindingType]] = [
        Binding("left,up", "app.focus_previous", "Answer before", show=False, id="question.left"),
        Binding("right,down", "app.focus_next", "Answer after", show=False, id="question.right"),
    ]
    DEFAULT_CSS = """
    Question #answers { height: auto; }
    Question Button { margin-right: 1; min-width: 0; padding: 0 1; }
    """

    def __init__(self, text: str | Callable[[], str], answers: Sequence[Answer], *, title: str = "") -> None:
        """The first answer has the focus; a text that is a function is told anew as the rig changes."""
        self._answers, self._text = tuple(answers), text if callable(text) else lambda: text
        self._words = Static(Content(printable(self._text())), classes="question")
        fits = sum(len(answer.label) + BUTTON_EXTRA for answer in answers) <= BESIDE
        buttons = [
            Button(Content(f"{answer.key} {answer.label}"), id=f"answer-{answer.value}", compact=True)
            for answer in answers
        ]
        row = (Horizontal if fits else Vertical)(*buttons, id="answers")
        super().__init__(title, self._words, row)

    def on_told(self, message: Told) -> None:
        """Say it anew."""
        if isinstance(message.what, RigStatus):
            self._words.update(Content(printable(self._text())))

    def on_key(self, event: events.Key) -> None:
        """Give the answer of a key."""
        for answer in self._answers:
            if event.character == answer.key:
                event.stop()
                self.dismiss(answer.value)

    def on_button_pressed(self, event: Button.Pressed) -> None:
        """Give the answer that was clicked."""
        self.dismiss((event.button.id or "").removeprefix("answer-") or None)


class TextQuestion(BoxDialog[str | None]):
    """Asks for a line of text; None where it was closed by Escape."""

    def __init__(
        self, text: str, value: str = "", *, check: Callable[[str], str] | None = None, title: str = ""
    ) -> None:
        """`check` returns what is wrong with a text, or nothing."""
        self._check = check or (lambda _: "")
        self._wrong = Static("", classes="wrong")
        self._line, self._value = Input(select_on_focus=False), value
        super().__init__(title, Static(Content(printable(text)), classes="question"), self._line, self._wrong)

    def on_mount(self) -> None:
        """Propose what there is."""
        self._line.value = self._value

    def on_input_changed(self, event: Input.Changed) -> None:
        """Say at once what is wrong."""
        self._wrong.update(Content(self._check(event.value)))

    def on_input_submitted(self, event: Input.Submitted) -> None:
        """Take it where nothing is wrong."""
        if not self._check(event.value):
            self.dismiss(event.value)
